"""Small devices with closed-form solutions, and studies of them."""

import textwrap
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.special import eval_legendre

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # warnings of its own imports
    import xarray  # noqa: F401

DEVICES = Path(__file__).parents[1] / "devices"
LOOP = (DEVICES / "thin_loop_with_driver.toml").read_text()

SPHERE = (DEVICES / "sphere_below_loop.toml").read_text()


GRID = """
format = 1
title = "Turns and radius"
device = "sphere.toml"

[[vary]]
name = "turns"
key = "coil.loop.turns"
values = [100, 250]

[[vary]]
name = "radius"
key = "body.sphere.radius_mm"
values = [8.0, 10.0]

[[currents]]
name = "one"
amperes_A = 1.0

[record]
quantities = ["currents", "field", "iron"]
points_mm = [[0, 0, -14], [3, 0, -20]]
"""


@pytest.fixture(scope="session")
def devices(tmp_path_factory):
    """A folder with both devices, and `study(name, text)`, which writes a study file there."""
    folder = tmp_path_factory.mktemp("studies")
    (folder / "thin_loop.toml").write_text(LOOP)
    (folder / "sphere.toml").write_text(SPHERE)

    def study(name, text):
        path = folder / name
        path.write_text(textwrap.dedent(text))
        return path

    return SimpleNamespace(
        folder=folder, study=study, loop=folder / "thin_loop.toml", sphere=folder / "sphere.toml"
    )


@pytest.fixture(scope="session")
def grid(devices):
    """Path of a 2 x 2 study of the sphere."""
    return devices.study("grid.toml", GRID)


@pytest.fixture(scope="session")
def sphere_below_loop():
    """B_z on the axis below the sphere, per ampere and turn, in closed form."""
    return _sphere_below_loop


LOOP_RADIUS, LOOP_HEIGHT = 0.03, 0.025


def _sphere_below_loop(depth, radius, mu_r, terms=60):
    """B_z on the axis, `depth` below the sphere's centre, per ampere and turn: the series of geometry/loop_and_sphere.

    Averaged over the winding's 1 mm x 1 mm section by Gauss-Legendre quadrature.
    """
    nodes, weights = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for u, wu in zip(nodes, weights, strict=True):
        for v, wv in zip(nodes, weights, strict=True):
            a, h = LOOP_RADIUS + 0.5e-3 * u, LOOP_HEIGHT + 0.5e-3 * v
            total += 0.25 * wu * wv * _filament(depth, radius, mu_r, a, h, terms)
    return total


def _filament(depth, radius, mu_r, a, h, terms):
    d, cosine = np.hypot(a, h), h / np.hypot(a, h)
    own = mu_0 * a**2 / (2 * (a**2 + (h + depth) ** 2) ** 1.5)
    iron = 0.0
    for n in range(1, terms):
        slope = n * (eval_legendre(n - 1, cosine) - cosine * eval_legendre(n, cosine)) / (1 - cosine**2)
        sine = np.sqrt(1 - cosine**2)
        b = -n * (mu_r - 1) / (n * mu_r + n + 1)
        # psi = -(sin/2) sum (1/n) P_n^1 b_n R^(2n+1) / (d^n r^(n+1)) P_n(cos theta); H_z = d psi / dr at theta = pi.
        radial = -(n + 1) * radius ** (2 * n + 1) / (d**n * depth ** (n + 2))
        iron += -(sine / 2) * (1 / n) * (sine * slope) * b * radial * (-1) ** n
    return own + mu_0 * iron
