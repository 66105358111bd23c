"""A second implementation of map evaluation, in plain numpy: slow, and independent of the compiled kernels.

Harmonic forms by one matrix per place and derivative, the Hermite form as a tensor product of one-dimensional bases.
Layout of a block: fieldmap.core.block.
"""

import itertools

import numpy as np

from fieldmap.core import block as at
from fieldmap.errors import InputError, Problem
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from tests.core.harmonics_in_numpy import derivative_matrix, regular_table

# Cubic Hermite basis h_00, h_10, h_01, h_11 in powers of t.
BASIS = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]], dtype=float)


class ReferenceEvaluator:
    """`fieldmap.lookup.Evaluator` of a form; weights: of its fields summed already, or None."""

    def __init__(self, form, weights=None):
        self.form, self.weights = form, weights
        self.places = 1

    def field_and_gradient(self, points, weights, flux, slope):
        fields, slopes, outside = self._all(points, 1 if slope.size else 0)
        flux[:] = np.einsum("nsi,ns->ni", fields, self._rows(weights, len(points)))
        if slope.size:
            slope[:] = np.einsum("nsij,ns->nij", slopes, self._rows(weights, len(points)))
        return outside

    def each_field(self, points, flux, slope):
        fields, slopes, outside = self._all(points, 1)
        flux[:] = fields
        if slope.size:
            slope[:] = slopes
        return outside

    def second_gradient(self, points, weights, second):
        _, bends, outside = self._all(points, 2)
        second[:] = np.einsum("nsijk,ns->nijk", bends, self._rows(weights, len(points)))
        return outside

    def potential(self, points, weights, values):
        block = self.form.potential_unit
        cells, local, bad, outside = _located(block, points)
        rows = self._rows(weights, len(points))
        if self.form.kind == "hermite":
            each = _hermite(block, cells, local, 1, (0, 0, 0))[..., 0]
        else:
            c, x = _coefficients(block, cells), _from_middle(block, local)
            each = block[at.LENGTH] * np.einsum("nsk,nk->ns", c, regular_table(_degree(block), x))
        values[:] = np.where(bad, np.nan, -np.einsum("ns,ns->n", each, rows))
        return outside

    def at(self, weights):
        return ReferenceEvaluator(self.form, weights)

    def field_at(self, point, weights):
        return None

    def dipole_wrench_at(self, point, moment, weights):
        return None

    def core(self):
        raise InputError(Problem("compiled", "an evaluator of the C core", "numpy", "take another"))

    def _rows(self, weights, count):
        chosen = weights if self.weights is None else self.weights[None]
        return np.broadcast_to(chosen, (count, chosen.shape[1]))

    def _all(self, points, order):
        """Every field by itself: B (n, s, 3), its derivative of an order 1 or 2, and how many points lie outside."""
        block = self.form.unit
        cells, local, bad, outside = _located(block, points)
        if self.form.kind == "hermite":
            axes = list(itertools.product(range(3), repeat=order))
            orders = [tuple(np.bincount(axis, minlength=3)) for axis in axes]
            fields = _hermite(block, cells, local, 3, (0, 0, 0))
            parts = np.stack([_hermite(block, cells, local, 3, each) for each in orders], axis=-1)
            slopes = parts.reshape(*fields.shape, *(3,) * order)
        else:
            c, x = _coefficients(block, cells), _from_middle(block, local)
            degree, scale = _degree(block), block[at.PER_LENGTH] ** order
            fields = np.einsum("nsk,nik->nsi", c, field_matrix(degree, x))
            matrix = gradient_matrix(degree, x) if order < 2 else _second_matrix(degree, x)
            slopes = scale * _contracted(c, matrix)
        fields[bad], slopes[bad] = np.nan, np.nan
        return fields, slopes, outside


def _contracted(c, matrix):
    """(n, s, ...) from coefficients (n, s, k) and matrix (n, ..., k)."""
    n, s, k = c.shape
    flat = np.einsum("nsk,nmk->nsm", c, matrix.reshape(n, -1, k))
    return flat.reshape(n, s, *matrix.shape[1:-1])


def _second_matrix(degree, x):
    table = regular_table(degree - 3, np.ascontiguousarray(x))
    d = derivative_matrix
    rows = [
        table @ d(degree - 2, k) @ d(degree - 1, j) @ d(degree, i)
        for i, j, k in itertools.product(range(3), repeat=3)
    ]
    return np.stack(rows, axis=1).reshape(len(x), 3, 3, 3, (degree + 1) ** 2)


def _degree(block):
    return int(block[at.DEGREE])


def _located(block, points):
    """Cell (n, 3) of each point, its coordinates 0..1 there, whether it has no value, and how many lie outside."""
    cells = block[at.CELLS : at.CELLS + 3]
    with np.errstate(invalid="ignore"):
        u = (points - block[at.LOWER : at.LOWER + 3]) * block[at.INVERSE : at.INVERSE + 3]
        finite = np.isfinite(points).all(axis=1)
        beyond = finite & ((u < -1e-9) | (u > cells + 1e-9)).any(axis=1)
    outside = 0 if block[at.RULE] == at.CLAMP else int(beyond.sum())
    bad = ~finite if block[at.RULE] == at.CLAMP else ~finite | beyond
    u = np.where(np.isfinite(u), u, 0.0)
    if block[at.RULE] == at.CLAMP:
        u = np.where(beyond[:, None], np.clip(u, 0.0, cells), u)
    index = np.clip(u.astype(int), 0, cells.astype(int) - 1)
    return index, u - index, bad, outside


def _from_middle(block, local):
    return (local - 0.5) * block[at.LOCAL : at.LOCAL + 3]


def _coefficients(block, cells):
    """(n, s, (degree + 1)^2) of the points' cells."""
    shape = *block[at.CELLS : at.CELLS + 3].astype(int), int(block[at.SETS]), (_degree(block) + 1) ** 2
    return block[at.HEADER :].reshape(shape)[tuple(cells.T)]


def _hermite(block, cells, local, channels, orders):
    """(n, s, channels): derivatives of these orders along x, y, z of all channels of all sets."""
    shape = *(block[at.CELLS : at.CELLS + 3].astype(int) + 1), int(block[at.SETS]), channels, 2, 2, 2
    nodes = block[at.HEADER :].reshape(shape)
    spacing = block[at.LOCAL : at.LOCAL + 3]
    bases = []
    for axis, order in enumerate(orders):
        powers = np.array([np.polynomial.polynomial.polyder(row, order) for row in BASIS])
        values = np.stack([np.polynomial.polynomial.polyval(local[:, axis], row) for row in powers], axis=-1)
        bases.append(values.reshape(-1, 2, 2) / spacing[axis] ** order)
    total = np.zeros((len(cells), *shape[3:5]))
    for corner in itertools.product((0, 1), repeat=3):
        here = nodes[tuple((cells + corner).T)]
        x, y, z = (basis[:, end] for basis, end in zip(bases, corner, strict=True))
        total += np.einsum("nscabd,na,nb,nd->nsc", here, x, y, z)
    return total
