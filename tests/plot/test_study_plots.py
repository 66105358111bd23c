"""The plot of a study shows all numbers of its data set, in printed units, with units on the axes."""

import warnings

import numpy as np
import pytest
from matplotlib import colormaps

from fieldmap.plot.studies import save_study_plot, study_figure, study_message
from fieldmap.studies.quantities import QUANTITIES

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # warnings of its own imports
    import xarray

AREA = next(quantity for quantity in QUANTITIES if quantity.name == "equilibrium_area")


def data_set(*axes):
    """Areas of 1, 2, 3 ... mm2 over the axes (name, values), and a variable that is no summary."""
    coords = {name: (name, np.array(values), {"units": "mm"}) for name, values in axes}
    names = tuple(coords)
    shape = tuple(len(values) for _, values in axes)
    areas = 1e-6 * (1.0 + np.arange(np.prod(shape))).reshape(shape)
    variables = {"equilibrium_area": (names, areas), "surface_faces": (names, areas)}
    return xarray.Dataset(variables, coords=coords, attrs={"title": "Areas"})


@pytest.mark.parametrize(
    ("axes", "lines"),
    [
        ([("radius", [56.0, 66.0]), ("currents", ["a"])], 1),
        ([("radius", [56.0, 66.0]), ("currents", ["a", "b"])], 2),
        ([("radius", [56.0, 66.0]), ("thickness", [3.0, 6.0, 9.0]), ("currents", ["a", "b"])], 6),
        ([("radius", [5.0, 6.0]), ("thickness", [3.0, 6.0]), ("gap", [1.0, 2.0]), ("currents", ["a"])], 4),
        ([("variant", ["thin", "thick", "none"]), ("currents", ["a"])], 1),
    ],
)
def test_every_number_is_drawn_once(axes, lines, tmp_path):
    data = data_set(*axes)
    figure = study_figure(data, [AREA])
    (panel,) = figure.axes
    assert len(panel.lines) == lines
    drawn = np.sort(np.concatenate([line.get_ydata() for line in panel.lines]))
    np.testing.assert_allclose(drawn, 1.0 + np.arange(data.equilibrium_area.size))
    assert panel.get_ylabel() == "equilibrium area (mm²)"
    looks = {(str(line.get_color()), line.get_linestyle()) for line in panel.lines}
    assert len(looks) == lines
    path = save_study_plot(data, tmp_path / "study.png")
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_the_abscissa_is_the_first_key_with_its_unit():
    data = data_set(("radius", [56.0, 66.0]), ("thickness", [3.0, 6.0]), ("currents", ["a"]))
    figure = study_figure(data, [AREA])
    (panel,) = figure.axes
    assert panel.get_xlabel() == "radius (mm)"
    by_label = {line.get_label(): line for line in panel.lines}
    np.testing.assert_allclose(by_label["thickness 6 mm"].get_xdata(), [56.0, 66.0])
    np.testing.assert_allclose(by_label["thickness 6 mm"].get_ydata(), [2.0, 4.0])


def test_nothing_to_draw(tmp_path):
    data = data_set(("radius", [56.0]), ("currents", ["a"])).drop_vars("equilibrium_area")
    assert save_study_plot(data, tmp_path / "none.png") is None
    assert not list(tmp_path.iterdir())


def values_of(names, axes, **attrs):
    """A data set of these summaries over the axes (name, values, unit): 1, 2, 3 ... times a power of ten."""
    coords = {name: (name, np.array(values), {"units": unit}) for name, values, unit in axes}
    shape = tuple(len(values) for _, values, _ in axes)
    variables = {
        name: (tuple(coords), 10.0**-k * (1.0 + np.arange(np.prod(shape))).reshape(shape))
        for k, name in enumerate(names)
    }
    return xarray.Dataset(variables, coords=coords, attrs=attrs)


def of(*names):
    return [next(quantity for quantity in QUANTITIES if quantity.name == name) for name in names]


