"""Section integrals against adaptive quadrature; their derivatives against differences."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from fieldmap.kernels.coils.bar import bar_closed_form
from fieldmap.kernels.coils.filament import filament_slice
from fieldmap.kernels.coils.slice import arc_slice, bar_slice

SECTION = (0.010, 0.020)
POSITIONS = {
    "outside": (0.027, 0.004, 0.021, -0.018),
    "in the hole": (0.003, -0.002, 0.030, -0.009),
    "above, over the section": (0.014, 0.001, 0.045, 0.006),
    "below and outside": (0.025, 0.003, -0.004, -0.043),
    "beside a slice that it would be inside of": (0.013, 0.005, 0.020, -0.019),
    "behind": (-0.015, 0.012, 0.02, -0.019),
}


def integrals(X, v, h1, h2, weight):
    def cube(h, r):
        return ((r - X) ** 2 + v * v + h * h) ** 1.5

    r1, r2 = SECTION
    outward = dblquad(lambda h, r: weight(r) * h / cube(h, r), r1, r2, h2, h1, epsabs=1e-14, epsrel=1e-10)[0]
    axial = dblquad(
        lambda h, r: weight(r) * (r - X) / cube(h, r), r1, r2, h2, h1, epsabs=1e-14, epsrel=1e-10
    )[0]
    return outward, axial


@pytest.mark.parametrize("position", POSITIONS.values(), ids=POSITIONS.keys())
@pytest.mark.parametrize(
    ("function", "weight"), [(arc_slice, lambda r: r), (bar_slice, lambda r: 1.0)], ids=["arc", "bar"]
)
def test_slice_equals_quadrature(position, function, weight):
    X, v, h1, h2 = position
    expected = integrals(X, v, h1, h2, weight)
    assert function(X, v, *SECTION, h1, h2)[:2] == pytest.approx(expected, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("position", POSITIONS.values(), ids=POSITIONS.keys())
@pytest.mark.parametrize("function", [arc_slice, bar_slice], ids=["arc", "bar"])
def test_slice_derivatives_equal_differences(position, function):
    X, v, h1, h2 = position
    got = np.array(function(X, v, *SECTION, h1, h2)[2:])
    expected = [
        slope(lambda t, d=d: function(X + t * d[0], v + t * d[1], *SECTION, h1 + t * d[2], h2 + t * d[2])[0])
        for d in np.eye(3)
    ]
    assert got == pytest.approx(np.array(expected), rel=1e-8, abs=1e-8 * np.abs(got).max())


def slope(function, h=2e-5):
    return (8 * (function(h) - function(-h)) - function(2 * h) + function(-2 * h)) / (12 * h)


@pytest.mark.parametrize("position", POSITIONS.values(), ids=POSITIONS.keys())
def test_bar_in_closed_form_is_the_sum_of_its_slices(position):
    X, v, h1, h2 = position
    v1, v2 = v - 0.015, v + 0.02
    nodes, weights = np.polynomial.legendre.leggauss(60)
    total = np.zeros(5)
    # the slopes of the integrand change at v = 0 if the point is over the section: integrate each side
    for low, high in ((v1, 0.0), (0.0, v2)):
        for node, weight in zip(nodes, weights, strict=True):
            at = (low + high) / 2 + (high - low) / 2 * node
            total += (high - low) / 2 * weight * np.array(bar_slice(X, at, *SECTION, h1, h2))
    closed = np.array(bar_closed_form(v1, v2, SECTION[0] - X, SECTION[1] - X, h1, h2))
    # density: one line per metre, so the tolerance relative to the largest entry is the same for all entries
    assert closed[:2] == pytest.approx(total[:2], rel=1e-7, abs=1e-7 * np.abs(total[:2]).max())
    assert closed[2:] == pytest.approx(total[2:], rel=1e-5, abs=1e-5 * np.abs(total[2:]).max())


def test_slice_far_away_is_a_filament():
    """The section acts like its middle line; the error falls as the square of its size over the distance."""
    error = []
    for scale in (1.0, 0.5, 0.25):
        half = 0.005 * scale
        exact = bar_slice(0.3, 0.1, 0.015 - half, 0.015 + half, 0.2 + half, 0.2 - half)
        filament = filament_slice(0.3, 0.1, 0.015, 0.2)
        error.append(abs(exact[0] / (4 * half * half) / filament[0] - 1))
        assert np.array(exact) / (4 * half * half) == pytest.approx(np.array(filament), rel=2e-3)
    assert np.log2(error[0] / error[1]) == pytest.approx(2, abs=0.1)
