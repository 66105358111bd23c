"""The reference values of loop_and_sphere.toml are the Legendre series evaluated here.

The series itself is held against what does not know it: a Biot-Savart code, the conditions at the surface,
differences, and the textbook sphere in a uniform field.
"""

from dataclasses import dataclass

import magpylib
import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.special import eval_legendre

from fieldmap.device import read_device

DEGREES = np.arange(1, 81)


@dataclass(frozen=True)
class Series:
    """Scalar potential (H = -grad psi) near an iron sphere at the origin, below its coaxial loops.

    Terms: c_n = -(I sin(alpha)/2n) P_n^1(cos alpha), summed over the loops as K_n = sum c_n/d^n;
    psi = sum K_n (r^n + b_n R^(2n+1)/r^(n+1)) P_n(cos theta), b_n = -n (mu_r - 1)/(n mu_r + n + 1).
    """

    radius: float
    mu_r: float
    strengths: np.ndarray  # K_n
    reactions: np.ndarray  # K_n b_n R^(2n+1)

    def inside(self, r: float, cosine: float) -> float:
        shares = 1 + self.reactions / self.strengths / self.radius ** (2 * DEGREES + 1)
        return float(np.sum(self.strengths * shares * r**DEGREES * eval_legendre(DEGREES, cosine)))

    def outside(self, r: float, cosine: float) -> float:
        terms = self.strengths * r**DEGREES + self.reactions / r ** (DEGREES + 1)
        return float(np.sum(terms * eval_legendre(DEGREES, cosine)))

    def flux_density_z(self, point: np.ndarray) -> float:
        """d/dz of r^n P_n is n r^(n-1) P_(n-1); of P_n/r^(n+1) it is -(n+1) P_(n+1)/r^(n+2)."""
        n, r, cosine = DEGREES, np.linalg.norm(point), point[2] / np.linalg.norm(point)
        applied = self.strengths * n * r ** (n - 1) * eval_legendre(n - 1, cosine)
        reaction = self.reactions * (n + 1) * eval_legendre(n + 1, cosine) / r ** (n + 2)
        return float(-mu_0 * np.sum(applied - reaction))

    def gradient_zz(self, point: np.ndarray) -> float:
        n, r, cosine = DEGREES, np.linalg.norm(point), point[2] / np.linalg.norm(point)
        applied = self.strengths[1:] * (n * (n - 1) * r ** (n - 2.0) * eval_legendre(n - 2, cosine))[1:]
        reaction = self.reactions * (n + 1) * (n + 2) * eval_legendre(n + 2, cosine) / r ** (n + 3)
        return float(-mu_0 * (np.sum(applied) + np.sum(reaction)))


def series(loops: np.ndarray, sphere_radius: float, mu_r: float) -> Series:
    """loops (n, 3): radius, height above the sphere's centre, current."""
    a, z, current = loops[:, :1].T, loops[:, 1:2].T, loops[:, 2:].T
    n, d = DEGREES[:, None], np.hypot(a, z)
    sine, cosine = a / d, z / d
    slope = n * (eval_legendre(n - 1, cosine) - cosine * eval_legendre(n, cosine)) / sine**2  # P_n'
    strengths = np.sum(-current * sine / (2 * n) * sine * slope / d**n, axis=1)
    reaction = -DEGREES * (mu_r - 1) / (DEGREES * mu_r + DEGREES + 1)
    return Series(sphere_radius, mu_r, strengths, strengths * reaction * sphere_radius ** (2 * DEGREES + 1))


