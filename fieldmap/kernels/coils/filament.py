"""Far from a winding: its section as Gauss-Legendre filaments, summed over slices like the exact section.

The exact section integrals are differences over the four corners and lose distance^4 / (section times enclosed area)
of the sixteen digits; filaments lose nothing. Names and frames as in `slice` and `arc`: docs/theory/coils.md (27).
"""

import math

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, MOST_POINTS, gauss_start
from fieldmap.typing import Array

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
def section_points(half: float, gap: float, digits: float) -> int:
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


@inlined(fastmath={"reassoc"})
def far_arc(
    azimuths: Array,
    n: int,
    px: float,
    py: float,
    r1: float,
    r2: float,
    h1: float,
    h2: float,
    gap: float,
    digits: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """As `arc.arc_sum_gradient`, by filaments; the winding is at least `gap` away."""
    half_r, half_z = 0.5 * (r2 - r1), 0.5 * (h1 - h2)
    middle_r, middle_h = 0.5 * (r1 + r2), 0.5 * (h1 + h2)
    nr, nz = section_points(half_r, gap, digits), section_points(half_z, gap, digits)
    bx, by, bz = 0.0, 0.0, 0.0
    g00, g01, g02, g10, g11, g12 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(gauss_start(nr), gauss_start(nr + 1)):
        r = middle_r + half_r * GAUSS_NODES[i]
        for j in range(gauss_start(nz), gauss_start(nz + 1)):
            h = middle_h + half_z * GAUSS_NODES[j]
            area = half_r * half_z * GAUSS_WEIGHTS[i] * GAUSS_WEIGHTS[j] * r
            for k in range(n):
                c, s, weight = azimuths[0, k], azimuths[1, k], area * azimuths[2, k]
                outward, axial, dX, dv, dz = filament_slice(px * c + py * s, py * c - px * s, r, h)
                wc, ws = weight * c, weight * s
                d0, d1 = c * dX - s * dv, s * dX + c * dv
                bx += wc * outward
                by += ws * outward
                bz += weight * axial
                g00 += wc * d0
                g01 += wc * d1
                g02 += wc * dz
                g10 += ws * d0
                g11 += ws * d1
                g12 += ws * dz
    return bx, by, bz, g00, g01, g02, g10, g11, g12


@inlined(fastmath={"reassoc"})
def far_bar(
    n: int,
    v1: float,
    v2: float,
    X: float,
    r1: float,
    r2: float,
    h1: float,
    h2: float,
    gap: float,
    digits: float,
) -> tuple[float, float, float, float, float]:
    """As `bar.bar_integrals_gradient`, by filaments with n points along the bar, at least `gap` away."""
    half_r, half_z, half_v = 0.5 * (r2 - r1), 0.5 * (h1 - h2), 0.5 * (v2 - v1)
    middle_r, middle_h, middle_v = 0.5 * (r1 + r2), 0.5 * (h1 + h2), 0.5 * (v1 + v2)
    nr, nz = section_points(half_r, gap, digits), section_points(half_z, gap, digits)
    outward, axial, dX, dv, dz = 0.0, 0.0, 0.0, 0.0, 0.0
    start = gauss_start(n)
    for i in range(gauss_start(nr), gauss_start(nr + 1)):
        r = middle_r + half_r * GAUSS_NODES[i]
        for j in range(gauss_start(nz), gauss_start(nz + 1)):
            h = middle_h + half_z * GAUSS_NODES[j]
            area = half_r * half_z * half_v * GAUSS_WEIGHTS[i] * GAUSS_WEIGHTS[j]
            for k in range(n):
                weight = area * GAUSS_WEIGHTS[start + k]
                a, b, c, d, e = filament_slice(X, middle_v + half_v * GAUSS_NODES[start + k], r, h)
                outward += weight * a
                axial += weight * b
                dX += weight * c
                dv += weight * d
                dz += weight * e
    return outward, axial, dX, dv, dz
