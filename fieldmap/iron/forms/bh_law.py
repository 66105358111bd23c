"""Monotone B-H laws as tables for the kernels, each with its range.

The magnetic polarisation J = B - mu0 H is interpolated by the monotone cubics of Fritsch and Carlson (SIAM J. Numer.
Anal. 17 (1980) 238), so that it never overshoots and dB/dH >= mu0 everywhere: the functional that Newton minimises
is convex. Below the first point of a table and above its last the stated laws hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from fieldmap.device.model import BHTable, FluxBarrier, LinearMaterial, Material, PermanentMagnet

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LawTables:
    """Piecewise cubics of several laws, see `fieldmap.kernels.magnetisation_law`; h and b in tesla.

    offset (l + 1,), knots (k,), coefficients (k, 4); range_h (2, l): mu0 H of the first and last point of the table,
    infinite for linear laws.
    """

    offset: NDArray[np.int64]
    knots: Array
    coefficients: Array
    range_h: Array

    @property
    def arrays(self) -> tuple[NDArray[np.int64], Array, Array]:
        """The tables in the order in which the kernels take them."""
        return self.offset, self.knots, self.coefficients


def law_tables(materials: Sequence[Material], mu_r: float | None = None) -> LawTables:
    """Tables of the laws of materials, in their order. `mu_r` replaces the law of soft iron by a constant."""
    pieces = [_law(material, mu_r) for material in materials]
    offset = np.concatenate([[0], np.cumsum([len(knots) for knots, _, _ in pieces])]).astype(np.int64)
    return LawTables(
        offset,
        np.concatenate([knots for knots, _, _ in pieces]),
        np.ascontiguousarray(np.concatenate([c for _, c, _ in pieces])),
        np.array([limits for _, _, limits in pieces]).T,
    )


def _law(material: Material, mu_r: float | None) -> tuple[Array, Array, tuple[float, float]]:
    if isinstance(material, BHTable) and mu_r is None:
        return (
            *_table_law(material.h, material.b),
            (mu_0 * float(material.h[0]), mu_0 * float(material.h[-1])),
        )
    if isinstance(material, FluxBarrier):
        raise TypeError("a flux barrier has no B(H) law")
    slope = material.mu_r if isinstance(material, PermanentMagnet) or mu_r is None else mu_r  # type: ignore[union-attr]
    assert isinstance(material, BHTable | LinearMaterial | PermanentMagnet)
    return np.zeros(1), np.array([[0.0, 0.0, slope, 0.0]]), (np.inf, np.inf)


def _table_law(h: Array, b: Array) -> tuple[Array, Array]:
    """Knots and coefficients of a table that starts with a straight line from the origin and ends saturated."""
    field = mu_0 * np.concatenate([[0.0], h])
    polarisation = np.concatenate([[0.0], b]) - field
    secant = np.diff(polarisation) / np.diff(field)
    # A flat continuation makes the slope at the last point zero: dB/dH passes to mu0 without a jump.
    beyond = PchipInterpolator(np.append(field, 2 * field[-1]), np.append(polarisation, polarisation[-1]))
    slope = beyond.derivative()(field)
    # The stated straight line to the origin, as far as monotony of the next piece allows (Fritsch and Carlson).
    slope[0] = secant[0]
    slope[1] = min(secant[0], 3 * secant[1]) if len(secant) > 1 else secant[0]
    spline = CubicHermiteSpline(field, polarisation, slope)
    coefficients = np.zeros((len(field), 4))
    coefficients[:-1] = spline.c.T
    coefficients[-1, 3] = polarisation[-1]
    coefficients[:, 2] += 1.0
    coefficients[:, 3] += field
    return field, coefficients
