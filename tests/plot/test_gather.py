"""What is gathered for a picture: the height of a shift, and what currents within a limit reach."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.device.payload import PayloadPiece, SoftSphere
from fieldmap.io import FieldSource, find_source
from fieldmap.levitation import reachable
from fieldmap.lookup import interpolate
from fieldmap.plot.gather import DEFAULT_LIMIT, floating_height, shown_field
from fieldmap.store import Grid, MapData
from tests.conftest import DEVICES


def test_the_shift_is_shown_where_the_magnet_floats():
    """dBz/dz = b + c z per ampere on the axis: the weight is carried at one height."""
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    x, y, z = grid.points().T
    b, c = 0.04, 1.0
    radial = -0.5 * (b + c * z)
    flux = np.column_stack([radial * x, radial * y, b * z + 0.5 * c * (z**2 - 0.5 * (x**2 + y**2))])
    slope = np.zeros((125, 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = radial
    slope[:, 2, 2] = b + c * z
    slope[:, 0, 2] = slope[:, 2, 0] = -0.5 * c * x
    slope[:, 1, 2] = slope[:, 2, 1] = -0.5 * c * y
    arrays = {"flux_density": flux.reshape(1, 5, 5, 5, 3), "gradient": slope.reshape(1, 5, 5, 5, 3, 3)}
    field = interpolate(MapData(grid, ("coil",), [1.0], **arrays), kind="global")
    bounds = (field.lower, field.upper)
    about = ("a.h5", "", "map", ("coil",), bounds, Payload(0.010, 0.8), None, None)
    source = FieldSource(*about, make=lambda: field)
    height, why = floating_height(source, np.array([3.0]))
    assert height == pytest.approx((0.010 * 9.80665 / (0.8 * 3.0) - b) / c, abs=1e-8)
    assert "nowhere" not in why
    middle = -0.02 + 0.5 * 4 * 0.01
    height, why = floating_height(source, np.array([0.1]))
    assert height == pytest.approx(middle, abs=1e-12)
    assert "nowhere" in why


def test_the_shift_of_a_map_of_four_coils():
    """Coil k: Bz = 0.1 z + 2 (z^2 - (r - r_k)^2 / 2) per ampere, r_k in the corners of a square of 40 mm.

    The magnet rests at the centroid of the currents, and a signal s along x or y moves it by s times 20 mm.
    """
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    flux, slope = np.zeros((4, 125, 3)), np.zeros((4, 125, 3, 3))
    for k, place in enumerate(0.02 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])):
        dx, dy, z = (grid.points() - [*place, 0.0]).T
        along = -0.05 - 2 * z
        flux[k] = np.column_stack([along * dx, along * dy, 0.1 * z + 2 * z**2 - dx**2 - dy**2])
        slope[k, :, 0, 0] = slope[k, :, 1, 1] = along
        slope[k, :, 2, 2] = 0.1 + 4 * z
        slope[k, :, 0, 2] = slope[k, :, 2, 0] = -2 * dx
        slope[k, :, 1, 2] = slope[k, :, 2, 1] = -2 * dy
    names = ("a", "b", "c", "d")
    arrays = {"flux_density": flux.reshape(4, 5, 5, 5, 3), "gradient": slope.reshape(4, 5, 5, 5, 3, 3)}
    field = interpolate(MapData(grid, names, np.ones(4), **arrays), kind="global")
    about = ("a.h5", "", "map", names, field.bounds, Payload(0.010, 0.8), None, None)
    shown = shown_field(FieldSource(*about, make=lambda: field), np.full(4, 2.0), "shift", height=-0.01)
    x, y = np.meshgrid(shown.surface.x_signals, shown.surface.y_signals, indexing="ij")
    np.testing.assert_allclose(shown.surface.positions[..., 0], 0.02 * x, atol=1e-8)
    np.testing.assert_allclose(shown.surface.positions[..., 1], 0.02 * y, atol=1e-8)


def test_what_a_map_reaches_is_within_the_limit_of_its_driver(dipole_map, circle_of_six, tmp_path):
    device = (DEVICES / "everything.toml").read_text(encoding="utf-8")
    source = find_source(dipole_map(circle_of_six, tmp_path / "six.h5", device))
    assert source.driver.current_limit != DEFAULT_LIMIT
    found = shown_field(source, np.zeros(6), "reachable", kind="B").reachable
    middle = 0.5 * (source.bounds[0] + source.bounds[1])
    expected = reachable(source.field, middle, source.driver.current_limit)
    assert found.largest_along([0, 0, 1]) == pytest.approx(expected.largest_along([0, 0, 1]), rel=1e-12)


def test_reachable_forces_on_soft_iron_are_searched(dipole_map, circle_of_six, tmp_path):
    """Within the limit, which some current takes, and said to be a search's."""
    device = (DEVICES / "everything.toml").read_text(encoding="utf-8")
    bead = Payload(1e-4, pieces=(PayloadPiece(SoftSphere(1e-3, mu_r=100.0)),))
    source = replace(find_source(dipole_map(circle_of_six, tmp_path / "six.h5", device)), payload=bead)
    one = shown_field(source, np.zeros(6), "reachable", kind="force", limit=0.02)
    assert not one.reachable.exact
    assert one.reachable.moment.soft
    assert any("134 directions" in text for text in one.assumptions)
    assert np.abs(one.reachable.currents).max() == pytest.approx(0.02, rel=1e-9)
    told = one.to_dict()["reachable"]
    assert np.shape(told["values"]) == (134, 3)
