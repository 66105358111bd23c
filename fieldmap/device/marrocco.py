"""Where Marrocco's reluctivity ends: the flux density at which its slope dB/dH has fallen to that of free space.

With s = B^(2 alpha) / (B^(2 alpha) + tau) the relative reluctivity is n = eps + (c - eps) s and

    mu0 dH/dB = d(n B)/dB = eps + (c - eps) (s + 2 alpha s (1 - s)),

which reaches 1 at the smaller root s of a quadratic. Beyond it the formula would lose polarisation with rising field.
"""

from math import inf, sqrt


def marrocco_end(eps: float, c: float, alpha: float, tau: float) -> float:
    """Flux density in T where mu0 dH/dB = 1; infinite where the formula never gets there, so never saturates.

    >>> round(marrocco_end(2e-4, 1.0, 5.5, 5e4), 3)
    2.169
    """
    if c <= eps:
        return inf
    linear, wanted = 1 + 2 * alpha, (1 - eps) / (c - eps)
    discriminant = linear**2 - 8 * alpha * wanted
    if discriminant < 0:
        return inf
    s = (linear - sqrt(discriminant)) / (4 * alpha)
    return (tau * s / (1 - s)) ** (0.5 / alpha) if s < 1 else inf


def marrocco_field(b: float, eps: float, c: float, alpha: float, tau: float) -> float:
    """mu0 H in T at flux density b in T."""
    power = b ** (2 * alpha)
    return (eps + (c - eps) * power / (power + tau)) * b
