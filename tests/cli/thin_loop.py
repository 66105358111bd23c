"""Closed forms of tests/devices/thin_loop.toml, i = 1 A, N turns, radius a:

Bz = mu0 N i a^2 / 2 (a^2 + z^2)^1.5 on the axis; dBz/dz and d2Bz/dz2 by differentiation.
"""

from scipy.constants import g as gravity
from scipy.constants import mu_0

A, N, MASS, MOMENT = 0.044, 1000.0, 0.010, 0.8


def flux(z):
    return mu_0 * N * A**2 / 2 / (A**2 + z**2) ** 1.5


def slope(z):
    return -1.5 * mu_0 * N * A**2 * z / (A**2 + z**2) ** 2.5


def bend(z):
    return -1.5 * mu_0 * N * A**2 * (A**2 - 4 * z**2) / (A**2 + z**2) ** 3.5


def lift_current(z):
    return MASS * gravity / (MOMENT * slope(z))
