"""Regular solid harmonics: every polynomial that solves Laplace's equation, and its derivatives.

    R_l^m = r^l P_l^m(cos theta) e^(i m phi) / (l + m)!                     docs/theory/lookup.md (3)

with the sign of P_l^m that makes R_m^m = (x + i y)^m / (2^m m!). In this normalisation (Epton and Dembart, SIAM J.
Sci. Comput. 16, 1995) a derivative is a step on a ladder, with no factors to carry:

    d/dz R_l^m = R_(l-1)^m     (d/dx - i d/dy) R_l^m = R_(l-1)^(m-1)     (d/dx + i d/dy) R_l^m = -R_(l-1)^(m+1)

A real harmonic polynomial of degree L is sum_l [a_l0 R_l^0 + sum_(m > 0) (a_lm Re R_l^m + b_lm Im R_l^m)], its
(L + 1)^2 coefficients in the order a_00; a_10, a_11, b_11; a_20, a_21, b_21, a_22, b_22; ...: a_lm at l^2 + 2 m - 1
(l^2 for m = 0), b_lm one further.
"""

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.map_block import (
    INLINED,
    OUTER,
)


@inlined(**INLINED)
def _cosine(c, l, m):
    return c[l * l + 2 * m - 1] if m > 0 else c[l * l]


@inlined(**INLINED)
def _sine(c, l, m):
    return c[l * l + 2 * m] if m > 0 else 0.0


# Not inlined: its callers take it up to six times, at a compiler's cost of seconds.
@njit(**OUTER)
def differentiate(c, degree, axis, out):
    """out (degree^2,): coefficients of the derivative along axis 0, 1, 2 of a polynomial c of this degree."""
    for l in range(degree):
        n = l + 1
        for m in range(l + 1):
            at = l * l + 2 * m - 1 if m > 0 else l * l
            # m = 1 receives from m = 0 twice: R^(-1) is minus the conjugate of R^1.
            fold = 2.0 if m == 1 else 1.0
            if axis == 2:
                first, second = _cosine(c, n, m), _sine(c, n, m)
            elif axis == 0:
                first = 0.5 * _cosine(c, n, m + 1)
                second = 0.5 * _sine(c, n, m + 1)
                if m > 0:
                    first -= 0.5 * fold * _cosine(c, n, m - 1)
                    second -= 0.5 * fold * _sine(c, n, m - 1)
            else:
                first = 0.5 * _sine(c, n, m + 1)
                second = -0.5 * _cosine(c, n, m + 1)
                if m > 0:
                    first += 0.5 * fold * _sine(c, n, m - 1)
                    second -= 0.5 * fold * _cosine(c, n, m - 1)
            out[at] = first
            if m > 0:
                out[at + 1] = second


def coefficient_count(degree: int) -> int:
    """Number of coefficients of a harmonic polynomial."""
    return (degree + 1) ** 2
