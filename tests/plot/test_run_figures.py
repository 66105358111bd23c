"""Curves of runs over time: every curve is visible, and coinciding curves are drawn once."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from fieldmap.cli import main
from fieldmap.dynamics import simulate
from fieldmap.errors import InputError
from fieldmap.plot.runs import drawn_run, read_drawn_runs, run_figure, run_message
from fieldmap.plot.style import COLOURS, INK
from fieldmap.store import RunRecord, write_runs
from tests.refusals import refused

TIMES = np.linspace(0.0, 1.0, 11)


def run_with(currents, **others):
    run = dict.fromkeys(("wanted", "true", "seen"), np.zeros((11, 3))) | others
    return run | {"time": TIMES, "currents": currents, "coil_names": ("a", "b", "c", "d"), "event": ""}


def drawn(figure):
    lines = figure.axes[3].get_lines()
    return [(line.get_label(), np.asarray(line.get_ydata())) for line in lines]


def test_coils_with_one_current_share_a_curve_that_names_them():
    wave = np.sin(TIMES)
    currents = np.column_stack([wave, 2 * wave, wave * (1 + 1e-6), wave])
    (first, one), (second, two) = drawn(run_figure("Two curves", [run_with(currents)]))
    assert [name for name in "abcd" if name in first.split(":")[0].removeprefix("coils")] == ["a", "c", "d"]
    assert second == "coil b"
    np.testing.assert_array_equal(one, wave)
    np.testing.assert_array_equal(two, 2 * wave)


def test_coils_that_part_in_one_of_several_runs_have_their_own_curves():
    wave = np.column_stack([np.sin(TIMES)] * 4)
    parted = wave.copy()
    parted[5:, 3] += 0.1
    assert len(drawn(run_figure("Runs", [run_with(wave), run_with(parted)]))) == 4
    assert len(drawn(run_figure("Runs", [run_with(wave), run_with(wave)]))) == 2


def test_runs_of_one_combination_of_values_share_a_colour_that_a_legend_names():
    grid = [{"Kc": kc, "Td": td} for kc in (0.2, 0.3, 0.4) for td in (1, 2, 3)]
    still = np.zeros((11, 4))
    figure = run_figure("A grid", [run_with(still, varied=varied) for varied in [*grid, grid[1]]])
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "Kc, Td"
    *names, last = [text.get_text() for text in legend.get_texts()]
    assert names == [f"{kc}, {td}" for kc in (0.2, 0.3, 0.4) for td in (1, 2, 3)]
    assert last == "reference"
    of_legend = [(line.get_color(), line.get_linestyle()) for line in legend.get_lines()[:-1]]
    assert len(set(of_legend)) == 9
    *curves, _reference = figure.axes[2].get_lines()
    assert [(line.get_color(), line.get_linestyle()) for line in curves] == [*of_legend, of_legend[1]]
    other = run_with(still, varied=grid[1], wanted=np.ones((11, 3)))
    lines = run_figure("Two", [run_with(still, varied=grid[0]), other]).axes[2].get_lines()
    assert [line.get_ydata()[0] for line in lines if line.get_label() == "reference"] == [0.0, 1.0]
    alike = [run_with(still, varied=grid[0]), run_with(still, varied=grid[0])]
    assert not run_figure("One value", alike).legends


def test_the_unit_of_an_axis_follows_the_larger_of_what_is_wanted_and_what_comes():
    """Micrometres only if both reference and position are small: x leaves its rest by 2 mm, y does not."""
    true = np.zeros((11, 3))
    true[5] = [2.0, 0.004, 0.0]
    run = run_with(np.zeros((11, 4)), true=true)
    labels = [axes.get_ylabel() for axes in run_figure("Units", [run]).axes[:3]]
    assert [label.rsplit(" ", 1)[-1].strip("()[]") for label in labels] == ["mm", "µm", "mm"]


def readings(x=0.0, y=0.0, depth=0.0):
    """Readings (11, 3), mm, from numbers or columns."""
    return np.column_stack([np.broadcast_to(one, 11) for one in (x, y, depth)]).astype(float)


def shown_of(figure, panel):
    """Label, x, y and colour of each line of a panel."""
    lines = figure.axes[panel].get_lines()
    return [(one.get_label(), *map(np.asarray, one.get_data()), to_hex(one.get_color())) for one in lines]


LATER = np.array([0.15, 0.45, 0.85])


def measured(**signals):
    made = {name: SimpleNamespace(measured=np.asarray(values)) for name, values in signals.items()}
    return SimpleNamespace(time=LATER, signals=made)


def test_every_line_of_one_run_has_the_numbers_of_its_signal():
    """x in millimetres, y and depth in micrometres, a log over x and depth, and the event at the end of the depth."""
    wanted, true, seen = (
        readings(3.0, 0.1, 0.2),
        readings(2.0 + TIMES, 0.1 * TIMES, 0.3 * TIMES),
        readings(5.0, 0.4, 0.05),
    )
    currents = np.column_stack([TIMES, 2 - TIMES, 3 * TIMES, 4 * TIMES])
    log = measured(x=[1.0, 2.0, 3.0], depth=[0.1, 0.2, 0.3], b=[7.0, 8.0, 9.0])
    run = run_with(currents, wanted=wanted, true=true, seen=seen, measured=log) | {"event": "fell"}
    figure = run_figure("A title", [run])
    for panel, (name, factor, unit) in enumerate((("x", 1.0, "mm"), ("y", 1e3, "µm"), ("depth", 1e3, "µm"))):
        lines = shown_of(figure, panel)
        expected = [("sensor", TIMES, seen, "#bfbfbf"), ("true", TIMES, true, COLOURS[0].lower())]
        expected += [] if name == "y" else [("measured", LATER, None, COLOURS[1].lower())]
        expected += [("reference", TIMES, wanted, INK)]
        assert [label for label, *_ in lines] == [label for label, *_ in expected]
        for (label, x, y, colour), (_, times, values, shade) in zip(lines, expected, strict=True):
            shown = log.signals[name].measured if values is None else values[:, panel]
            np.testing.assert_allclose(x, times)
            np.testing.assert_allclose(y, factor * shown)
            assert colour == shade, label
        assert figure.axes[panel].get_ylabel() == f"{name}, {unit}"
    *places, lowest = figure.axes
    assert [axes.yaxis_inverted() for axes in places] == [False, False, True]
    assert [len(axes.texts) for axes in places] == [1, 0, 1]
    (event,) = places[2].texts
    assert (event.get_text(), event.xy[0], event.get_ha()) == ("fell", 1.0, "right")
    assert (lowest.get_xlabel(), lowest.get_ylabel()) == ("time, s", "currents, A")
    coils = shown_of(figure, 3)
    assert [label for label, *_ in coils[:4]] == [f"coil {name}" for name in "abcd"]
    for k, (_, x, y, colour) in enumerate(coils[:4]):
        np.testing.assert_allclose((x, y), (TIMES, currents[:, k]))
        assert colour == COLOURS[k].lower()
    # The log of coil b: dots in the coil's colour.
    _, x, y, colour = coils[4]
    assert (x.tolist(), y.tolist(), colour) == (LATER.tolist(), [7.0, 8.0, 9.0], COLOURS[1].lower())
    assert lowest.get_lines()[4].get_marker() == "."
    # The legends of the first and the last panel are above the axes, on the right.
    assert [axes.get_legend() is None for axes in figure.axes] == [False, True, True, False]
    figure.draw_without_rendering()
    assert places[2].bbox.y1 < event.get_window_extent().y0 < places[2].bbox.y1 + 10.0
    for axes in (places[0], lowest):
        box = axes.get_legend().get_window_extent()
        assert box.y0 >= axes.bbox.y1 - 1.0
        assert box.x1 == pytest.approx(axes.bbox.x1, abs=3.0)
        assert len({text.get_window_extent().y0 for text in axes.get_legend().get_texts()}) == 1
    title, message = places[0].get_title("left"), places[0].texts[0].get_text()
    assert (title, message) == ("A title", "Ended after 1 s: fell")
    widths = {line.get_label(): line.get_linewidth() for line in places[0].get_lines()}
    assert 0.4 < widths["sensor"] < widths["measured"] < widths["reference"] < widths["true"] < 2.0
    assert [line.get_linestyle() for line in places[0].get_lines()] == ["-", "-", "-", "--"]


def test_lines_of_several_runs_are_thin_and_of_the_truth_alone():
    runs = [
        run_with(np.full((11, 4), k), true=readings(k, 2 * k, 3 * k), seen=readings(9.0)) for k in (1.0, 2.0)
    ]
    del runs[0]["coil_names"]
    figure = run_figure("Two", runs)
    for panel in range(3):
        lines = shown_of(figure, panel)
        assert [label for label, *_ in lines] == ["true", "true", "reference"]
        assert [y[0] for _, _, y, _ in lines] == [panel + 1.0, 2.0 * (panel + 1.0), 0.0]
        assert 0.3 < figure.axes[panel].get_lines()[0].get_alpha() < 1.0
    assert figure.axes[0].get_legend() is None
    # Coils without names are numbered, and named once.
    labels = [label for label, *_ in shown_of(figure, 3)]
    assert labels[0] == "coils 1, 2, 3, 4: the same"
    assert labels[1].startswith("_")
    one, two = (line.get_alpha() for line in figure.axes[3].get_lines())
    (alone,) = run_figure("One", runs[:1]).axes[3].get_lines()
    assert 0.1 < one == two < alone.get_alpha() == 1.0
    assert 0.4 < alone.get_linewidth() < 1.5


@pytest.mark.parametrize(("apart", "curves"), [(0.0009, 1), (0.0011, 2)])
def test_currents_are_one_curve_within_a_thousandth_of_the_largest(apart, curves):
    currents = np.column_stack([np.zeros(11), np.full(11, -4.0), np.full(11, -4.0), 4.0 * apart * TIMES])
    lines = drawn(run_figure("Near", [run_with(currents)]))
    assert len(lines) == 1 + curves
    assert lines[0][0] == ("coils a, d: the same" if curves == 1 else "coil a")


def test_more_combinations_than_colours_have_other_kinds_of_lines():
    still = np.zeros((11, 4))
    figure = run_figure("Many", [run_with(still, varied={"k": k}) for k in range(25)])
    *curves, _ = figure.axes[0].get_lines()
    looks = [(to_hex(line.get_color()), line.get_linestyle()) for line in curves]
    assert looks == [(COLOURS[k % 8].lower(), ("-", "--", ":", "-.")[k // 8]) for k in range(25)]
    (legend,) = figure.legends
    figure.draw_without_rendering()
    box = legend.get_window_extent()
    assert box.y1 < figure.axes[3].bbox.y0
    assert 0.5 * (box.x0 + box.x1) == pytest.approx(0.5 * figure.bbox.width, rel=0.02)
    assert legend.get_texts()[0].get_fontsize() == legend.get_title().get_fontsize() == 8.0
    assert legend._ncols == 6


UP = np.where(TIMES < 0.25, 0.0, 2.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        # A step of 2 mm after 0.2 s: 10 % overshoot, and last outside 5 %, by 5.5 %, at 0.6 s.
        (
            {
                "wanted": readings(y=UP),
                "true": readings(y=UP + [0, 0, 0, -1, 0.2, -0.2, 0.11, 0.09, -0.09, 0, 0]),
            },
            "A step of 2 mm in y: overshoot 10 %, within 5 % after 0.5 s",
        ),
        # A step downward in micrometres, never beyond it, and not within 5 % at the end.
        (
            {
                "wanted": readings(depth=-0.1 * UP),
                "true": readings(depth=-0.1 * np.where(TIMES < 0.35, 0.0, 1.8)),
            },
            "A step of 200 µm in depth: overshoot 0 %, not there at the end",
        ),
        # Two moves are no step, and neither is a step there and back.
        (
            {"wanted": readings(x=UP + (TIMES > 0.75)), "true": readings(x=UP, depth=0.7)},
            "At most 1.2 mm from what was asked",
        ),
        ({"wanted": readings(x=UP * (TIMES < 0.75)), "true": readings()}, "At most 2 mm from what was asked"),
        ({"true": readings(0.003, 0.004)}, "At most 5 µm from what was asked"),
        ({"true": readings(0.3, 0.4)}, "At most 0.5 mm from what was asked"),
        ({"true": readings(0.3, 0.39)}, "At most 490 µm from what was asked"),
        ({"event": "hit the wall"}, "Ended after 1 s: hit the wall"),
    ],
)
def test_what_one_run_shows_in_words(changes, message):
    assert run_message([run_with(np.zeros((11, 4))) | changes]) == message


def test_what_several_runs_show_in_words():
    still = run_with(np.zeros((11, 4)))
    off, fell = still | {"true": readings(0.0, -1.2, 0.5)}, still | {"event": "fell"}
    assert run_message([still, off]) == "2 runs, none ended early; at most 1.3 mm from what was asked"
    assert run_message([fell, off, fell]) == "3 runs, 2 ended early; at most 1.3 mm from what was asked"


def test_what_is_drawn_of_a_run():
    """Sensed points in m become readings; a run that ended at once has one sample of zero."""
    places = [1e-3 * np.array([[k, 2.0 * k, -80.0 - k]]) for k in (1.0, 2.0, 3.0)]
    of = {"scenario": SimpleNamespace(zero_depth_mm=77.0), "coil_names": ("a", "b")}
    about = {"time": np.array([0.5]), "currents": np.array([[1.0, 2.0]]), "coils": 2}
    run = SimpleNamespace(references=places[0], sensed=places[1], seen=places[2], **about, **of)
    run.metrics = SimpleNamespace(event="fell")
    found = drawn_run(run, {"k": 3})
    for name, k in (("wanted", 1.0), ("true", 2.0), ("seen", 3.0)):
        np.testing.assert_allclose(found[name], [[k, 2.0 * k, 3.0 + k]])
    assert (found["time"].tolist(), found["currents"].tolist()) == ([0.5], [[1.0, 2.0]])
    assert (found["coil_names"], found["event"], found["varied"]) == (("a", "b"), "fell", {"k": 3})
    at_once = {"time": np.empty(0), "coils": 2, "metrics": SimpleNamespace(event="at once")}
    ended = drawn_run(SimpleNamespace(**of, **at_once))
    assert (ended["time"].tolist(), ended["currents"].tolist(), ended["varied"]) == ([0.0], [[0.0, 0.0]], {})
    assert {ended[name].tolist() == [[0.0, 0.0, 0.0]] for name in ("wanted", "true", "seen")} == {True}
    assert run_message([ended]) == "Ended after 0 s: at once"


def test_the_unit_of_an_axis_changes_at_half_a_millimetre():
    for largest, unit in ((0.5, "mm"), (0.499, "µm"), (0.0, "mm")):
        true = readings(np.where(TIMES > 0.5, np.nan, -largest))
        label = run_figure("Unit", [run_with(np.zeros((11, 4)), true=true)]).axes[0].get_ylabel()
        assert label == f"x, {unit}"


def test_a_path_in_x_and_y_has_a_panel_with_the_numbers_of_the_signals():
    """Both in millimetres, since x is large, one scale, a dot at the start, and one line for each reference."""
    wanted = readings(2.0 * np.cos(TIMES), 0.5 * np.sin(TIMES))
    one = readings(2.1 * np.cos(TIMES), 0.4 * np.sin(TIMES), 0.1 * TIMES)
    other = one * [1.0, -1.0, 1.0]
    first = run_with(np.zeros((11, 4)), wanted=wanted, true=one, varied={"k": 1})
    second = run_with(np.zeros((11, 4)), wanted=wanted, true=other, varied={"k": 2})
    for runs, shades in (([first], COLOURS[:1]), ([first, second], COLOURS[:2])):
        figure = run_figure("A path", runs)
        path = figure.axes[4]
        assert (path.get_xlabel(), path.get_ylabel(), path.get_aspect()) == ("x, mm", "y, mm", 1.0)
        expected = []
        for run, shade in zip(runs, shades, strict=True):
            x, y, _ = run["true"].T
            expected += [("true", x, y, shade.lower()), ("start", x[:1], y[:1], shade.lower())]
        expected.append(("reference", *wanted.T[:2], INK))
        found = shown_of(figure, 4)
        assert [label for label, *_ in found] == [label for label, *_ in expected]
        for (label, x, y, shade), (_, *values, colour) in zip(found, expected, strict=True):
            np.testing.assert_array_equal((x, y), values)
            assert shade == colour, label
        assert [line.get_marker() for line in path.get_lines()][:2] == ["None", "o"]


def test_a_small_path_is_in_micrometres():
    circle = readings(0.1 * np.cos(9 * TIMES), 0.1 * np.sin(9 * TIMES))
    path = run_figure("Small", [run_with(np.zeros((11, 4)), wanted=circle, true=circle)]).axes[4]
    assert (path.get_xlabel(), path.get_ylabel()) == ("x, µm", "y, µm")
    np.testing.assert_allclose(path.get_lines()[0].get_xydata(), 1e3 * circle[:, :2])


@pytest.mark.parametrize(
    ("wanted", "true", "there"),
    [
        # The reference decides: both sides longer than the depth, the shorter more than a quarter of the longer.
        (readings(4 * TIMES, 1.01 * TIMES, TIMES), readings(), True),
        (readings(1.01 * TIMES, 4 * TIMES, TIMES), readings(), True),
        (readings(4 * TIMES, 0.99 * TIMES), readings(TIMES, TIMES), False),
        (readings(4 * TIMES, 3 * TIMES, 3.01 * TIMES), readings(TIMES, TIMES), False),
        (readings(0, 0, TIMES), readings(TIMES, TIMES), False),
        # Where it stands still, bodies that move by more than half a millimetre.
        (readings(1, 2, 3), readings(0.51 * TIMES, 0.51 * TIMES, 0.5 * TIMES), True),
        (readings(1, 2, 3), readings(0.51 * TIMES, 0.49 * TIMES), False),
    ],
)
def test_a_panel_of_the_path_is_for_motion_in_the_plane(wanted, true, there):
    figure = run_figure("Where", [run_with(np.zeros((11, 4)), wanted=wanted, true=true)])
    assert len(figure.axes) == (5 if there else 4)
    assert (figure.get_figwidth() > 10.0) == there


def write_steps(path, *overshoots, coils=("a", "b"), values=("",), **changes):
    """A file of runs whose depth, 77 mm below the origin, steps by 1 mm at 0.25 s with these overshoots."""
    step = np.where(TIMES > 0.25, 1e-3, 0.0)
    records = []
    for over, value in zip(overshoots, values, strict=True):
        depth = step * (1.0 + over * (TIMES < 0.75))
        place, wanted, seen = (
            np.column_stack([0.001 + 0 * TIMES, 0.002 + 0 * TIMES, -0.077 - one])
            for one in (depth, step, 2 * depth)
        )
        arrays = {"time": (TIMES, "s", "time"), "sensed": (place, "m", "x"), "seen": (seen, "m", "x")}
        arrays |= {"reference": (wanted, "m", "x")}
        arrays["currents"] = (
            np.column_stack([(k + over) * TIMES for k in range(len(coils))]),
            "A",
            ", ".join(coils),
        )
        about = {"event": "", "value": value, "zero_depth_mm": 77.0} | changes
        records.append(RunRecord(arrays, {name: one for name, one in about.items() if one is not None}))
    return write_runs(path, records, {"title": "Steps"})


def test_runs_of_several_files_lie_over_one_another(tmp_path):
    """Each run has its colour in every panel and its file's name in the legend; coils and values may differ."""
    files = [
        write_steps(tmp_path / "before.h5", 0.5),
        write_steps(tmp_path / "after.h5", 0.1, 0.0, coils=("a",), values=("Kc = 2", "Kc = 3")),
    ]
    title, runs = read_drawn_runs(files)
    assert title == "Steps"
    np.testing.assert_allclose(
        runs[0]["true"][:4], [[1, 2, 0], [1, 2, 0], [1, 2, 0], [1, 2, 1.5]], atol=1e-12
    )
    np.testing.assert_allclose(runs[0]["seen"][3], [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(runs[0]["wanted"][-1], [1, 2, 1], atol=1e-12)
    figure = run_figure(title, runs)
    names = ["before", "after, Kc = 2", "after, Kc = 3"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*names, "reference"]
    shades = [to_hex(line.get_color()) for line in legend.get_lines()]
    assert shades == [*(colour.lower() for colour in COLOURS[:3]), INK]
    for panel, column in ((0, 0), (1, 1), (2, 2)):
        *lines, (_, _, wanted, shade) = shown_of(figure, panel)
        assert shade == INK
        np.testing.assert_allclose(wanted, runs[0]["wanted"][:, column])
        for (_, times, values, colour), run, expected in zip(lines, runs, shades, strict=False):
            np.testing.assert_array_equal(times, TIMES)
            np.testing.assert_allclose(values, run["true"][:, column])
            assert colour == expected
    # The roughest currents, with the largest changes, are drawn first: before, with two coils, then Kc = 2 and Kc = 3.
    currents = figure.axes[3].get_lines()
    assert [to_hex(line.get_color()) for line in currents] == [shades[0], shades[0], shades[1], shades[2]]
    assert [line.get_linestyle() for line in currents] == ["-", "--", "-", "-"]
    assert [line.get_ydata()[-1] for line in currents] == [0.5, 1.5, 0.1, 0.0]
    told = "A step of 1 mm in depth: overshoot before 50 %, after, Kc = 2 10 %, after, Kc = 3 0 %"
    assert run_message(runs) == told
    # Steps of different sizes, and more than four runs, have no overshoots to compare.
    other = runs[0] | {"wanted": 2 * runs[0]["wanted"], "varied": {"run": "other"}}
    assert run_message([*runs, other]).startswith("4 runs")
    assert run_message([*runs, runs[0], runs[1]]).startswith("5 runs")


def test_names_of_runs(tmp_path):
    """Given names, or those of the files, with their folders if the names are equal."""
    (tmp_path / "b").mkdir()
    files = [write_steps(tmp_path / "run.h5", 0.5), write_steps(tmp_path / "b" / "run.h5", 0.1)]
    assert [run["varied"] for run in read_drawn_runs(files)[1]] == [{"run": str(file)} for file in files]
    assert [run["varied"]["run"] for run in read_drawn_runs(files, ["one", "two"])[1]] == ["one", "two"]
    with refused(InputError, where="read_drawn_runs(names)"):
        read_drawn_runs(files, ["one"])


@pytest.mark.parametrize(
    "missing", ["time", "sensed", "seen", "reference", "currents", "zero", "rows", "runs"]
)
def test_a_file_without_what_is_drawn_is_refused(tmp_path, missing):
    path = tmp_path / "run.h5"
    arrays = {"time": (TIMES, "s", "time"), "currents": (TIMES[:, None], "A", "a")}
    arrays |= dict.fromkeys(("sensed", "seen", "reference"), (np.zeros((11, 3)), "m", "x"))
    if missing == "rows":
        arrays["currents"] = (TIMES[:5, None], "A", "a")
    arrays.pop(missing, None)
    about = {} if missing == "zero" else {"zero_depth_mm": 77.0}
    write_runs(path, [] if missing == "runs" else [RunRecord(arrays, about)], {"title": ""})
    with refused(InputError, where=str(path)):
        read_drawn_runs([path])


def test_a_run_is_drawn_as_its_file_is(written, tmp_path):
    path, file = written(), tmp_path / "run.h5"
    assert main(["simulate", str(path), "--seed", "3", "-o", str(file)]) == 0
    figures = [run_figure("", runs) for runs in ([simulate(path, seed=3)], read_drawn_runs([file])[1])]
    of_run, of_file = ([line for axis in figure.axes for line in axis.get_lines()] for figure in figures)
    assert len(of_run) >= 10
    for one, other in zip(of_run, of_file, strict=True):
        assert one.get_label() == other.get_label()
        np.testing.assert_allclose(one.get_xydata(), other.get_xydata(), atol=1e-12)


def test_show_draws_several_runs(tmp_path, capsys):
    files = [str(write_steps(tmp_path / f"{name}.h5", over)) for name, over in (("one", 0.5), ("two", 0.1))]
    picture = tmp_path / "both.svg"
    assert main(["show", *files, "--save", str(picture)]) == 0
    assert capsys.readouterr().out.strip() == str(picture)
    text = picture.read_text()
    assert all(f"<!-- {name} -->" in text for name in ("one", "two", "reference"))
    assert main(["show", files[0], "--what", "curves", "--save", str(tmp_path / "one.png")]) == 0
    capsys.readouterr()
    wrong = [*files, "drive_unit", "--what", "path", "--currents", "1", "--json"]
    assert main(["show", *wrong]) == 2
    problems = json.loads(capsys.readouterr().out)["problems"]
    assert [problem["where"] for problem in problems] == ["drive_unit", "--currents", "--what", "--save"]
    assert main(["show", *files, "--save", str(tmp_path / "both.html")]) == 2
