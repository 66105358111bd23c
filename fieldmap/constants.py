"""Physical constants."""

import math

MU0 = 1.25663706127e-6
"""Vacuum permeability, T m/A (CODATA 2022; relative difference from 4 pi 1e-7: 1.3e-10)."""

MU0_OVER_2PI = MU0 / (2.0 * math.pi)
MU0_OVER_4PI = MU0 / (4.0 * math.pi)

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s^2."""
