"""Equilibria over both signals, where the magnet comes to rest at the centroid of the currents."""

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NoEquilibrium
from fieldmap.levitation import equilibrium_surface

PLACES = 0.02 * np.array([[-1, -2, -1, 1, 2, 1], [-1, 0, 1, -1, 0, 1]]).T
PAYLOAD = Payload(mass=0.011, moment=0.8)
SIGNALS = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])


class SixWells:
    """Coil k: Bz = 0.1 z + 2 (z^2 - (r - r_k)^2 / 2) per ampere: it draws a moment m to r_k with 2 m per A."""

    coil_names = ("1", "2", "3", "4", "5", "6")
    lower, upper = np.array([-0.03, -0.03, -0.04]), np.array([0.03, 0.03, 0.04])

    def field(self, points, currents):
        x, y, z = (points[:, k, None] for k in range(3))
        dx, dy = x - PLACES[:, 0], y - PLACES[:, 1]
        b = [-0.05 * dx - 2 * z * dx, -0.05 * dy - 2 * z * dy, 0.1 * z + 2 * z**2 - dx**2 - dy**2]
        return np.stack(b, axis=1) @ currents

    def gradient(self, points, currents):
        x, y, z = (points[:, k, None] for k in range(3))
        dx, dy, zero = x - PLACES[:, 0], y - PLACES[:, 1], 0 * x * PLACES[:, 0]
        along = -0.05 - 2 * z + zero
        rows = [[along, zero, -2 * dx], [zero, along, -2 * dy], [-2 * dx, -2 * dy, 0.1 + 4 * z + zero]]
        return np.moveaxis(np.array(rows), 2, 0) @ currents

    def second_gradient(self, points, currents):
        d = np.zeros((3, 3, 3))
        for i in (0, 1):
            d[i, i, 2] = d[i, 2, i] = d[2, i, i] = -2.0
        d[2, 2, 2] = 4.0
        return np.broadcast_to(d * np.sum(currents), (len(points), 3, 3, 3))


def centroid(x, y, n):
    """Of the currents that (6-2), (6-3) divide."""
    corner = {1: (1 - x) * (1 - y), 3: (1 - x) * (1 + y), 4: (1 + x) * (1 - y), 6: (1 + x) * (1 + y)}
    rest = 6.0 - sum(corner.values())
    shares = corner | {2: rest * (1 - n * x) / 2, 5: rest * (1 + n * x) / 2}
    return sum(shares[k] * PLACES[k - 1] for k in shares) / 6.0


@pytest.mark.parametrize("held", [True, False])
def test_the_magnet_rests_at_the_centroid_of_the_currents(held):
    found = equilibrium_surface(SixWells(), PAYLOAD, SIGNALS, SIGNALS[1:], 1.5, -0.01, 1.25, held)
    assert found.positions.shape == (5, 4, 3)
    for i, x in enumerate(SIGNALS):
        for j, y in enumerate(SIGNALS[1:]):
            np.testing.assert_allclose(found.positions[i, j, :2], centroid(x, y, 1.25), atol=1e-8)
    # The lift is the same for every division of one sum, so the held level does not move.
    np.testing.assert_allclose(found.levels, 1.5, rtol=1e-6)
    np.testing.assert_allclose(found.positions[..., 2], -0.01)
    assert found.stable.all()
    lift = 0.8 * 6 * 1.5 * (0.1 - 0.04)
    assert found.field_scale == pytest.approx(0.011 * 9.80665 / lift if held else 1.0)


def test_beyond_the_map_there_is_no_place():
    found = equilibrium_surface(SixWells(), PAYLOAD, [0.0, 0.9, 1.5], [0.0], 1.5, -0.01, hold_height=False)
    assert np.isfinite(found.levels).ravel().tolist() == [True, True, False]
    assert centroid(1.5, 0.0, 1.25)[0] > 0.03 > centroid(0.9, 0.0, 1.25)[0]


def test_what_does_not_fit():
    wells = SixWells()
    wells.coil_names = ("a", "b", "c", "d", "e", "f")
    with pytest.raises(InputError, match="1 to 6"):
        equilibrium_surface(wells, PAYLOAD, SIGNALS, SIGNALS, 1.5, -0.01)
    with pytest.raises(NoEquilibrium):
        equilibrium_surface(SixWells(), PAYLOAD, [5.0], [0.0], 1.5, -0.01)
