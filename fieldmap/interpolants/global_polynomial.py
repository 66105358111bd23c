"""One harmonic polynomial for the whole box: infinitely smooth, a few kilobytes a coil.

docs/theory/lookup.md (8), (9). It converges inside the largest sphere about the box's middle that is free of
currents and iron. Its error in the box is measured at every node of the map.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fieldmap.core import CoreMap
from fieldmap.core.block import GLOBAL
from fieldmap.errors import InputError, Problem
from fieldmap.interpolants.form import Form, Interpolant, header, stored_form
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.store import FieldError, Grid, LargeMap, MapData
from fieldmap.typing import Array

NAME = "global"
DEGREE = 16
NODES_PER_AXIS = 13  # of the fit; all nodes of the map give the misfit
GRADIENT_WEIGHT = 0.1  # of length times gradient, relative to the flux density
LARGEST_MISFIT = 1e-3  # of the largest field


def global_form(data: MapData | LargeMap, outside: str) -> Form:
    """One harmonic polynomial for the whole box.

    Parameters
    ----------
    data
        The map.
    outside
        Rule for points outside the box, as for `fieldmap.lookup.open_map`.

    Returns
    -------
    Form
        Coefficients (n_coils, (degree + 1)^2) behind a header, and the misfit at the nodes of the map.

    Raises
    ------
    InputError
        If the polynomial misses the map by more than LARGEST_MISFIT of the largest field.
    """
    if isinstance(data, LargeMap):
        return stored_form(data, NAME, outside)
    grid, n_coils = data.grid, len(data.field_names)
    box = Grid(grid.lower, grid.upper - grid.lower, (2, 2, 2))
    length = float(np.linalg.norm(grid.upper - grid.lower)) / 2
    chosen = [_spread(n) for n in grid.shape]
    degree = _degree(int(np.prod([len(axis) for axis in chosen])))
    coefficients = _fit(data, chosen, degree, length)
    start = header(GLOBAL, box, n_coils, outside, degree, length)
    unit = np.concatenate([start, coefficients.ravel()])
    return Form(NAME, unit, unit, _checked_misfit(data, unit))


def _spread(n: int) -> NDArray[np.intp]:
    """Up to NODES_PER_AXIS of n nodes, evenly spread and symmetric, with both ends."""
    # An even number of nodes has no middle node.
    count = min(n, NODES_PER_AXIS - (n + 1) % 2)
    front = np.linspace(0, n - 1, count).round().astype(np.intp)[: count // 2]
    middle = [(n - 1) // 2] if n % 2 else []
    return np.concatenate([front, np.array(middle, np.intp), n - 1 - front[::-1]])


def _degree(n_nodes: int) -> int:
    """DEGREE, or a lower degree of at least 3 with two independent numbers per unknown (each node gives 8)."""
    degree = DEGREE
    while degree > 3 and (degree + 1) ** 2 - 1 > 4 * n_nodes:
        degree -= 1
    return degree


def _fit(data: MapData, chosen: Sequence[NDArray[np.intp]], degree: int, length: float) -> Array:
    """Least squares over fields and gradients at the chosen nodes, every column scaled to length 1.

    Only the symmetric, traceless part of gradients enters; the polynomials have no other part.

    The nodes are symmetric about the planes x, y, z = 0 of the local coordinates, and each harmonic is even or odd in
    each coordinate. So sums and differences of values at mirror nodes (an orthogonal transform) divide the unknowns
    into eight systems, each over an eighth of the nodes.
    """
    grid, at = data.grid, np.ix_(*chosen)
    n, fields = [len(axis) for axis in chosen], len(data.field_names)
    flux = np.moveaxis(np.stack([unit[at] for unit in data.flux_density]), 0, -1)
    slope = np.stack([_five_entries(unit[at].reshape(-1, 3, 3)) for unit in data.gradient], axis=-1)
    slope = GRADIENT_WEIGHT * length * slope.reshape(*n, 5, fields)
    values = _even_and_odd(np.concatenate([flux, slope], axis=3))

    halves = [
        (axis[: (len(axis) + 1) // 2] - (size - 1) / 2) * spacing / length
        for axis, size, spacing in zip(chosen, grid.shape, grid.spacing, strict=True)
    ]
    local = np.stack(np.meshgrid(*halves, indexing="ij"), axis=-1).reshape(-1, 3)
    # The root of 2 of the transform, for nodes with an image. Odd functions are zero in the mirror plane.
    twice = np.prod(np.where(local != 0.0, np.sqrt(2.0), 1.0), axis=1)[:, None, None]
    of_gradient = GRADIENT_WEIGHT * _five_entries(gradient_matrix(degree, local))
    design = twice * np.concatenate([field_matrix(degree, local), of_gradient], axis=1)

    found, odd = np.zeros(((degree + 1) ** 2, fields)), _odd(degree)
    for kind in np.ndindex(2, 2, 2):
        columns = np.flatnonzero((odd == kind).all(axis=1))
        columns = columns[columns > 0]  # the constant has no field
        if columns.size:
            wanted = [values[tuple(kind ^ changed)][:, k] for k, changed in enumerate(_CHANGED)]
            found[columns] = _least_squares(
                design[:, :, columns].reshape(-1, columns.size), np.stack(wanted, axis=1).reshape(-1, fields)
            )
    return np.ascontiguousarray(found.T)


def _least_squares(design: Array, values: Array) -> Array:
    scale = np.linalg.norm(design, axis=0)
    # The R factor of matrix and values together takes a third of the work of a full QR factorisation.
    triangle = np.asarray(np.linalg.qr(np.concatenate([design / scale, values], axis=1), mode="r"))
    unknowns = len(scale)
    # The LU factors of an upper triangle are the identity and the triangle itself.
    return np.linalg.solve(triangle[:unknowns, :unknowns], triangle[:unknowns, unknowns:]) / scale[:, None]


# For three components of the field and five entries of the gradient: 1 where their parity in x, y, z differs from that
# of the potential.
_CHANGED = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], dtype=np.intp
)


def _odd(degree: int) -> NDArray[np.intp]:
    """((degree + 1)^2, 3): 1 where a harmonic is odd in x, y, z, else 0."""
    rows = []
    for l in range(degree + 1):
        for m in range(l + 1):
            rows += [[m % 2, 0, (l + m) % 2], [(m + 1) % 2, 1, (l + m) % 2]][: 1 if m == 0 else 2]
    return np.array(rows, dtype=np.intp)


def _even_and_odd(values: Array) -> dict[tuple[int, ...], Array]:
    """Parts of values (nx, ny, nz, ...) that are even (0) or odd (1) along each axis, at an eighth of the nodes (n)."""
    parts: dict[tuple[int, ...], Array] = {(): values}
    for axis in range(3):
        n = values.shape[axis]
        split: dict[tuple[int, ...], Array] = {}
        for key, part in parts.items():
            one = np.moveaxis(part, axis, 0)
            front, back, middle = one[: n // 2], one[::-1][: n // 2], one[n // 2 : n // 2 + n % 2]
            for odd, half in enumerate((front + back, front - back)):
                whole = np.concatenate([half / np.sqrt(2.0), (1 - odd) * middle])
                split[(*key, odd)] = np.moveaxis(whole, 0, axis)
        parts = split
    return {key: part.reshape(-1, *part.shape[3:]) for key, part in parts.items()}


def _five_entries(gradient: Array) -> Array:
    """Symmetric, traceless parts of gradients (n, 3, 3, ...) as (n, 5, ...) with the same norm."""
    xx, yy, zz = gradient[:, 0, 0], gradient[:, 1, 1], gradient[:, 2, 2]
    entries = [(xx - yy) / np.sqrt(2.0), (2.0 * zz - xx - yy) / np.sqrt(6.0)]
    entries += [(gradient[:, i, j] + gradient[:, j, i]) / np.sqrt(2.0) for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.stack(entries, axis=1)


def _checked_misfit(data: MapData, unit: Array) -> FieldError:
    points = data.grid.points()
    n, n_coils = len(points), len(data.field_names)
    flux, slope = np.empty((n, 3)), np.empty((n, 3, 3))
    of_flux, of_slope, size = np.zeros(n), np.zeros(n), np.zeros(n)
    core = CoreMap(unit)
    for c, scale in enumerate(data.field_scale):
        core.fields(points, np.eye(n_coils)[c : c + 1], flux, slope)
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


INTERPOLANT = Interpolant(NAME, "one polynomial for the whole box", global_form, GLOBAL, in_c=True)