def test_every_summary_has_a_label_and_its_printed_unit():
    """With the factor of its unit: areas in mm², lengths in mm, shares in % ..."""
    expected = {
        "common_current": ("mean current (A)", 1.0),
        "equilibrium_x": ("equilibrium $x$ (mm)", 1e3),
        "equilibrium_y": ("equilibrium $y$ (mm)", 1e3),
        "stiffness_x": ("stiffness $k_x$ (N/m)", 1.0),
        "stiffness_y": ("stiffness $k_y$ (N/m)", 1.0),
        "stiffness_z": ("stiffness $k_z$ (N/m)", 1.0),
        "equilibrium_area": ("equilibrium area (mm²)", 1e6),
        "reach_height": ("reach, lowest $z$ (mm)", 1e3),
        "reachable_share": ("reachable share of workspace (%)", 100.0),
        "largest_flux_density": ("largest $B$ in the iron (T)", 1.0),
        "error_flux_density": ("estimated error of $B$ (%)", 100.0),
    }
    data = values_of(expected, [("radius", [56.0, 66.0], "mm"), ("currents", ["a"], "")])
    for name, (label, factor) in expected.items():
        (axes,) = study_figure(data, of(name)).axes
        assert axes.get_ylabel() == label
        np.testing.assert_allclose(axes.lines[0].get_ydata(), factor * data[name].values[:, 0])


@pytest.mark.parametrize(
    ("count", "rows", "columns"), [(1, 1, 1), (2, 1, 2), (3, 1, 3), (4, 2, 3), (7, 3, 3)]
)
def test_panels_stand_in_rows_of_three(count, rows, columns):
    names = [
        q.name
        for q in QUANTITIES
        if q.name in ("common_current", "stiffness_x", "stiffness_y", "stiffness_z")
    ]
    names += ["equilibrium_x", "equilibrium_y", "equilibrium_area"]
    data = values_of(
        names[:count], [("radius", [56.0, 66.0], "mm"), ("currents", ["a", "b"], "")], title="A study"
    )
    figure = study_figure(data, of(*names[:count]))
    grids = [axes.get_subplotspec().get_geometry() for axes in figure.axes]
    assert grids == [(rows, columns, k, k) for k in range(count)]
    width, height = figure.get_size_inches()
    # Room for titles above, a legend below, and numbers on the left.
    assert 3.1 * columns < width < 3.1 * columns + 1.0
    assert 2.4 * rows + 0.5 < height < 2.4 * rows + 1.5
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["currents a", "currents b"]
    if count == 4:
        figure.draw_without_rendering()
        assert (
            legend.get_window_extent().y1 < min(axes.xaxis.get_tightbbox().y0 for axes in figure.axes) + 3.0
        )
    assert names[0] == "common_current"
    assert figure.get_suptitle() == "Least mean current: 1 A at radius 56 mm, currents a\nA study"


