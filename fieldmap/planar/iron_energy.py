"""Energy of saturating iron as a function of the vector potential at the corners of its triangles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array

from fieldmap.iron.elements.bh_law import LawTables, law_slopes, law_values
from fieldmap.planar.outline import Outline
from fieldmap.planar.triangulation import triangulate
from fieldmap.typing import Array

Indices = NDArray[np.int64]
Complex = NDArray[np.complex128]
_BISECTIONS = 20
_NEWTON_STEPS = 6


@dataclass(frozen=True, eq=False)
class IronTriangles:
    """points (n,), the outline's nodes first; triangles (t, 3) counter-clockwise, body (t,) of each; area (t,) in m2;
    slopes (t, 3): gradients of the hat functions as complex numbers, 1/m; tables: the laws of the bodies."""

    points: Complex
    triangles: Indices
    body: Indices
    area: Array
    slopes: Complex
    tables: LawTables

    def gradient(self, potential: Array) -> Complex:
        """dA/dx + i dA/dz = B_z - i B_x in each triangle (t,), T, for potentials (n,) in T m."""
        return np.asarray((potential[self.triangles] * self.slopes).sum(axis=1))

    def energy(self, potential: Array) -> float:
        """Integral over the iron of the integral of h over b, T2 m2."""
        density = field_strength(self.tables, self.body, np.abs(self.gradient(potential)))[1]
        return float(self.area @ density)

    def derivatives(self, potential: Array) -> tuple[Array, csc_array]:
        """First (n,) and second (n, n) derivatives of the energy."""
        gradient = self.gradient(potential)
        size = np.abs(gradient)
        h, _, tangent = field_strength(self.tables, self.body, size)
        chord = np.divide(h, size, out=tangent.copy(), where=size > 1e-30)
        along = np.divide(gradient, size, out=np.zeros_like(gradient), where=size > 1e-30)
        parallel = (along.conj()[:, None] * self.slopes).real
        first = (self.area * h)[:, None] * parallel
        residual = np.zeros(len(self.points))
        np.add.at(residual, self.triangles, first)
        across = (self.slopes[:, :, None].conj() * self.slopes[:, None, :]).real
        second = chord[:, None, None] * across
        second += (tangent - chord)[:, None, None] * parallel[:, :, None] * parallel[:, None, :]
        second *= self.area[:, None, None]
        rows = np.repeat(self.triangles, 3, axis=1).ravel()
        columns = np.tile(self.triangles, (1, 3)).ravel()
        count = len(self.points)
        return residual, csc_array(coo_array((second.ravel(), (rows, columns)), shape=(count, count)))


def iron_triangles(outline: Outline, tables: LawTables, size: float) -> IronTriangles:
    """Triangles of all bodies on the outline's own nodes."""
    points, triangles, body = [outline.nodes], [], []
    count = len(outline.nodes)
    for k, panels in enumerate(outline.bodies):
        ring = panels[:, 0]
        places, corners = triangulate(outline.nodes[ring], size)
        inner = len(places) - len(ring)
        numbers = np.concatenate([ring, count + np.arange(inner)])
        points.append(places[len(ring) :])
        triangles.append(numbers[corners])
        body.append(np.full(len(corners), k))
        count += inner
    everything, indices = np.concatenate(points), np.concatenate(triangles)
    a, b, c = everything[indices].T
    area = 0.5 * ((b - a).conj() * (c - a)).imag
    slopes = 1j * np.stack([c - b, a - c, b - a], axis=1) / (2 * area[:, None])
    return IronTriangles(everything, indices, np.concatenate(body), area, slopes, tables)


def field_strength(tables: LawTables, law: Indices, b: Array) -> tuple[Array, Array, Array]:
    """h = mu0 H (n,), the integral of h over b from 0 (n,), and dh/db (n,), at b (n,) >= 0; all with h and b in T.

    Bisection on 0 <= h <= b / smallest chord, then Newton's method, kept in the bracket. b(h) rises everywhere.
    """
    low, high = np.zeros_like(b), b.copy()
    while np.any(short := law_values(tables, law, high)[0] < b):
        high[short] *= 2.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = law_values(tables, law, middle)[0] < b
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    h = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        value, slope = law_values(tables, law, h)[0], law_slopes(tables, law, h)[1]
        h = np.clip(h - (value - b) / slope, low, high)
    stored = law_values(tables, law, h)[1]
    return h, h * b - stored, 1.0 / law_slopes(tables, law, h)[1]
