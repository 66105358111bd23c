"""Curves of runs over time: every curve is seen, and those that lie on each other are drawn once."""

import numpy as np

from fieldmap.plot.runs import run_figure

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
    names = [text.get_text() for text in legend.get_texts()]
    assert names == [f"{kc}, {td}" for kc in (0.2, 0.3, 0.4) for td in (1, 2, 3)]
    of_legend = [(line.get_color(), line.get_linestyle()) for line in legend.get_lines()]
    assert len(set(of_legend)) == 9
    *curves, _reference = figure.axes[2].get_lines()
    assert [(line.get_color(), line.get_linestyle()) for line in curves] == [*of_legend, of_legend[1]]
    other = run_with(still, varied=grid[1], wanted=np.ones((11, 3)))
    lines = run_figure("Two", [run_with(still, varied=grid[0]), other]).axes[2].get_lines()
    assert [line.get_ydata()[0] for line in lines if line.get_label() == "reference"] == [0.0, 1.0]
    alike = [run_with(still, varied=grid[0]), run_with(still, varied=grid[0])]
    assert not run_figure("One value", alike).legends


def test_the_unit_of_an_axis_follows_the_larger_of_what_is_wanted_and_what_comes():
    """Millimetres but where both are small: an axis that should stay and leaves by 2 mm, one that does not."""
    true = np.zeros((11, 3))
    true[5] = [2.0, 0.004, 0.0]
    run = run_with(np.zeros((11, 4)), true=true)
    labels = [axes.get_ylabel() for axes in run_figure("Units", [run]).axes[:3]]
    assert [label.rsplit(" ", 1)[-1].strip("()[]") for label in labels] == ["mm", "µm", "mm"]
