"""Slices and lines in Axes: what is drawn is the field, where it is asked for."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import fieldmap as fm
from fieldmap.constants import GRAVITY
from fieldmap.errors import InputError
from fieldmap.plot import field_along, field_slice, force_slice
from tests.plot.conftest import Harmonic

BOX = np.array([-0.02, -0.03, -0.04]), np.array([0.02, 0.03, 0.06])


# (x, y, -2 z) T with lengths in m, 0.5 T along z, and a slope dBz/dz that rises with z.
LINEAR, UNIFORM, RISING = (Harmonic(*abc, BOX) for abc in ((0, -2, 0), (0.5, 0, 0), (0, 0, 2)))


@pytest.fixture
def ax():
    return Figure().add_subplot()


def test_a_slice_is_drawn_into_the_axes_given_and_returns_them(ax):
    assert field_slice(LINEAR, [2.0], ax=ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (mm)", "z (mm)")
    assert ax.get_title() == "plane y = 0 mm"
    np.testing.assert_allclose(ax.get_xlim(), [-20.0, 20.0], rtol=0.02)
    np.testing.assert_allclose(ax.get_ylim(), [-40.0, 60.0], rtol=0.02)
    bar = ax.figure.axes[1]
    assert bar.get_ylabel() == "size of B (mT)"
    # |B| in the plane reaches 2 |(x, -2 z)| at the corner (20, 60) mm, a half cell within.
    assert 240.0 <= bar.get_ylim()[1] <= 300.0


@pytest.mark.parametrize(
    ("normal", "labels", "component", "range_mT"),
    [
        ("x", ("y (mm)", "z (mm)"), "By", (-30.0, 30.0)),
        ("y", ("x (mm)", "z (mm)"), "Bx", (-20.0, 20.0)),
        ("z", ("x (mm)", "y (mm)"), "Bz", (-22.0, -18.0)),
    ],
)
def test_planes_and_components(ax, normal, labels, component, range_mT):
    field_slice(LINEAR, [1.0], normal=normal, at=0.01, component=component, ax=ax)
    assert (ax.get_xlabel(), ax.get_ylabel()) == labels
    assert ax.get_title() == f"plane {normal} = 10 mm"
    low, high = ax.figure.axes[1].get_ylim()
    # Levels are round numbers around what there is.
    assert low <= range_mT[0] * 0.9
    assert high >= range_mT[1] * 0.9
    assert ax.collections[0].get_array().min() >= low - 1e-9


def test_colours_are_those_of_the_field(ax):
    field_slice(LINEAR, [1.0], component="Bz", ax=ax)
    contours = ax.collections[0]
    point = np.array([5.0, 30.0])  # mm: Bz = -60 mT
    (hit,) = [k for k, path in enumerate(contours.get_paths()) if path.contains_point(point)]
    assert contours.levels[hit] <= -60.0 <= contours.levels[hit + 1]


def test_a_uniform_field_has_one_colour(ax):
    field_slice(UNIFORM, [1.0], ax=ax)
    low, high = ax.figure.axes[1].get_ylim()
    assert low <= 500.0 <= high


def test_forces_have_arrows_and_a_line_where_the_payload_is_carried(ax):
    mass, moment, carried = 0.01, 0.3, 0.03
    current = mass * GRAVITY / (2.0 * carried * moment)
    force_slice(RISING, [current], payload=fm.Payload(mass=mass, moment=moment), ax=ax)
    line = ax.collections[1]
    heights = np.concatenate([path.vertices[:, 1] for path in line.get_paths()])
    np.testing.assert_allclose(heights, 1e3 * carried, rtol=1e-3)
    (arrows,) = [one for one in ax.collections if type(one).__name__ == "Quiver"]
    by_hand = mass * GRAVITY * (1e-3 * arrows.Y / carried - 1.0)
    np.testing.assert_allclose(arrows.V, by_hand, rtol=1e-9)


def test_a_line_has_three_components_over_its_coordinate(ax):
    assert field_along(LINEAR, [1.0], start=[0.0, 0.01, -0.04], end=[0.0, 0.01, 0.06], ax=ax) is ax
    assert ax.get_xlabel() == "z (mm)"
    x, y, z = ax.lines
    np.testing.assert_allclose(z.get_ydata(), -2.0 * z.get_xdata())
    np.testing.assert_allclose(y.get_ydata(), 10.0)
    np.testing.assert_allclose(x.get_ydata(), 0.0)


def test_a_slanted_line_is_over_its_length(ax):
    field_along(LINEAR, [1.0], start=[0, 0, 0], end=[0.003, 0.0, 0.004], points=6, ax=ax)
    assert ax.get_xlabel() == "distance from the start (mm)"
    np.testing.assert_allclose(ax.lines[0].get_xdata(), np.arange(6.0))


def test_without_axes_the_current_ones_of_matplotlib_are_taken():
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    ax = pyplot.figure().add_subplot()
    try:
        assert field_slice(LINEAR, [1.0]) is ax
    finally:
        pyplot.close("all")


@pytest.mark.parametrize("given", [{"normal": "w"}, {"component": "B"}, {"currents": [1.0, 2.0]}])
def test_what_is_no_slice_is_refused(ax, given):
    with pytest.raises(InputError):
        field_slice(**({"field": LINEAR, "currents": [1.0], "ax": ax} | given))


def test_a_field_without_a_box_needs_one(ax):
    boundless = Harmonic(0, -2, 0)
    with pytest.raises(InputError):
        field_slice(boundless, [1.0], ax=ax)
    field_slice(boundless, [1.0], bounds=BOX, ax=ax)
