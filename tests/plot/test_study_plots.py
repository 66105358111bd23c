"""The plot of a study shows the numbers of its data set: every line, in printed units, with units on the axes."""

import warnings

import numpy as np
import pytest

from fieldmap.plot.studies import save_study_plot, study_figure
from fieldmap.studies.quantities import QUANTITIES

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of its own imports
    import xarray

AREA = next(quantity for quantity in QUANTITIES if quantity.name == "equilibrium_area")


def data_set(*axes):
    """Areas of 1, 2, 3 ... mm2 over the axes (name, values), and something that is not a summary."""
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
