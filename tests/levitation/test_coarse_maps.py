"""Equilibrium in a coarse map with a force that steps between cells: six dipoles on a circle, in closed form."""

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.errors import NoEquilibrium
from fieldmap.levitation import find_equilibrium
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData
from tests.levitation.conftest import dipole_field

PER_AMPERE, RADIUS, COUNT = 8.0, 0.044, 6
BEAD = Payload(mass=0.006, moment=0.8)
WEIGHT = BEAD.mass * 9.80665


def pull(z):
    """Magnetic force per ampere on the bead on the axis, from Jackson eq. (5.56): the circle lies at z = 0."""
    return BEAD.moment * COUNT * 1e-7 * PER_AMPERE * z * (9 * RADIUS**2 - 6 * z**2) / np.hypot(RADIUS, z) ** 7


@pytest.fixture(scope="module")
def coarse():
    """Cells of 5 mm; the axis is an edge of four of them."""
    grid = Grid([-0.01, -0.01, -0.11], [0.005] * 3, (5, 5, 9))
    angles = np.arange(COUNT) * 2 * np.pi / COUNT
    circle = RADIUS * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(COUNT)])
    flux, slope = (sum(part) for part in zip(*(dipole_field(grid.points() - s) for s in circle), strict=True))
    shape = (1, *grid.shape, 3)
    fields = {
        "flux_density": PER_AMPERE * flux.reshape(shape),
        "gradient": PER_AMPERE * slope.reshape(*shape, 3),
    }
    return interpolate(MapData(grid, ("circle",), np.ones(1), **fields))


@pytest.mark.parametrize("depth", [0.0815, 0.0905, 0.097])
def test_balance_may_lie_in_the_step_between_two_cells(coarse, depth):
    current = WEIGHT / pull(-depth)
    found = find_equilibrium(coarse, [current], BEAD)
    step = BEAD.moment * coarse.jump().gradient_bound * current
    stiffness = current * (pull(-depth + 1e-6) - pull(-depth - 1e-6)) / 2e-6 / 2
    assert np.linalg.norm(found.force_residual) <= step
    np.testing.assert_allclose(found.position, [0, 0, -depth], atol=step / stiffness)
    assert found.stable_axes == {"x": True, "y": True, "z": False}


def test_a_coarse_map_does_not_balance_what_is_too_heavy(coarse):
    with pytest.raises(NoEquilibrium, match="raise"):
        find_equilibrium(coarse, [0.8 * WEIGHT / pull(-np.linspace(0.07, 0.11, 101)).max()], BEAD)
