"""Harmonic functions of a domain from their boundary values: docs/theory/planar.md (13)-(15)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from fieldmap.kernels.iron.plane import mutual_segments
from fieldmap.records import Record
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class BoundaryOperator(Record):
    """Flux and energy of the harmonic function in a domain, from its boundary values (n,) at nodes.

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
    # Sparse, (panels, nodes): the hat functions of a panel's ends, and the derivative along it.
    at_first, at_last = (csr_array((np.ones(len(rows)), (rows, end)), (len(rows), count)) for end in panels.T)
    derivative = (at_last - at_first).multiply(1.0 / length[:, None]).tocsr()
    double = 0.25 * (at_first + at_last).multiply(length[:, None]).toarray()
    double += first @ at_first + last @ at_last
    factor = cho_factor(single)
    flux = cho_solve(factor, double)
    if unbounded:
        even = cho_solve(factor, length)
        flux -= np.outer(even, length @ flux) / (length @ even)
    energy = derivative.T @ (single @ derivative) + double.T @ flux
    return BoundaryOperator(panels, starts, ends, flux, 0.5 * (energy + energy.T))
