"""Far from a winding: its section as Gauss-Legendre filaments, summed over slices like the exact section.

The exact section integrals are differences over the four corners and lose distance^4 / (section times enclosed area)
of the sixteen digits; filaments lose nothing. Names and frames as in `slice` and `arc`: docs/theory/coils.md (27).
"""

import math

from fieldmap.kernels.coils.quadrature import Section
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, MOST_POINTS, gauss_start

_NEAREST = 2.5  # extents of the winding: nearer, filaments converge too slowly
_ROUNDING = 2.5e-15  # of the exact section's corner terms


@njit
def far_distance(size: float, volume: float, digits: float) -> float:
    """Distance from the middle of a winding beyond which filaments are used, eq. (28).

    size: largest extent of the winding from its middle; volume: section times a quarter of the enclosing rectangle,
    m^4. The exact section loses distance^4 / volume of its digits.
    """
    kept = 10.0**-digits / _ROUNDING
    return max(_NEAREST * size, (kept * volume) ** 0.25)


@inlined
def _points(half: float, gap: float, digits: float) -> int:
    """Gauss-Legendre points over an extent of +-half of a winding at least `gap` away."""
    q = 1.0 + gap / half
    return min(MOST_POINTS, int((digits + 2.0) / (2.0 * math.log10(q + math.sqrt(q * q - 1.0)))) + 2)


@njit(forceinline=True)
def filament_slice(X: float, v: float, r: float, h: float) -> tuple[float, float, float, float, float]:
    """(outward, axial), d(outward)/dX, /dv, /dz per unit area of section at (r, h)."""
    u = r - X
    inverse2 = 1.0 / (u * u + v * v + h * h)
    inverse3 = inverse2 * math.sqrt(inverse2)
    steep = 3.0 * h * inverse2 * inverse3
    return h * inverse3, u * inverse3, steep * u, -steep * v, inverse3 - steep * h


@inlined
def section_points(section: Section, gap: float, digits: float) -> tuple[int, int]:
    """How many filaments across and along a section at least `gap` away, eq. (27)."""
    r1, r2, h1, h2 = section
    return _points(0.5 * (r2 - r1), gap, digits), _points(0.5 * (h1 - h2), gap, digits)


@inlined
def filament(nr: int, i: int, nz: int, j: int, section: Section) -> tuple[float, float, float]:
    """r, h and area of filament (i, j) of nr by nz."""
    r1, r2, h1, h2 = section
    half_r, half_z = 0.5 * (r2 - r1), 0.5 * (h1 - h2)
    i += gauss_start(nr)
    j += gauss_start(nz)
    r, h = 0.5 * (r1 + r2) + half_r * GAUSS_NODES[i], 0.5 * (h1 + h2) + half_z * GAUSS_NODES[j]
    return r, h, half_r * half_z * GAUSS_WEIGHTS[i] * GAUSS_WEIGHTS[j]
