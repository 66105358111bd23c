"""Complete elliptic integrals by descending iterations, in the form in which loop fields lose no digits.

The number of steps is fixed, so that the compiler evaluates several points at once; it is enough for
kc >= 1e-8, that is for points no nearer to a wire than 1e-8 of its radius. All are infinite at kc = 0.
"""

import math

from fieldmap.kernels.compilation import njit

STEPS = 7


@njit(forceinline=True)
def complete_integrals(m: float, kc: float) -> tuple[float, float]:
    """K(m) and s(m) = (1 - m/2 - E(m)/K(m)) / m**2, both to rounding, also as m -> 0 where s -> 1/16.

    kc = sqrt(1 - m) is an argument of its own: near the wire it is known better than 1 - m.
    Arithmetic-geometric mean, docs/theory/coils.md (3)-(5); Abramowitz and Stegun 17.6.
    """
    a = 0.5 * (1.0 + kc)
    b = math.sqrt(kc)
    scale = 0.25 / a  # c_1 / m
    c = m * scale
    ratio, weight, total = 1.0, 1.0, 1.0
    for _ in range(STEPS):
        a_next = 0.5 * (a + b)
        b = math.sqrt(a * b)
        a = a_next
        step = 0.25 * c / a  # c_(n+1) / c_n
        c *= step
        ratio *= step
        weight *= 2.0
        total += weight * ratio * ratio
    return 0.5 * math.pi / a, scale * scale * total


@njit(forceinline=True)
def complete_integrals_three(m: float, kc: float, g: float) -> tuple[float, float, float]:
    """K(m), s(m) as above and Bulirsch's cel(kc, g^2, 1, g) for -1 < g <= 1.

    cel is the integral over 0..pi/2 of (cos^2 + g sin^2) / ((cos^2 + g^2 sin^2) sqrt(cos^2 + kc^2 sin^2)); it jumps
    at g = 0, where the mean of both sides is returned. Bulirsch, Numer. Math. 13 (1969) 305, on the same
    arithmetic-geometric mean as K; docs/theory/coils.md (13).
    """
    root = max(abs(g), 1e-140)
    ss = g / root
    cc = 1.0 + ss / root
    f = kc / root
    ss = 2.0 * (ss + f)
    p = root + f
    em, k, kk = 1.0 + kc, 2.0 * math.sqrt(kc), 0.0
    scale = 0.5 / em
    c = m * scale
    ratio, weight, total = 1.0, 1.0, 1.0
    for _ in range(STEPS):
        kk = k * em
        inverse = 1.0 / p
        f = cc
        cc += ss * inverse
        shift = kk * inverse
        ss = 2.0 * (ss + f * shift)
        p += shift
        em += k
        k = 2.0 * math.sqrt(kk)
        weight *= 2.0
        step = 0.5 * weight * c / em
        c *= step
        ratio *= step
        total += weight * ratio * ratio
    half_pi = 0.5 * math.pi
    return half_pi * 2.0 * weight / em, scale * scale * total, half_pi * (ss + cc * em) / (em * (em + p))
