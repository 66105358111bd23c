"""Logarithm, exponential and arctangent without branches or library calls.

A loop that calls the library's functions runs one value at a time; with these the compiler evaluates four or
eight at once, five to ten times faster. Errors are below 4e-16, relative where the result exceeds 1. A
logarithm of 0 or of infinity is finite (about -+710): in the sums of the slices it is multiplied by zero.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import njit

_LN2 = 0.6931471805599453
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
_LOG2_E = 1.4426950408889634
_SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
_TAN_PI_8 = 0.41421356237309503


@njit(forceinline=True)
def log(x: float) -> float:
    """Natural logarithm of x >= 0: mantissa to [sqrt(1/2), sqrt(2)), then the series of 2 atanh."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits - np.int64(_SQRT_HALF_BITS)) >> np.int64(52)
    mantissa = np.int64(bits - (exponent << np.int64(52))).view(np.float64)
    s = (mantissa - 1.0) / (mantissa + 1.0)
    q = s * s
    p = 0.14809710360655276698
    p = p * q + 0.15312528148364190966
    p = p * q + 0.18183631680229328804
    p = p * q + 0.22222197056726046608
    p = p * q + 0.28571428760641679883
    p = p * q + 0.39999999999302338113
    p = p * q + 0.66666666666667645658
    return np.float64(exponent) * _LN2 + (s * q * p + 2.0 * s)


@njit(forceinline=True)
def exp(x: float) -> float:
    """Exponential for |x| < 700: a power of two times the series on [-ln(2)/2, ln(2)/2]."""
    n = np.int64(x * _LOG2_E + (0.5 if x >= 0.0 else -0.5))
    y = x - np.float64(n) * _LN2_HIGH - np.float64(n) * _LN2_LOW
    p = 1.0 / 6227020800.0
    p = p * y + 1.0 / 479001600.0
    p = p * y + 1.0 / 39916800.0
    p = p * y + 1.0 / 3628800.0
    p = p * y + 1.0 / 362880.0
    p = p * y + 1.0 / 40320.0
    p = p * y + 1.0 / 5040.0
    p = p * y + 1.0 / 720.0
    p = p * y + 1.0 / 120.0
    p = p * y + 1.0 / 24.0
    p = p * y + 1.0 / 6.0
    p = p * y + 0.5
    p = p * y + 1.0
    p = p * y + 1.0
    return p * np.int64((n + np.int64(1023)) << np.int64(52)).view(np.float64)


@njit(forceinline=True)
def atan2(y: float, x: float) -> float:
    """Angle of the point (x, y) in (-pi, pi]; 0 at the origin."""
    a, b = abs(y), abs(x)
    low, high = min(a, b), max(a, b)
    steep = low > _TAN_PI_8 * high
    numerator = low - high if steep else low
    denominator = low + high if steep else high
    t = numerator / max(denominator, 1e-300)
    q = t * t
    p = 0.021135373157693245206
    p = p * q - 0.043480522157164624777
    p = p * q + 0.056883492268090104794
    p = p * q - 0.066402339304294085887
    p = p * q + 0.076899534963068577563
    p = p * q - 0.090907730748084137897
    p = p * q + 0.1111110618045594522
    p = p * q - 0.1428571418097646683
    p = p * q + 0.19999999998855110134
    p = p * q - 0.33333333333328438572
    angle = t + t * q * p
    angle = angle + 0.25 * math.pi if steep else angle
    angle = 0.5 * math.pi - angle if a > b else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
