"""B(H) laws as the solvers evaluate them: piecewise cubics through the points of each material's law."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PPoly

from fieldmap.device.materials import LawPoints, Material, SaturatingMaterial
from fieldmap.kernels.iron.magnetisation_law import flux_densities, magnetise, susceptibility
from fieldmap.records import Record
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class LawTables(Record):
    """Piecewise cubics of several laws, see `fieldmap.kernels.iron.magnetisation_law`; h and b in tesla.

    offset (l + 1,), knots (k,), coefficients (k, 4); range_h (2, l): mu0 H of the first and last point of the table.
    For a formula the first is infinite, and the last is where it ends; infinite where it holds everywhere.
    """

    offset: Index
    knots: Array
    coefficients: Array
    range_h: Array

    @property
    def arrays(self) -> tuple[Index, Array, Array]:
        """The tables in the order in which the kernels take them."""
        return self.offset, self.knots, self.coefficients

    def flux_density(self, h: Array, law: Index) -> tuple[Array, Array]:
        """b and db/dh at h >= 0; h, the numbers of the laws and both results have one shape."""
        b, slope = flux_densities(h.ravel(), law.ravel(), self.arrays)
        return b.reshape(h.shape), slope.reshape(h.shape)

    def integral(self, h: Array, law: Index) -> Array:
        """int_0^h b dh, T^2, for h and laws of one shape."""
        out = np.empty_like(h)
        for number in np.unique(law):
            mine, piece = law == number, slice(self.offset[number], self.offset[number + 1])
            cubics = PPoly(self.coefficients[piece].T, np.append(self.knots[piece], np.inf))
            out[mine] = cubics.antiderivative()(h[mine])
        return out


PACKED = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Position of each entry (i, j) of a symmetric matrix in its packed form xx, xy, xz, yy, yz, zz."""


@dataclass(frozen=True, eq=False, repr=False)
class Magnetisation(Record):
    """Index of the law of every element (e,), tables of the laws, remanence (c, e, 3) per source, T."""

    law: Index
    tables: LawTables
    remanence: Array

    def polarisation(self, h: Array, source: int) -> Array:
        """mu0 M (e, k, 3) at mu0 H = h (e, k, 3) at k points of every element, with the remanence of a source, T."""
        out, law = h.copy(), np.repeat(self.law, h.shape[1])
        given = (out.reshape(-1, 1), np.ones(len(law)), law, self.tables.arrays)
        over_rows(magnetise, len(law), *given, work=10.0)
        return out + self.remanence[source][:, None]

    def flux_density(self, h: Array) -> Array:
        """B (c, e, k, 3) of all sources at their h (c, e, k, 3), T."""
        return np.stack([one + self.polarisation(one, source) for source, one in enumerate(h)])

    def susceptibility(self, h: Array) -> Array:
        """db/dh - 1 (e, k, 6) at h (e, k, 3): xx, xy, xz, yy, yz, zz."""
        out, law = np.empty((h.size // 3, 6)), np.repeat(self.law, h.shape[1])
        over_rows(susceptibility, len(law), h.reshape(-1, 3), law, self.tables.arrays, out, work=10.0)
        return out.reshape(*h.shape[:2], 6)

    def susceptible(self, h: Array, vectors: Array) -> Array:
        """(db/dh - 1) v for vectors (..., e, k, 3) at h (e, k, 3)."""
        matrices = self.susceptibility(h)[..., PACKED]
        return np.einsum("ekij,...ekj->...eki", matrices, vectors)


def law_tables(materials: Sequence[Material], mu_r: float | None = None) -> LawTables:
    """Tables of the laws of materials, in their order. `mu_r` replaces the law of soft iron by a constant.

    Raises InputError for a law that is not physical.
    """
    # Many bodies may share one material object: its law is computed once.
    laws = {id(material): _law(material, mu_r) for material in {id(one): one for one in materials}.values()}
    pieces = [laws[id(material)] for material in materials]
    offset = np.concatenate([[0], np.cumsum([len(knots) for knots, _, _ in pieces])]).astype(np.int64)
    return LawTables(
        offset,
        np.concatenate([knots for knots, _, _ in pieces]),
        np.ascontiguousarray(np.concatenate([c for _, c, _ in pieces])),
        np.array([limits for _, _, limits in pieces]).T,
    )


def straight_laws(mu_r: Array) -> LawTables:
    """One straight law b = mu_r h for each body (b,)."""
    count = len(mu_r)
    coefficients = np.zeros((count, 4))
    coefficients[:, 2] = mu_r
    return LawTables(np.arange(count + 1), np.zeros(count), coefficients, np.full((2, count), np.inf))


def _law(material: Material, mu_r: float | None) -> tuple[Array, Array, tuple[float, float]]:
    if material.role == "flux barrier":
        raise TypeError("a flux barrier has no B(H) law")
    if isinstance(material, SaturatingMaterial) and mu_r is None:
        material.require_physical()
        return *_cubics(material.points()), material.field_range
    slope = material.initial_mu_r if mu_r is None else mu_r
    return np.zeros(1), np.array([[0.0, 0.0, slope, 0.0]]), (np.inf, np.inf)


def _cubics(points: LawPoints) -> tuple[Array, Array]:
    """Knots (k,) and coefficients (k, 4) of b(h), in T. J goes through points with given slopes, which are limited so
    that J never falls; beyond the last point J is constant."""
    field, polarisation = points.field, points.polarisation
    secant = np.diff(polarisation) / np.diff(field)
    slope = np.maximum(points.slope, 0.0)
    # Fritsch and Carlson: monotone if no end slope of a piece exceeds three times its secant.
    slope[:-1] = np.minimum(slope[:-1], 3 * np.maximum(secant, 0.0))
    slope[1:] = np.minimum(slope[1:], 3 * np.maximum(secant, 0.0))
    coefficients = np.zeros((len(field), 4))
    coefficients[:-1] = CubicHermiteSpline(field, polarisation, slope).c.T
    coefficients[-1, 3] = polarisation[-1]
    coefficients[:, 2] += 1.0
    coefficients[:, 3] += field
    return field, coefficients