def loops_of(coil, current: float, order: int = 16) -> np.ndarray:
    """Gauss-Legendre points of the winding's section as loops."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    a = (coil.inner_radius + coil.outer_radius) / 2 + (coil.outer_radius - coil.inner_radius) / 2 * nodes
    z = coil.placement.position[2] + coil.height / 2 * nodes
    shares = np.outer(weights, weights) / 4 * coil.turns * current
    grid = np.meshgrid(a, z, indexing="ij")
    return np.column_stack([grid[0].ravel(), grid[1].ravel(), shares.ravel()])


@pytest.fixture(scope="module")
def device():
    return read_device("loop_and_sphere")


@pytest.fixture(scope="module")
def closed_form(device) -> Series:
    sphere = device.bodies[0].parts[0].shape
    return series(loops_of(device.coils[0], 1.0), sphere.radius, device.materials["iron"].mu_r)


def test_reference_values_are_the_series(device, closed_form):
    assert len(device.references) == 8
    for reference in device.references:
        known = {"Bz": closed_form.flux_density_z, "dBz/dz": closed_form.gradient_zz}[reference.quantity]
        assert reference.currents.tolist() == [1.0]
        assert reference.value == pytest.approx(known(reference.at), rel=reference.tolerance)
        assert (reference.mu_r, reference.tolerance) == (device.materials["iron"].mu_r, 1e-10)


def test_reference_points_lie_in_the_workspace_and_outside_the_sphere(device):
    for reference in device.references:
        assert np.all(reference.at >= device.workspace.lower)
        assert np.all(reference.at <= device.workspace.upper)
        assert np.linalg.norm(reference.at) > device.bodies[0].parts[0].shape.radius


def test_quadrature_over_the_section_is_converged(device, closed_form):
    coarse = series(loops_of(device.coils[0], 1.0, order=8), 0.01, 1000.0)
    for reference in device.references:
        at = reference.at
        assert coarse.flux_density_z(at) == pytest.approx(closed_form.flux_density_z(at), rel=1e-12)


def test_without_iron_the_series_is_the_field_of_the_loops(device):
    loops = loops_of(device.coils[0], 1.0, order=6)
    bare = series(loops, 0.01, 1.0)
    circles = [
        magpylib.current.Circle(diameter=2 * a, current=i, position=(0, 0, z)) for a, z, i in loops.tolist()
    ]
    for reference in device.references:
        expected = magpylib.getB(circles, reference.at, sumup=True)[2]
        assert bare.flux_density_z(reference.at) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("cosine", [-1.0, -0.6, 0.1, 0.9])
def test_potential_and_normal_flux_are_continuous_at_the_surface(closed_form, cosine):
    r, step = closed_form.radius, 1e-6
    assert closed_form.outside(r, cosine) == pytest.approx(closed_form.inside(r, cosine), rel=1e-12)
    slope_outside = (closed_form.outside(r + step, cosine) - closed_form.outside(r - step, cosine)) / (
        2 * step
    )
    slope_inside = (closed_form.inside(r + step, cosine) - closed_form.inside(r - step, cosine)) / (2 * step)
    assert closed_form.mu_r * slope_inside == pytest.approx(slope_outside, rel=1e-5)


def test_flux_density_and_gradient_are_derivatives_of_the_potential(device, closed_form):
    step = 1e-6
    for reference in device.references:
        up = np.array([0, 0, step])
        ahead, behind = reference.at + up, reference.at - up
        potentials = [
            closed_form.outside(np.linalg.norm(p), p[2] / np.linalg.norm(p)) for p in (ahead, behind)
        ]
        slope = (potentials[0] - potentials[1]) / (2 * step)
        assert closed_form.flux_density_z(reference.at) == pytest.approx(-mu_0 * slope, rel=1e-6)
        change = closed_form.flux_density_z(ahead) - closed_form.flux_density_z(behind)
        assert closed_form.gradient_zz(reference.at) == pytest.approx(change / (2 * step), rel=1e-6)


def test_far_loop_is_the_sphere_in_a_uniform_field():
    loop = np.array([[50.0, 0.0, 1e6]])
    uniform = mu_0 * 1e6 / (2 * 50.0)
    for mu_r in (10.0, 1000.0):
        sphere = series(loop, 0.01, mu_r)
        expected = uniform * (1 + 2 * (mu_r - 1) / (mu_r + 2) * (0.01 / 0.015) ** 3)
        assert sphere.flux_density_z(np.array([0, 0, -0.015])) == pytest.approx(expected, rel=1e-6)
