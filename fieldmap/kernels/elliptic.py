"""Complete elliptic integrals by descending iterations, in the form in which loop fields lose no digits."""

import math

import numba

_LAST_TERM = 3e-9  # the neglected terms are of the order of its square


@numba.njit(cache=True, error_model="numpy")
def complete_integrals(m: float, kc: float) -> tuple[float, float]:
    """K(m) and s(m) = (1 - m/2 - E(m)/K(m)) / m**2, both to rounding, also as m -> 0 where s -> 1/16.

    kc = sqrt(1 - m) is an argument of its own: near the wire it is known better than 1 - m.
    Arithmetic-geometric mean, docs/theory/coils.md (3)-(5); Abramowitz and Stegun 17.6. Singular at kc = 0.
    """
    a = 0.5 * (1.0 + kc)
    b = math.sqrt(kc)
    c = m / (4.0 * a)
    scale = 1.0 / (4.0 * a)  # c_1 / m
    ratio = 1.0
    weight = 1.0
    total = 1.0
    while c > _LAST_TERM * a:
        a_next = 0.5 * (a + b)
        b = math.sqrt(a * b)
        step = c / (4.0 * a_next)
        a = a_next
        c *= step
        ratio *= step
        weight *= 2.0
        total += weight * ratio * ratio
    return 0.5 * math.pi / a, scale * scale * total


@numba.njit(cache=True, error_model="numpy")
def bulirsch_cel(kc: float, p: float, c: float, s: float) -> float:
    """Bulirsch's general complete elliptic integral cel(kc, p, c, s), kc > 0, p >= 0, to rounding.

    Integral over 0..pi/2 of (c cos^2 + s sin^2) / ((cos^2 + p sin^2) sqrt(cos^2 + kc^2 sin^2)).
    For p = 0 the part with s, which is infinite, is left out. Bulirsch, Numer. Math. 13 (1969) 305.
    """
    if p == 0.0:
        return c * complete_integrals(1.0 - kc * kc, kc)[0]
    k = abs(kc)
    em = 1.0
    root = math.sqrt(p)
    ss = s / root
    cc = c
    f = cc
    cc += ss / root
    g = k / root
    ss = 2.0 * (ss + f * g)
    pp = root + g
    g = em
    em = k + em
    kk = k
    while abs(g - k) > _LAST_TERM * g:
        k = 2.0 * math.sqrt(kk)
        kk = k * em
        f = cc
        cc += ss / pp
        g = kk / pp
        ss = 2.0 * (ss + f * g)
        pp += g
        g = em
        em += k
    return 0.5 * math.pi * (ss + cc * em) / (em * (em + pp))
