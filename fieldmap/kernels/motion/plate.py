"""Eddy-current damping by a conducting plate of any thickness, slow motion: docs/theory/dynamics.md (11)..(18).

The plate's numbers (layout) lie at PLATE of a body's array. It reaches without end to all sides.
"""

import math

from numba import njit

from fieldmap.kernels.constants import MU0
from fieldmap.kernels.map.map_block import PLAIN_INLINED
from fieldmap.kernels.motion.layout import CONDUCTIVITY, FACE, NORMAL, THICKNESS


@njit(**PLAIN_INLINED)
def layer_integrals(height, thickness):
    """Integrals over the depth of the plate of 3 / (8 s^4), 1 / (4 s^3), 1 / (4 s^2): (14), (15)."""
    near, far = 1.0 / height, 1.0 / (height + thickness)
    return (
        0.125 * (near * near * near - far * far * far),
        0.125 * (near * near - far * far),
        0.25 * (near - far),
    )


@njit(**PLAIN_INLINED)
def plate_force(numbers, at, x, y, z, m, v, rate):
    """Force (3) on a dipole m (3) at a place, moving at v (3), and g (3), so that the torque is m x g: (16), (17).

    numbers, at: the plate's begin at numbers[at]. rate (3): dm/dt. All in the frame of the map. On or behind the face
    the formula has no meaning and gives NaN.
    """
    nx, ny, nz = numbers[at + NORMAL], numbers[at + NORMAL + 1], numbers[at + NORMAL + 2]
    face = at + FACE
    height = nx * (x - numbers[face]) + ny * (y - numbers[face + 1]) + nz * (z - numbers[face + 2])
    if not height > 0.0:
        return (math.nan, math.nan, math.nan), (math.nan, math.nan, math.nan)
    a4, a3, a2 = layer_integrals(height, numbers[at + THICKNESS])
    k = MU0 * MU0 * numbers[at + CONDUCTIVITY] / (8.0 * math.pi)
    a4, a3, a2 = k * a4, k * a3, k * a2
    # Parts along the normal, then parts in the plane.
    mn = m[0] * nx + m[1] * ny + m[2] * nz
    vn = v[0] * nx + v[1] * ny + v[2] * nz
    rn = rate[0] * nx + rate[1] * ny + rate[2] * nz
    mx, my, mz = m[0] - mn * nx, m[1] - mn * ny, m[2] - mn * nz
    vx, vy, vz = v[0] - vn * nx, v[1] - vn * ny, v[2] - vn * nz
    rx, ry, rz = rate[0] - rn * nx, rate[1] - rn * ny, rate[2] - rn * nz
    m2 = mx * mx + my * my + mz * mz
    mv = mx * vx + my * vy + mz * vz
    mr = mx * rx + my * ry + mz * rz
    # (16): force.
    plane = -a4 * (0.5 * mn * mn + 0.125 * m2)
    along = -0.25 * a4 * mv - 0.5 * a3 * rn
    turned = 0.5 * a3 * mn
    normal = -a4 * (mn * mn + 0.5 * m2) * vn + a3 * (0.5 * mr + mn * rn)
    force = (
        plane * vx + along * mx + turned * rx + normal * nx,
        plane * vy + along * my + turned * ry + normal * ny,
        plane * vz + along * mz + turned * rz + normal * nz,
    )
    # (17): what turns.
    swing, lean, drift = -0.5 * a2, 0.5 * a3 * vn, 0.5 * a3 * mn
    upright = a3 * (mn * vn - 0.5 * mv) - a2 * rn
    turning = (
        swing * rx + lean * mx + drift * vx + upright * nx,
        swing * ry + lean * my + drift * vy + upright * ny,
        swing * rz + lean * mz + drift * vz + upright * nz,
    )
    return force, turning
