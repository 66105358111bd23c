"""Slices and lines in Axes: the drawn values are the field's at the requested places."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import fieldmap as fm
from fieldmap.constants import GRAVITY
from fieldmap.errors import InputError
from fieldmap.lookup import MagneticBody, interpolate
from fieldmap.plot import field_along, field_slice, force_slice, sensing_slice
from fieldmap.store import Grid, MapData, StoredSensors
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
    # |B| in the plane reaches 2 |(x, -2 z)| at the corner (20, 60) mm, less half a cell.
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
    # Levels are round numbers around the values.
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


def test_colours_have_round_levels_and_the_bar_numbers_at_every_fifth(ax):
    """Bz = -2 z from -118.77 to 78.77 mT at the centres of 81 cells: steps of 50 mT, divided by five."""
    field_slice(LINEAR, [1.0], component="Bz", ax=ax)
    contours, (_, bar) = ax.collections[0], ax.figure.axes
    np.testing.assert_allclose(contours.levels, np.arange(-150.0, 101.0, 10.0), atol=1e-9)
    np.testing.assert_allclose(bar.get_yticks(), np.arange(-150.0, 101.0, 50.0), atol=1e-9)
    assert ax.get_aspect() == 1.0
    assert not any(line.get_visible() for line in ax.xaxis.get_gridlines())
    across, up = (np.concatenate([path.vertices[:, k] for path in contours.get_paths()]) for k in range(2))
    assert (across.min(), across.max()) == pytest.approx((-20 + 20 / 61, 20 - 20 / 61))
    assert (up.min(), up.max()) == pytest.approx((-40 + 50 / 81, 60 - 50 / 81))


@pytest.mark.parametrize(("flux", "levels"), [(0.5, (500.0, 600.0)), (0.0, (0.0, 0.2)), (-0.006, (6.0, 7.0))])
def test_one_colour_has_a_bar_of_one_step(ax, flux, levels):
    field_slice(Harmonic(flux, 0, 0, BOX), [1.0], ax=ax)
    assert ax.collections[0].levels == pytest.approx(np.linspace(*levels, 6))


def test_what_a_slice_of_forces_says(ax):
    """White arrows at 9 by 13 places, the longest in the title; red where lift is the weight, here and on the bar."""
    mass, moment, carried = 0.01, 0.3, 0.03
    current = mass * GRAVITY / (2.0 * carried * moment)
    force_slice(RISING, [current], payload=fm.Payload(mass=mass, moment=moment), at=0.01, normal="x", ax=ax)
    shaded, line, arrows = ax.collections
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("y (mm)", "z (mm)")
    bar = ax.figure.axes[1]
    assert bar.get_ylabel() == "lift / weight"
    # From -40 to 60 mm the lift is -1.31 to 1.98 times the weight.
    assert shaded.levels[[0, -1]] == pytest.approx([-2.0, 2.0])
    (mark,) = bar.lines
    assert list(mark.get_ydata()) == [1.0, 1.0]
    assert 1.0 < line.get_linewidths()[0] == mark.get_linewidth() < 2.5
    assert (len(arrows.X), arrows.pivot) == (9 * 13, "middle")
    assert np.unique(arrows.X) == pytest.approx(-30 + (np.arange(9) + 0.5) / 9 * 60)
    assert np.unique(arrows.Y) == pytest.approx(-40 + (np.arange(13) + 0.5) / 13 * 100)
    np.testing.assert_allclose(arrows.get_facecolor(), [[1.0, 1.0, 1.0, 1.0]])
    assert 0.003 < arrows.width < 0.02
    # The lowest row, z = -36.2 mm, has the largest net force.
    x, y, z = 0.01, 1e-3 * np.abs(arrows.X).max(), -0.04 + 0.1 * 0.5 / 13
    by_hand = mass * GRAVITY / carried * np.linalg.norm([0.5 * x, 0.5 * y, z - carried])
    assert ax.get_title() == f"arrows: net force, up to {1e3 * by_hand:.2g} mN"


def test_forces_that_nowhere_carry_have_no_red_line_and_small_ones_micronewtons(ax):
    payload = fm.Payload(mass=1e-6, moment=1e-6)
    force_slice(RISING, [1.0], payload=payload, ax=ax)
    # The force is at most a hundredth of the weight.
    assert [type(one).__name__ for one in ax.collections] == ["QuadContourSet", "Quiver"]
    assert ax.figure.axes[1].lines[:] == []
    assert ax.get_title() == "arrows: net force, up to 9.9 µN"


def test_a_line_has_its_words_and_as_many_points_as_asked_for(ax):
    field_along(LINEAR, [1.0], start=[0.0, 0.01, -0.04], end=[0.0, 0.01, 0.06], ax=ax)
    assert [len(line.get_xdata()) for line in ax.lines] == [201] * 3
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["Bx", "By", "Bz"]
    assert ax.get_ylabel() == "flux density (mT)"
    np.testing.assert_allclose(ax.lines[0].get_xdata()[[0, -1]], [-40.0, 60.0])


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


def test_what_a_sensor_sees_of_a_dipole_in_a_plane(ax):
    """r = mu0 m (3 z^2 - R^2) / (4 pi R^5) with (x, y, z) from the sensor, its slopes, and 3 mu0 m x z / (4 pi R^5) per
    turn about y; the sensor is off the axis."""
    grid, place, noise = Grid([-0.01, -0.01, 0.0], [0.005, 0.005, 0.01], (5, 5, 3)), [0.006, 0.0, -0.02], 1e-5
    sensors = StoredSensors(("1",), np.array([place]), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 1)))
    nothing = np.zeros((1, *grid.shape, 3, 3))
    data = MapData(grid, ("1",), [1.0], flux_density=nothing[..., 0], gradient=nothing, sensors=sensors)
    dipole = MagneticBody(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]]))
    sensing_slice(interpolate(data), dipole, noise, shows="singular value", at=0.0, ax=ax)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (mm)", "z (mm)")
    contours, scale = ax.collections[0], 1e-7 * 0.8
    for x, z in ((-4.1, 6.3), (7.7, 12.9), (2.0, 17.7)):
        # Relative to the sensor, m.
        a, c = 1e-3 * x - place[0], 1e-3 * z - place[2]
        d = np.hypot(a, c)
        read = (3 * c**2 - d**2) / d**5
        slopes = -2 * a / d**5 - 5 * a * read / d**2, 4 * c / d**5 - 5 * c * read / d**2
        turn = 3 * a * c / d**5
        value = scale / noise * np.linalg.norm([1e-3 * slopes[0], 1e-3 * slopes[1], np.radians(1.0) * turn])
        (hit,) = [k for k, path in enumerate(contours.get_paths()) if path.contains_point([x, z])]
        step = contours.levels[1] - contours.levels[0]
        assert contours.levels[hit] - 0.05 * step <= value <= contours.levels[hit + 1] + 0.05 * step
    with pytest.raises(InputError):
        # One sensor does not determine a position.
        sensing_slice(interpolate(data), dipole, noise, ax=Figure().add_subplot())
