"""Pictures of an optimisation: every design at its numbers, undominated designs, the device before and after."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.plot import optimum
from fieldmap.plot.optimum import (
    optimum_figure,
    optimum_message,
    save_before_and_after,
    save_optimum_plot,
    undominated,
)
from fieldmap.plot.rendering import can_render
from fieldmap.plot.solids import extent
from fieldmap.plot.style import COLOURS, INK
from fieldmap.studies import Limit, Variable
from fieldmap.studies.optimum import LimitAtOptimum, Optimum, Step
from tests.plot.conftest import crooked_device, pixels_of
from tests.plot.scene_reading import check_legible, filled, labels_of
from tests.studies.test_optimise import PAIR


@pytest.fixture(scope="module")
def best():
    """The largest field in the middle of a pair of coils at 2 A or less: the coils move together."""
    return fm.optimise(
        PAIR,
        [Variable("parameters.spacing", 10.0, 90.0), Variable("current.*", 0.1, 3.0, start=1.0)],
        "flux_density 1 z",
        [Limit("common_current", upper=2.0)],
        maximise=True,
        points=[[0.0, 0.0, 0.0]],
        method="COBYQA",
        tolerance=1e-3,
    )


def drawn(axes, label):
    (line,) = (one for one in axes.lines if one.get_label() == label)
    return np.array(line.get_xdata(), float), np.array(line.get_ydata(), float)


def test_every_design_stands_at_its_numbers_in_millitesla(best):
    objective, variables, trade_off = optimum_figure(best).axes
    flux = 1e3 * np.array([step.numbers["flux_density 1 z"] for step in best.path])
    meets = np.array([step.feasible for step in best.path])
    assert meets.any()
    assert not meets.all()
    for label, which in (("meets all limits", meets), ("misses a limit", ~meets)):
        number, value = drawn(objective, label)
        assert number.tolist() == (1 + np.flatnonzero(which)).tolist()
        assert value == pytest.approx(flux[which], rel=1e-12)
    assert objective.get_ylabel() == trade_off.get_ylabel() == "flux density 1 z (mT)"
    _, so_far = drawn(objective, "best so far")
    known = so_far[np.isfinite(so_far)]
    assert (np.diff(known) >= 0.0).all()
    assert known[-1] == pytest.approx(flux[meets].max()) == pytest.approx(1e3 * best.value)
    assert drawn(objective, "best")[1] == pytest.approx([1e3 * best.value])
    current = np.array([step.values["current.*"] for step in best.path])
    at, value = drawn(trade_off, "misses a limit")
    assert (at == pytest.approx(current[~meets], rel=1e-9), len(value)) == (True, (~meets).sum())
    assert trade_off.get_xlabel() == "common current (A)"
    assert set(drawn(trade_off, "limit")[0]) == {2.0}
    spacing, *_ = variables.lines
    share = np.array(spacing.get_ydata(), float)
    assert share == pytest.approx([(step.values["parameters.spacing"] - 10) / 0.8 for step in best.path])


def made_up(limits, maximise=False, objective="power", flux=1e-3):
    """A search over the radius r from 10 to 30 mm: the power is 4 W at 12 mm, 2 W at 16 mm, and so on."""
    table = [  # role, r, power, flux density, feasible, failure
        ("sample", 12.0, 4.0, 1.0, True, ""),
        ("step", 16.0, 2.0, 3.0, False, ""),
        ("check", 20.0, 0.1, 9.0, True, ""),
        ("difference", 18.0, np.nan, np.nan, False, "no mesh"),
        ("step", 20.0, 3.0, 2.0, True, ""),
        ("step", 26.0, 5.0, 2.5, True, ""),
    ]
    path = tuple(
        Step(
            role,
            False,
            1.0,
            {"r": r},
            {} if failure else {"power": power, "flux_density 1 z": flux * b},
            meets,
            failure,
        )
        for role, r, power, b, meets, failure in table
    )
    about = {
        "derivatives": {},
        "refused": {},
        "verified": None,
        "solves": 6,
        "kept": 0,
        "ended": "",
        "method": "SLSQP",
    }
    devices = {"device": crooked_device(), "start_device": crooked_device(), "assumptions": ()}
    values = {"power": (3.0, 4.0), "flux_density 1 z": (2.0 * flux, 1.0 * flux)}[objective]
    return Optimum(
        title="A search", values={"r": 20.0}, objective=objective, value=values[0], start_value=values[1],
        limits=limits, variables=(Variable("r", 10.0, 30.0),), path=path, maximise=maximise, **about, **devices,
    )  # fmt: skip


def limited(number="flux_density 1 z", value=2e-3, lower=-np.inf, upper=np.inf):
    return LimitAtOptimum(number, value, None, lower, upper, False, True)


def test_all_that_is_drawn_of_made_up_designs():
    """Designs 1 to 5 without the check; the third one failed."""
    figure = optimum_figure(made_up((limited(upper=2.75e-3, lower=0.5e-3),)))
    objective, variables, trade_off = figure.axes
    assert figure.get_suptitle() == "Power: 4 at the start, 3 W at the best\nA search"
    assert drawn(objective, "meets all limits")[0].tolist() == [1.0, 4.0, 5.0]
    assert drawn(objective, "meets all limits")[1].tolist() == [4.0, 3.0, 5.0]
    # A failed design has no number.
    np.testing.assert_array_equal(drawn(objective, "misses a limit"), [[2.0, 3.0], [2.0, np.nan]])
    assert [one.tolist() for one in drawn(objective, "best")] == [[4.0], [3.0]]
    number, best = drawn(objective, "best so far")
    assert (number.tolist(), best.tolist()) == ([1, 2, 3, 4, 5], [4.0, 4.0, 4.0, 3.0, 3.0])
    number, low = drawn(objective, "could not be solved")
    assert (number.tolist(), low.tolist()) == ([3.0], [objective.get_ylim()[0]])
    assert (objective.get_xlabel(), objective.get_ylabel()) == ("design", "power (W)")
    (share,) = variables.lines
    assert (share.get_xdata().tolist(), share.get_ydata().tolist()) == (
        [1, 2, 3, 4, 5],
        [10.0, 30.0, 40.0, 50.0, 80.0],
    )
    assert (variables.get_xlabel(), variables.get_ylabel()) == ("design", "variables, % of their range")
    # The whole range, with the marks at its ends.
    low, high = variables.get_ylim()
    assert -10.0 < low < 0.0
    assert 100.0 < high < 110.0
    (words,) = variables.get_legend().get_texts()
    assert words.get_text() == "r = 20"
    figure.draw_without_rendering()
    box = variables.get_legend().get_window_extent()
    assert box.y0 >= variables.bbox.y1
    assert box.x0 == pytest.approx(variables.bbox.x0, abs=8.0)
    # Against the limited number in mT, with both bounds.
    np.testing.assert_allclose(drawn(trade_off, "misses a limit"), [[3.0, np.nan], [2.0, np.nan]])
    bounds = [line.get_xdata()[0] for line in trade_off.lines if line.get_label() == "limit"]
    assert bounds == pytest.approx([0.5, 2.75])
    assert (trade_off.get_xlabel(), trade_off.get_ylabel()) == ("flux density 1 z (mT)", "power (W)")
    front = [one.tolist() for one in drawn(trade_off, "no other is better in both")]
    # No design is smaller in both numbers than (1, 4), (2, 3) or (3, 2); (2.5, 5) is dominated.
    assert front == [pytest.approx([1.0, 2.0, 3.0]), [4.0, 3.0, 2.0]]
    (legend,) = figure.legends
    told = [text.get_text() for text in legend.get_texts()]
    assert len(set(told)) == len(told) == 7
    assert legend._ncols == len(told)
    looks = {line.get_label(): line for line in (*objective.lines, *trade_off.lines)}
    for label, face in (("meets all limits", COLOURS[0]), ("misses a limit", "none"), ("best", COLOURS[1])):
        assert looks[label].get_markerfacecolor() == face
    assert looks["limit"].get_color() == INK
    sizes = [looks[label].get_markersize() for label in ("meets all limits", "best")]
    assert 3.0 < sizes[0] < sizes[1] < 16.0
    assert {
        0.7 < looks[label].get_linewidth() < 1.7 for label in ("limit", "no other is better in both")
    } == {True}
    assert 0.7 < share.get_linewidth() < 1.7


@pytest.mark.parametrize(
    ("maximise", "bound", "front"),
    [
        # With only a lower bound a large number is good: (3, 2) dominates all, or is undominated with (2.5, 5).
        (False, {"lower": 1e-3}, [[3.0], [2.0]]),
        (True, {"lower": 1e-3}, [[2.5, 3.0], [5.0, 2.0]]),
        (True, {"upper": 1e-3}, [[1.0, 2.5], [4.0, 5.0]]),
    ],
)
def test_what_no_other_beats_follows_from_what_is_wanted(maximise, bound, front):
    objective, _, trade_off = optimum_figure(made_up((limited(**bound),), maximise)).axes
    found = drawn(trade_off, "no other is better in both")
    np.testing.assert_allclose(found, front)
    best = drawn(objective, "best so far")[1]
    assert best.tolist() == ([4.0, 4.0, 4.0, 4.0, 5.0] if maximise else [4.0, 4.0, 4.0, 3.0, 3.0])


@pytest.mark.parametrize(
    ("count", "rows", "columns"), [(0, 1, 2), (1, 1, 3), (2, 2, 2), (3, 2, 3), (4, 2, 3), (5, 3, 3)]
)
def test_panels_of_a_search(count, rows, columns):
    figure = optimum_figure(made_up(tuple(limited(upper=1.0) for _ in range(count))))
    grids = [axes.get_subplotspec().get_geometry() for axes in figure.axes]
    assert grids == [(rows, columns, k, k) for k in range(2 + count)]
    width, height = figure.get_size_inches()
    assert width == pytest.approx(4.4 * columns)
    assert 3.3 * rows + 0.4 < height < 3.3 * rows + 1.0


@pytest.mark.parametrize(("widest", "scale"), [(20.1, "log"), (19.9, "linear")])
def test_decades_of_a_number_are_drawn_as_such(widest, scale):
    """Logarithmic if all numbers are positive and the largest is more than 20 times the smallest."""
    found = made_up((limited("iron", value=1.0, upper=9.0),))
    for factor, wanted in ((1.0, scale), (-1.0, "linear")):
        numbers = [1.0, 2.0, 3.0, 0.0, widest, 4.0]
        path = [
            replace(step, numbers=step.numbers and step.numbers | {"iron": factor * one})
            for step, one in zip(found.path, numbers, strict=True)
        ]
        axes = optimum_figure(replace(found, path=tuple(path))).axes[2]
        assert axes.get_xscale() == wanted
        # A number that is no study quantity has no unit.
        assert axes.get_xlabel() == "iron"
        assert drawn(axes, "meets all limits")[0] == pytest.approx([factor, factor * widest, 4.0 * factor])


@pytest.mark.parametrize(
    ("objective", "flux", "words"),
    [
        ("flux_density 1 z", 1.0, "Flux density 1 z: 1 at the start, 2 T at the best"),
        ("flux_density 1 z", 1.2345e-6, "Flux density 1 z: 1.234 at the start, 2.469 uT at the best"),
        ("power", 1.0, "Power: 4 at the start, 3 W at the best"),
    ],
)
def test_the_message_of_a_search(objective, flux, words):
    assert optimum_message(made_up((), objective=objective, flux=flux)) == words
    assert optimum_message(
        replace(made_up(()), objective="equilibrium_area", value=2e-6, start_value=3e-6)
    ) == ("Equilibrium area: 3 at the start, 2 mm² at the best")


@pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")
@pytest.mark.parametrize(("width", "tall", "height"), [(1000, 0.0, None), (1000, 1.0, 1500), (300, 0.0, 500)])
def test_before_and_after_are_seen_from_one_place(monkeypatch, tmp_path, width, tall, height):
    """The height follows from the extent of the devices, between 500 and 1500 pixels."""
    after = crooked_device(
        bodies=[fm.Body("mast", "iron", fm.Box((0.01, 0.01, 0.01 + tall)), 0.004).moved([0.06, 0.0, 0.0])]
    )
    found = []

    def read(scene, path):
        ends = []
        for k in range(2):
            scene.subplot(0, k)
            check_legible(scene)
            ends.append(extent(scene))
        together = np.column_stack([np.minimum(*ends)[:, 0], np.maximum(*ends)[:, 1]])
        for k in range(2):
            scene.subplot(0, k)
            names = [one for one in scene.actors.values() if "Billboard" in type(one).__name__]
            found.append(
                (
                    filled(scene, together),
                    labels_of(scene),
                    names,
                    [one.GetText(2) for one in scene.actors.values() if hasattr(one, "GetText")],
                )
            )
        found.append((tuple(scene.window_size), together))

    monkeypatch.setattr(optimum, "save_screenshot", read)
    options = {"captions": ("one", "two")} if tall else {}
    save_before_and_after(crooked_device(), after, tmp_path / "a.png", width=width, **options)
    left, right, (size, together) = found
    np.testing.assert_allclose(left[0], right[0])
    assert left[0].max() == pytest.approx(1 / 1.3)
    for _, labels, names, _ in (left, right):
        assert labels == names == []
    assert [panel[3] for panel in (left, right)] == ([["one"], ["two"]] if tall else [["before"], ["after"]])
    assert size[0] == width
    if height is None:
        # Each device has half of the width, and the width is 1.4 times their common extent.
        across, up = optimum.extent_seen(together)
        assert size[1] == int(0.5 * width * 1.4 * up / across)
        assert 500 < size[1] < 1500
    else:
        assert size[1] == height


def test_designs_that_failed_stand_on_the_lower_edge_and_are_drawn_whole(best):
    """A cross on the edge must not be cut in half."""
    some = [replace(step, failure="no mesh", numbers={}, feasible=False) if k in (1, 3) else step
            for k, step in enumerate(best.path)]  # fmt: skip
    figure = optimum_figure(replace(best, path=tuple(some)))
    objective = figure.axes[0]
    number, value = drawn(objective, "could not be solved")
    assert number.tolist() == [2.0, 4.0]
    assert value == pytest.approx(value[0])
    assert value[0] < drawn(objective, "meets all limits")[1].min()
    # A marker within half its size of a side of its axes must not be clipped there.
    for axes in figure.axes:
        for line in axes.lines:
            if line.get_marker() in ("None", "", None):
                continue
            places = axes.transAxes.inverted().transform(axes.transData.transform(line.get_xydata()))
            half = 0.5 * line.get_markersize() / 72.0 / (figure.get_size_inches() * axes.get_position().size)
            at_a_side = (places < half) | (places > 1.0 - half)
            assert not (line.get_clip_on() and at_a_side.any()), line.get_label()


def test_the_front_is_what_nothing_beats():
    """Against all pairs."""
    x, y = np.random.default_rng(4).random((2, 60)).round(1)
    found = undominated(x, y)
    beaten = [
        any((x[j] <= x[i] and y[j] <= y[i]) and (x[j] < x[i] or y[j] < y[i]) for j in range(60))
        for i in range(60)
    ]
    pairs = {(x[i], y[i]) for i in range(60) if not beaten[i]}
    assert {(x[i], y[i]) for i in found} == pairs
    assert len(found) == len(pairs) > 3
    assert (np.diff(x[found]) > 0).all()


def test_the_front_of_a_largest_value_rises(best):
    """More current gives more flux density, so the largest flux density at each current is on the line."""
    *_, trade_off = optimum_figure(best).axes
    current, flux = drawn(trade_off, "no other is better in both")
    assert (np.diff(current) > 0).all()
    assert (np.diff(flux) > 0).all()
    top = max(best.path, key=lambda step: step.numbers["flux_density 1 z"])
    assert flux[-1] == pytest.approx(1e3 * top.numbers["flux_density 1 z"])


@pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")
def test_the_coils_before_and_after_stand_at_one_scale(tmp_path):
    """The coils move together: copper has fewer rows of pixels on the right, and as many columns."""
    thick = PAIR.replace("inner_radius_mm = 49.9", "inner_radius_mm = 30").replace(
        "height_mm = 0.2", "height_mm = 9"
    )
    before, after = (fm.read_device(thick, {"parameters.spacing": apart}) for apart in (90.0, 20.0))
    path = save_before_and_after(before, after, tmp_path / "pair.png", width=1000)
    pixels = pixels_of(path)
    copper = pixels[..., 0] - pixels[..., 2] > 60
    spans = []
    for half in (copper[:, :500], copper[:, 500:]):
        rows, columns = np.nonzero(half)
        spans.append((np.ptp(rows), np.ptp(columns)))
    (tall, wide), (low, as_wide) = spans
    assert low < 0.7 * tall
    assert as_wide == pytest.approx(wide, abs=2)
    assert wide > 200


def test_saved(best, tmp_path):
    assert pixels_of(save_optimum_plot(best, tmp_path / "path.png")).shape[1] > 800
