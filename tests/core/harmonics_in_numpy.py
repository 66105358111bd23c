"""Regular solid harmonics by scipy, and their derivatives by the ladder, one coefficient after the other."""

import math

import numpy as np
from scipy.special import sph_harm_y


def place(l, m):
    """Index of a_lm among the coefficients; b_lm follows it."""
    return l * l + 2 * m - 1 if m else l * l


def regular_table(degree, points):
    """(n, (degree + 1)^2): r^l P_l^m e^(i m phi) / (l + m)! without the sign (-1)^m that scipy puts into P_l^m."""
    x, y, z = np.asarray(points).T
    r = np.linalg.norm(points, axis=1)
    theta, phi = np.arccos(np.divide(z, r, out=np.ones_like(z), where=r > 0.0)), np.arctan2(y, x)
    columns = []
    for l in range(degree + 1):
        for m in range(l + 1):
            norm = math.sqrt(4 * np.pi / (2 * l + 1) / (math.factorial(l - m) * math.factorial(l + m)))
            value = (-1) ** m * norm * r**l * sph_harm_y(l, m, theta, phi)
            columns += [value.real] if m == 0 else [value.real, value.imag]
    return np.stack(columns, axis=1)


def derivative_matrix(degree, axis):
    """(degree^2, (degree + 1)^2): derivatives of sums of a_lm Re R_l^m + b_lm Im R_l^m.

    d/dz R_l^m = R_(l-1)^m, (d/dx - i d/dy) R_l^m = R_(l-1)^(m-1) and (d/dx + i d/dy) R_l^m = -R_(l-1)^(m+1).
    """
    matrix = np.zeros((degree**2, (degree + 1) ** 2))

    def add(l, m, part, column):
        """part: (share of Re R_l^m, share of Im R_l^m); R_l^(-m) = (-1)^m conj R_l^m."""
        if abs(m) > l:
            return
        sign = (-1.0) ** m if m < 0 else 1.0
        matrix[place(l, abs(m)), column] += sign * part[0]
        if m:
            matrix[place(l, abs(m)) + 1, column] += sign * (part[1] if m > 0 else -part[1])

    for l in range(1, degree + 1):
        for m in range(l + 1):
            for imaginary in range(2 if m else 1):
                column = place(l, m) + imaginary
                part = (0.0, 1.0) if imaginary else (1.0, 0.0)
                # The real part of i R is -Im R, the imaginary part is Re R.
                turned = (-part[1], part[0])
                if axis == 2:
                    add(l - 1, m, part, column)
                elif axis == 0:
                    add(l - 1, m - 1, (0.5 * part[0], 0.5 * part[1]), column)
                    add(l - 1, m + 1, (-0.5 * part[0], -0.5 * part[1]), column)
                else:
                    add(l - 1, m - 1, tuple(-0.5 * share for share in turned), column)
                    add(l - 1, m + 1, tuple(-0.5 * share for share in turned), column)
    return matrix