def test_colour_kind_of_line_and_mark_of_three_varied_keys():
    axes = [
        ("r", [1.0, 2.0], "mm"),
        ("t", [3.0, 4.0, 5.0], "mm"),
        ("gap", [0.1, 0.2, 0.3, 0.4, 0.5], ""),
        ("currents", ["a"], ""),
    ]
    (panel,) = study_figure(values_of(["common_current"], axes), of("common_current")).axes
    looks = {
        line.get_label(): (line.get_color(), line.get_linestyle(), line.get_marker()) for line in panel.lines
    }
    shades = colormaps["viridis"](np.array([0.0, 0.41, 0.82]))
    assert len(looks) == 15
    for k, t in enumerate(("3", "4", "5")):
        for j, gap in enumerate(("0.1", "0.2", "0.3", "0.4", "0.5")):
            colour, kind, mark = looks[f"t {t} mm, gap {gap}"]
            np.testing.assert_allclose(colour, shades[k])
            assert (kind, mark) == (["-", "--", ":", "-."][j % 4], "osD^v"[j])
    # With one more key, colour and line style both show its value.
    (panel,) = study_figure(values_of(["common_current"], [axes[0], axes[1]]), of("common_current")).axes
    np.testing.assert_allclose([line.get_color() for line in panel.lines], shades)
    # A single line needs no legend.
    alone = study_figure(values_of(["common_current"], [axes[0]]), of("common_current"))
    assert alone.legends == []
    np.testing.assert_allclose(alone.axes[0].lines[0].get_color(), shades[0])
    # The sixth mark is the first again.
    six = [axes[0], ("t", [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "mm")]
    (panel,) = study_figure(values_of(["common_current"], six), of("common_current")).axes
    assert [line.get_marker() for line in panel.lines] == list("osD^vo")


@pytest.mark.parametrize(
    ("along", "limits"),
    [
        ([56.0, 66.0], (55.4, 66.6)),
        ([5.0], (4.94, 5.06)),
        ([2, 4], (1.88, 4.12)),
        (["thin", "thick", "none"], (-0.12, 2.12)),
    ],
)
def test_six_hundredths_of_room_on_either_side(along, limits):
    data = values_of(["common_current"], [("key", along, ""), ("currents", ["a"], "")])
    (panel,) = study_figure(data, of("common_current")).axes
    assert panel.get_xlim() == pytest.approx(limits)
    assert panel.get_xlabel() == "key"
    if isinstance(along[0], str):
        assert [text.get_text() for text in panel.get_xticklabels()] == along
        assert panel.get_xticks().tolist() == [0, 1, 2]
        assert {text.get_rotation() for text in panel.get_xticklabels()} == {30.0}
        np.testing.assert_allclose(panel.lines[0].get_xdata(), [0, 1, 2])
    else:
        np.testing.assert_allclose(panel.lines[0].get_xdata(), along)
    low, high = panel.get_ylim()
    drawn = panel.lines[0].get_ydata()
    if len(along) > 1:
        assert (drawn.min() - low, high - drawn.max()) == pytest.approx((0.12 * np.ptp(drawn),) * 2)
    letters = {
        panel.xaxis.label.get_size(),
        panel.yaxis.label.get_size(),
        panel.get_xticklabels()[0].get_size(),
    }
    assert letters == {8}


def test_the_message_says_where_the_first_summary_is_least():
    axes = [("radius", [56.0, 66.0], "mm"), ("area", [1.5, 2.5], "mm2"), ("currents", ["a"], "")]
    data = values_of(["equilibrium_area"], axes)
    (area,) = of("equilibrium_area")
    data["equilibrium_area"].values[...] = 1e-6 * np.array([[[4.0], [np.nan]], [[7.0], [3.25]]])
    assert study_message(data, area) == "Least equilibrium area: 3.25 mm² at radius 66 mm, area 2.5 mm²"
    data["equilibrium_area"].values[...] = np.nan
    assert study_message(data, area) == ""
    (share,) = of("reachable_share")
    assert (
        study_message(values_of(["reachable_share"], [("r", [1.0], "")]), share)
        == "Least reachable share of workspace: 100 %"
    )
    assert study_figure(data, [area]).get_suptitle() == ""


@pytest.mark.parametrize(("size", "drawn"), [(1.1e-12, True), (0.9e-12, False), (np.nan, False)])
def test_what_is_rounding_alone_is_not_drawn(size, drawn, tmp_path):
    """A millionth of the printed unit, mm², is rounding; nor is a summary on axes of its own drawn."""
    data = values_of(
        ["equilibrium_area", "surface_faces"], [("radius", [1.0, 2.0], "mm"), ("currents", ["a"], "")]
    )
    data["equilibrium_area"].values[...] = [[-size], [np.nan]]
    assert (save_study_plot(data, tmp_path / "a.png") is not None) == drawn
