"""Pictures of an optimisation: every design at its numbers, what beats what, the device before and after."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.plot.optimum import optimum_figure, save_before_and_after, save_optimum_plot, undominated
from fieldmap.plot.rendering import can_render
from fieldmap.studies import Limit, Variable
from tests.plot.conftest import pixels_of
from tests.studies.test_optimise import PAIR


@pytest.fixture(scope="module")
def best():
    """The largest field in the middle of a pair of coils at 2 A or less: the coils come together."""
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


def test_designs_that_failed_stand_on_the_lower_edge_and_are_drawn_whole(best):
    """Half of a cross on the edge would be cut off."""
    some = [replace(step, failure="no mesh", numbers={}, feasible=False) if k in (1, 3) else step
            for k, step in enumerate(best.path)]  # fmt: skip
    figure = optimum_figure(replace(best, path=tuple(some)))
    objective = figure.axes[0]
    number, value = drawn(objective, "could not be solved")
    assert number.tolist() == [2.0, 4.0]
    assert value == pytest.approx(value[0])
    assert value[0] < drawn(objective, "meets all limits")[1].min()
    # Every marker within half its size of a side of its axes must not be clipped there.
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
    """More current gives more flux density: whoever has the most at a current stands on the line."""
    *_, trade_off = optimum_figure(best).axes
    current, flux = drawn(trade_off, "no other is better in both")
    assert (np.diff(current) > 0).all()
    assert (np.diff(flux) > 0).all()
    top = max(best.path, key=lambda step: step.numbers["flux_density 1 z"])
    assert flux[-1] == pytest.approx(1e3 * top.numbers["flux_density 1 z"])


@pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")
def test_the_coils_before_and_after_stand_at_one_scale(tmp_path):
    """The pair comes closer together: copper spans fewer rows on the right, as many columns."""
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
