"""How far the interpolant of a map lies from the solver between the nodes: measured where it is worst."""

import itertools
from typing import Protocol

import numpy as np

from fieldmap.iron import SolverReport
from fieldmap.kernels import hermite
from fieldmap.store import FieldError, Grid
from fieldmap.store.grid import Array

RANDOM_POINTS = 200
SEED = 20240229


class UnitFields(Protocol):
    """What a map is evaluated from."""

    @property
    def report(self) -> SolverReport:
        """Of the solver."""
        ...

    def unit_fields(self, points: Array) -> tuple[Array, Array]:
        """Flux density (n_fields, n, 3) and gradient (n_fields, n, 3, 3), per ampere or at weight 1."""
        ...


def sample_points(grid: Grid) -> Array:
    """Points (n, 3): random ones all over the box, and the centres of cells at its corners, edges and faces.

    An interpolant is worst at cell centres, and a method that treats its boundary badly is worst in the outer
    cells. The random points are the same on every run.
    """
    random = grid.lower + np.random.default_rng(SEED).random((RANDOM_POINTS, 3)) * (grid.upper - grid.lower)
    cells = [(0, (n - 1) // 2, n - 2) for n in grid.shape]
    middle = tuple(index[1] for index in cells)
    outer = [cell for cell in itertools.product(*cells) if cell != middle]
    centres = grid.lower + (np.array(outer) + 0.5) * grid.spacing
    return np.concatenate([random, centres])


def interpolation_error(
    grid: Grid, flux_density: Array, gradient: Array, solution: UnitFields, scale: Array
) -> FieldError:
    """Largest difference between interpolant and solver over the sample points.

    flux_density (n_fields, nx, ny, nz, 3) and gradient (.., 3, 3) per ampere at the nodes. The norm of each
    field's difference times its `scale` (n_fields,), a coil's reference current, is summed over the fields, so the
    figure holds at the sampled
    points for any currents up to these, whatever their signs. A sample, not a bound.
    """
    points = sample_points(grid)
    exact, exact_slope = solution.unit_fields(points)
    flux, slope = _interpolate(grid, flux_density, gradient, points)
    of_flux = np.linalg.norm(flux - exact, axis=2)
    of_slope = np.linalg.norm(slope - exact_slope, axis=(2, 3))
    return FieldError(float((scale @ of_flux).max()), float((scale @ of_slope).max()))


def _interpolate(grid: Grid, flux_density: Array, gradient: Array, points: Array) -> tuple[Array, Array]:
    """(n_coils, n, 3) and (n_coils, n, 3, 3) from the nodes, as a lookup of the finished map gives them."""
    n_coils, n = len(flux_density), len(points)
    channels = 3 * n_coils
    values = np.ascontiguousarray(np.moveaxis(flux_density, 0, 3)).reshape(*grid.shape, channels)
    slopes = np.ascontiguousarray(np.moveaxis(gradient, 0, 3)).reshape(*grid.shape, channels, 3)
    spacing, lower = np.array(grid.spacing), np.array(grid.lower)
    coefficients = hermite.nodal_coefficients(values, slopes, spacing)
    flux, slope = np.empty((n, channels)), np.empty((n, channels, 3))
    hermite.field_and_gradient(coefficients, lower, spacing, points, flux, slope)
    by_coil = np.moveaxis(flux.reshape(n, n_coils, 3), 1, 0)
    return by_coil, np.moveaxis(slope.reshape(n, n_coils, 3, 3), 1, 0)
