"""Maps of point dipoles: fields with closed forms for B, its gradient, and the force on another dipole."""

import numpy as np
import pytest

from fieldmap.field import Field
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData

MU0_4PI = 1e-7
SOURCES = np.array([[0.0, 0.0, 0.075], [0.03, -0.01, 0.085], [-0.02, 0.03, 0.07]])
MOMENTS = np.array([[0.0, 0.0, 2.0], [1.0, 0.5, -1.0], [0.3, -2.0, 0.4]])
LOWER, UPPER = np.array([-0.02, -0.015, -0.03]), np.array([0.02, 0.02, 0.01])


def dipole_field(moment, source, points):
    """B (n, 3) of a point dipole, Jackson eq. (5.56)."""
    r = points - source
    d = np.linalg.norm(r, axis=1)[:, None]
    return MU0_4PI * (3 * (r @ moment)[:, None] * r / d**5 - moment / d**3)


def dipole_gradient(moment, source, points):
    """dB_i/dx_j (n, 3, 3) of a point dipole."""
    r = points - source
    d2 = np.sum(r**2, axis=1)[:, None, None]
    along = (r @ moment)[:, None, None]
    outer = moment[:, None] * r[:, None, :] + moment * r[:, :, None]
    bracket = outer + along * np.eye(3) - 5 * along * r[:, :, None] * r[:, None, :] / d2
    return 3 * MU0_4PI * bracket / d2**2.5


def dipole_map(cells, n_coils=3):
    """Unit fields of `n_coils` dipoles on a grid of cells (3,)."""
    cells = np.broadcast_to(cells, 3)
    grid = Grid(LOWER, (UPPER - LOWER) / cells, tuple(cells + 1))
    points = grid.points()
    flux = [dipole_field(m, s, points) for m, s in zip(MOMENTS, SOURCES, strict=True)][:n_coils]
    slope = [dipole_gradient(m, s, points) for m, s in zip(MOMENTS, SOURCES, strict=True)][:n_coils]
    return MapData(
        grid,
        tuple("abc"[:n_coils]),
        np.ones(n_coils),
        flux_density=np.array(flux).reshape(n_coils, *grid.shape, 3),
        gradient=np.array(slope).reshape(n_coils, *grid.shape, 3, 3),
    )


class Loops(Field):
    """Loops with the same ampere turns at 1 A; loops: radius and centre of each, m."""

    proportional = affine = True
    coil_names = ()

    def __init__(self, loops, turns):
        self.loops, self.turns = loops, turns
        self.coil_names = tuple("abc"[: len(loops)])

    def _of(self, points, currents, which):
        each = [
            loop_flux_density_and_gradient(np.atleast_2d(points) - np.array(c), r)[which]
            for r, c in self.loops
        ]
        return self.turns * np.tensordot(np.asarray(currents, float), np.array(each), axes=(-1, 0))

    def field(self, points, currents):
        return self._of(points, currents, 0)

    def gradient(self, points, currents):
        return self._of(points, currents, 1)


def random_points(n, seed=0):
    return LOWER + np.random.default_rng(seed).random((n, 3)) * (UPPER - LOWER)


@pytest.fixture(scope="session")
def fine():
    """An opened map, spacing about 1.7 mm: interpolation error 1e-6."""
    return interpolate(dipole_map((24, 21, 24)))


@pytest.fixture(scope="session")
def coarse():
    """An opened map of 6 x 5 x 6 cells."""
    return interpolate(dipole_map((6, 5, 6)))


@pytest.fixture(scope="session")
def dipoles():
    """The closed forms and the data that the maps are made of."""
    from types import SimpleNamespace

    return SimpleNamespace(
        field=dipole_field,
        gradient=dipole_gradient,
        map=dipole_map,
        points=random_points,
        sources=SOURCES,
        moments=MOMENTS,
        lower=LOWER,
        upper=UPPER,
    )
