"""One harmonic polynomial for the whole box: infinitely smooth, a few kilobytes a coil.

docs/theory/lookup.md (8), (9). It converges inside the largest sphere about the box's middle that is free of
currents and iron; how well it does in the box is measured at every node of the map.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from fieldmap.errors import InputError, Problem
from fieldmap.interpolants.form import Form, Interpolant, contract, header, set_size
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.kernels.map import lookup as kernels
from fieldmap.kernels.map.global_harmonics import KERNELS
from fieldmap.store import FieldError, Grid, MapData
from fieldmap.typing import Array

NAME = "global"
DEGREE = 16
NODES_PER_AXIS = 13  # of the fit; the misfit is taken at all nodes, so most of a fine map is left to judge it
GRADIENT_WEIGHT = 0.1  # against length times gradient
LARGEST_MISFIT = 1e-3  # of the largest field


def global_form(data: MapData, outside: str) -> Form:
    """Coefficients (n_coils, (degree + 1)^2) behind a header, and the misfit at the nodes of the map.

    Raises InputError if the polynomial misses the map by more than LARGEST_MISFIT of the largest field.
    """
    grid, n_coils = data.grid, len(data.field_names)
    box = Grid(grid.lower, grid.upper - grid.lower, (2, 2, 2))
    length = float(np.linalg.norm(grid.upper - grid.lower)) / 2
    chosen = np.ix_(*[_spread(n) for n in grid.shape])
    degree = _degree(int(np.prod([len(axis.ravel()) for axis in chosen])))
    points = (grid.points() - (grid.lower + grid.upper) / 2) / length
    coefficients = _fit(data, points.reshape(*grid.shape, 3)[chosen].reshape(-1, 3), chosen, degree, length)
    start = header(KERNELS, box, n_coils, outside, degree, length)
    unit = np.concatenate([start, coefficients.ravel()])
    return Form(NAME, unit, unit, _checked_misfit(data, unit))


def _spread(n: int) -> NDArray[np.intp]:
    """Up to NODES_PER_AXIS of n nodes, evenly spread, both ends among them."""
    return np.unique(np.linspace(0, n - 1, min(n, NODES_PER_AXIS)).round().astype(np.intp))


def _degree(n_nodes: int) -> int:
    """DEGREE, or less where the nodes give fewer than twice as many independent numbers (8 each) as unknowns."""
    degree = DEGREE
    while degree > 3 and (degree + 1) ** 2 - 1 > 4 * n_nodes:
        degree -= 1
    return degree


def _fit(
    data: MapData, local: Array, chosen: tuple[NDArray[np.intp], ...], degree: int, length: float
) -> Array:
    """Least squares over fields and gradients at the chosen nodes, every column scaled to length 1.

    Of gradients what is symmetric and without trace, as those of the polynomials are: the rest moves no coefficient.
    """
    n = len(local)
    of_field = field_matrix(degree, local).reshape(3 * n, -1)[:, 1:]
    of_gradient = _five_entries(gradient_matrix(degree, local)).reshape(5 * n, -1)[:, 1:]
    design = np.concatenate([of_field, GRADIENT_WEIGHT * of_gradient])
    scale = np.linalg.norm(design, axis=0)
    flux = np.stack([unit[chosen].ravel() for unit in data.flux_density], axis=1)
    slope = np.stack([_five_entries(unit[chosen].reshape(n, 3, 3)).ravel() for unit in data.gradient], axis=1)
    values = np.concatenate([flux, GRADIENT_WEIGHT * length * slope])
    # The triangle alone, of matrix and values together: a third of the work of an orthogonal matrix of all rows.
    triangle = np.asarray(np.linalg.qr(np.concatenate([design / scale, values], axis=1), mode="r"))
    unknowns = len(scale)
    found = solve_triangular(triangle[:unknowns, :unknowns], triangle[:unknowns, unknowns:]) / scale[:, None]
    return np.concatenate([np.zeros((len(data.field_names), 1)), found.T], axis=1)


def _five_entries(gradient: Array) -> Array:
    """Gradients (n, 3, 3, ...) as (n, 5, ...) of the same length: their symmetric parts without trace."""
    xx, yy, zz = gradient[:, 0, 0], gradient[:, 1, 1], gradient[:, 2, 2]
    entries = [(xx - yy) / np.sqrt(2.0), (2.0 * zz - xx - yy) / np.sqrt(6.0)]
    entries += [(gradient[:, i, j] + gradient[:, j, i]) / np.sqrt(2.0) for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.stack(entries, axis=1)


def _checked_misfit(data: MapData, unit: Array) -> FieldError:
    points = data.grid.points()
    n, n_coils = len(points), len(data.field_names)
    flux, slope = np.empty((n, 3)), np.empty((n, 3, 3))
    of_flux, of_slope, size = np.zeros(n), np.zeros(n), np.zeros(n)
    for c, scale in enumerate(data.field_scale):
        kernels.evaluate(contract(unit, np.eye(n_coils)[c], set_size(unit)), points, flux, slope)
        exact = data.flux_density[c].reshape(n, 3)
        of_flux += scale * np.linalg.norm(flux - exact, axis=1)
        of_slope += scale * np.linalg.norm(slope - data.gradient[c].reshape(n, 3, 3), axis=(1, 2))
        size += scale * np.linalg.norm(exact, axis=1)
    largest = float(size.max())
    if not of_flux.max() <= LARGEST_MISFIT * largest:
        problem = Problem(
            "open_map, kind",
            f'"{NAME}" only for a field that one harmonic polynomial holds to {LARGEST_MISFIT:g}',
            f"a misfit of {of_flux.max() / max(largest, 1e-300):.1e} of the largest field at the nodes",
            "take another kind: sources are too near to this box for one expansion",
        )
        raise InputError(problem)
    return FieldError(float(of_flux.max()), float(of_slope.max()))


INTERPOLANT = Interpolant(NAME, "one polynomial for the whole box", global_form, KERNELS, in_c=True)
