"""Fields with closed-form derivatives."""

import numpy as np
import pytest
from numpy.polynomial import polynomial
from scipy.constants import mu_0


def slope_on_axis(z, radius=0.044, turns=1000.0):
    """dBz/dz per ampere, T/m, on the axis of a thin loop at z = 0 (Jackson, section 5.5)."""
    return -1.5 * mu_0 * turns * radius**2 * z * (radius**2 + z**2) ** -2.5


def dipole_field(r):
    """B (n, 3) and its gradient (n, 3, 3) of a vertical dipole of 1 A m^2 at distances r (n, 3): Jackson eq. (5.56)."""
    d2, z, up = np.sum(r**2, axis=1)[:, None, None], r[:, 2, None], np.array([0.0, 0.0, 1.0])
    flux = 1e-7 * (3 * z * r / d2[:, :, 0] ** 2.5 - up / d2[:, :, 0] ** 1.5)
    outer = r[:, :, None] * up + up[:, None] * r[:, None, :] + z[:, :, None] * np.eye(3)
    return flux, 3e-7 * (outer - 5 * z[:, :, None] * r[:, :, None] * r[:, None, :] / d2) / d2**2.5


def solid_harmonics(c1=0.0, c2=0.0, c3=0.0, c4=0.0):
    """Coefficients (x, y, z) of the harmonic potential whose values on the axis are sum_n c_n z^n. By hand: 1: z;
    2: z^2 - r^2/2; 3: z^3 - 3 z r^2/2; 4: z^4 - 3 z^2 r^2 + 3 r^4/8."""
    t = np.zeros((5, 5, 5))
    t[0, 0, 1:] = c1, c2, c3, c4
    for across in ((2, 0), (0, 2)):
        t[across][:3] = -c2 / 2, -1.5 * c3, -3 * c4
    t[4, 0, 0], t[0, 4, 0], t[2, 2, 0] = 3 / 8 * c4, 3 / 8 * c4, 3 / 4 * c4
    return t


class AxisymmetricField:
    """B = I grad(phi) for the harmonic potential phi whose values on the axis are sum_n c_n z^n, n <= 4.

    Derivatives come from the exact polynomial algebra of numpy, not from the code under test.
    """

    coil_names = ("only",)
    proportional = True

    def __init__(self, c, lower=(-0.02, -0.02, -0.1), upper=(0.02, 0.02, 0.1)):
        self.lower, self.upper = np.array(lower), np.array(upper)
        self.amperes, self.potentials, self.derived = np.ones(1), solid_harmonics(*c)[None], {}

    def derivatives(self, points, order):
        """(n, 3, ..., 3), all derivatives of an order in one pass; their polynomials are made once."""
        coefficients = np.tensordot(self.amperes, self._polynomials(order), 1)
        values = polynomial.polyval3d(*np.atleast_2d(points).T, coefficients)
        return np.moveaxis(values, -1, 0)

    def _polynomials(self, order):
        """Coefficients (coils, x, y, z, 3, ..., 3), the last index is the derivative taken last."""
        if order == 0:
            return self.potentials
        if order not in self.derived:
            before = self._polynomials(order - 1)
            self.derived[order] = np.zeros((*before.shape, 3))
            for axis in range(3):
                slope = polynomial.polyder(before, axis=axis + 1)
                self.derived[order][..., axis][tuple(map(slice, slope.shape))] = slope
        return self.derived[order]

    def field(self, points, currents):
        return currents[0] * self.derivatives(points, 1)

    def gradient(self, points, currents):
        return currents[0] * self.derivatives(points, 2)

    def second_gradient(self, points, currents):
        return currents[0] * self.derivatives(points, 3)


@pytest.fixture
def axisymmetric():
    return AxisymmetricField


def with_vertical_part(g):
    """Harmonic potential phi (x, y, z coefficients) with dphi/dz = g(x, y) at z = 0: sum (-1)^k z^(2k+1)/(2k+1)! L^k g,
    L the horizontal Laplacian."""
    layers, sign, factorial, order = [], 1.0, 1.0, 0
    term = np.asarray(g, dtype=float)
    while np.any(term):
        layers += [np.zeros_like(term), sign * term / factorial]
        grown = np.zeros_like(term)
        for axis in (0, 1):
            second = polynomial.polyder(term, 2, axis=axis)
            grown[: second.shape[0], : second.shape[1]] += second
        term, sign, order = grown, -sign, order + 2
        factorial *= order * (order + 1)
    return np.stack(layers, axis=-1)


def lifting_above(g, gradient):
    """A harmonic potential with B_z = g(x, y) at z = 0, and dB_z/dz = gradient there, T/m."""
    whole, part = solid_harmonics(c2=gradient / 2), with_vertical_part(g)
    whole[tuple(map(slice, part.shape))] += part
    return whole


class PolynomialField(AxisymmetricField):
    """Several coils; coil k alone at 1 A gives B = grad phi_k for harmonic polynomials phi_k of x, y, z."""

    def __init__(self, potentials, lower=(-0.02, -0.02, -0.02), upper=(0.02, 0.02, 0.02)):
        self.lower, self.upper = np.array(lower), np.array(upper)
        self.coil_names = tuple(f"coil {k}" for k in range(len(potentials)))
        self.derived = {}
        shape = np.max([p.shape for p in potentials], axis=0)
        self.potentials = np.zeros((len(potentials), *shape))
        for whole, p in zip(self.potentials, potentials, strict=True):
            whole[tuple(slice(n) for n in p.shape)] = p

    def field(self, points, currents):
        return self._at(currents, super().field, points)

    def gradient(self, points, currents):
        return self._at(currents, super().gradient, points)

    def second_gradient(self, points, currents):
        return self._at(currents, super().second_gradient, points)

    def _at(self, currents, method, points):
        self.amperes = np.asarray(currents, dtype=float)
        return method(points, [1.0])


@pytest.fixture
def polynomial_field():
    return PolynomialField


@pytest.fixture
def vertical_part():
    return with_vertical_part
