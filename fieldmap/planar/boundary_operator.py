"""Harmonic functions of a domain from their boundary values: docs/theory/planar.md (13)-(15)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from fieldmap.kernels.iron.plane import mutual_segments
from fieldmap.records import Record
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class BoundaryOperator(Record):
    """What boundary values (n,) at nodes mean for the harmonic function in a domain.

    panels (m, 2): node pairs with the domain on the left; starts, ends (m,): the same as points. flux (m, n): outward
    normal derivative on each panel. energy (n, n): v.energy.v is the integral of |grad v|^2, symmetric.
    """

    panels: Indices
    starts: Complex
    ends: Complex
    flux: Array
    energy: Array

    def densities(self, values: Array) -> Complex:
        """Densities (m,) with which `segment_derivatives` gives the function's complex derivative, (9)."""
        slope = (values[self.panels[:, 1]] - values[self.panels[:, 0]]) / np.abs(self.ends - self.starts)
        return -(self.flux @ values) + 1j * slope


def boundary_operator(nodes: Complex, panels: Indices, extent: float, unbounded: bool) -> BoundaryOperator:
    """The operator of a domain whose boundary consists of closed rings of panels.

    unbounded: the domain reaches to infinity, where its functions tend to constants. extent: a length above the
    boundary's diameter, m, so that the logarithms form a positive matrix.
    """
    starts, ends = nodes[panels[:, 0]], nodes[panels[:, 1]]
    length = np.abs(ends - starts)
    single, first, last = mutual_segments(starts, ends, starts, ends)
    single = 0.5 * (single + single.T) + np.outer(length, length) * np.log(extent) / (2 * np.pi)
    count, rows = len(nodes), np.arange(len(panels))
    double = np.zeros((len(panels), count))
    derivative = np.zeros((len(panels), count))
    for column, weight, sign in ((0, first, -1.0), (1, last, 1.0)):
        np.add.at(double.T, panels[:, column], weight.T)
        double[rows, panels[:, column]] += 0.25 * length
        derivative[rows, panels[:, column]] += sign / length
    factor = cho_factor(single)
    flux = cho_solve(factor, double)
    if unbounded:
        even = cho_solve(factor, length)
        flux -= np.outer(even, length @ flux) / (length @ even)
    energy = derivative.T @ single @ derivative + double.T @ flux
    return BoundaryOperator(panels, starts, ends, flux, 0.5 * (energy + energy.T))
