"""Force formulas of chapter 4: arithmetic on printed constants, symmetry, and fits that recover known constants."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from fieldmap.errors import InputError
from fieldmap.thesis import force_formulas
from fieldmap.thesis.force_formulas import Exponential, HorizontalForce, VerticalForce, fit_horizontal_force

TABLE_4_2 = HorizontalForce(-2e-13, 0.22, 0.05, -0.08, x0=-0.17, nominal_current=1e6)
X, Z = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.15, 0.15, 21), [0.10, 0.12, 0.15]))


def test_4_5_written_out():
    """-L0 I^2/(2 b (1 + z/a + (x - x0)/b)^2) + c with the numbers of Table 4-2 at x = -0.1 m, z = 0.125 m."""
    bracket = 1 + 0.125 / 0.22 + 0.07 / 0.05
    assert TABLE_4_2(-0.1, 0.125, 1e6) == pytest.approx(0.2 / (2 * 0.05 * bracket**2) - 0.08, rel=1e-14)


def test_4_8_is_the_mirror_image_written_out():
    right = TABLE_4_2.mirrored()
    bracket = 1 + 0.125 / 0.22 + (0.17 - 0.1) / 0.05
    half = 0.5 * (-0.2 / (2 * 0.05 * bracket**2) + 0.08)
    assert right(0.1, 0.125, 0.5e6) == pytest.approx(half, rel=1e-14)
    np.testing.assert_allclose(right(X, Z, 1e6), -TABLE_4_2(-X, Z, 1e6), rtol=1e-14)


def test_printed_constants_at_three_to_one_vanish_next_to_the_middle():
    def total(x):
        return float(TABLE_4_2(x, 0.125, 1.5e6) + TABLE_4_2.mirrored()(x, 0.125, 0.5e6))

    assert 1e3 * brentq(total, -0.05, 0.05) == pytest.approx(0.79, abs=0.005)


def test_4_9_written_out_and_its_pole():
    force = HorizontalForce(-8e-4, 5e-3, 3e-3, 3.02e-4, d=1e-2)
    bracket = 1 + 0.09 / 5e-3 + 0.02 / 3e-3 + 0.01 / 1e-2
    assert force(0.02, 0.09, 2.0, -0.01) == pytest.approx(
        2 * 8e-4 / (2 * 3e-3 * bracket**2) + 2 * 3.02e-4, rel=1e-14
    )
    assert force.bracket(-0.057, 0.09) == pytest.approx(0.0, abs=1e-12)


def test_force_is_proportional_to_the_current():
    np.testing.assert_allclose(TABLE_4_2(X, Z, 3e5), 0.3 * TABLE_4_2(X, Z, 1e6), rtol=1e-13)


@pytest.mark.parametrize("side", [1, -1])
def test_fit_finds_the_constants_of_4_9_to_rounding_and_noise_to_its_level(side):
    true = HorizontalForce(-3e-3, 0.02, 0.01, -7e-3, d=0.05, side=side)
    x, z, y = (
        g.ravel() for g in np.meshgrid(np.linspace(-0.03, 0.03, 13), [0.08, 0.1], [-0.02, 0.0, 0.01, 0.03])
    )
    force = true(x, z, 1.0, y)
    fit = fit_horizontal_force(x, z, force, 1.0, y=y, side=side, start=(0.05, 0.03, 0.02))
    found = fit.formula
    for name in ("inductance", "a", "b", "c", "d"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=1e-5)
    assert fit.largest < 1e-9 * np.abs(force).max()
    noise = 1e-3 * np.abs(force).max() * np.random.default_rng(5).standard_normal(force.size)
    noisy = fit_horizontal_force(x, z, force + noise, 1.0, y=y, side=side, start=(0.05, 0.03, 0.02))
    assert noisy.rms == pytest.approx(noise.std(), rel=0.15)


def test_at_one_depth_a_is_a_matter_of_choice():
    """At one depth (4-7) is the same curve for every a, so a must be given a value; the curve does not depend on it."""
    x, z = np.linspace(-0.15, 0.15, 21), np.full(21, 0.125)
    force = TABLE_4_2(x, z, 1e6)
    with pytest.raises(InputError, match="hold a"):
        fit_horizontal_force(x, z, force, 1e6, -0.17)
    one, other = (fit_horizontal_force(x, z, force, 1e6, -0.17, a=a) for a in (0.22, 0.5))
    assert one.formula.b == pytest.approx(0.05, rel=1e-6)
    assert other.formula.b == pytest.approx(0.05 * (1 + 0.125 / 0.22) / (1 + 0.125 / 0.5), rel=1e-6)
    assert max(one.largest, other.largest) < 1e-9


def test_vertical_fit_finds_exponentials():
    true = VerticalForce(Exponential(-8.0, 14.0, -0.17), Exponential(1.1, 10.0, -0.17), 1e6)
    fit = force_formulas.fit_vertical_force(X, Z, true(X, Z, 1e6), 1e6, -0.17)
    assert fit.formula.slope.amplitude == pytest.approx(-8.0, rel=1e-5)
    assert fit.formula.intercept.decay == pytest.approx(10.0, rel=1e-5)
    mirrored = fit.formula.mirrored()
    np.testing.assert_allclose(mirrored(X, Z, 2e6), 2 * fit.formula(-X, Z, 1e6), rtol=1e-12)
    with pytest.raises(InputError, match="two depths"):
        force_formulas.fit_vertical_force(X[:21], Z[:21], X[:21], 1e6, -0.17)


def test_quadratic_fit():
    x = np.linspace(-0.03, 0.03, 9)
    fit = force_formulas.fit_quadratic_force(x, 3 * x**2 - 2 * x + 0.5, 2.0)
    assert fit.formula.coefficients == pytest.approx((3.0, -2.0, 0.5), rel=1e-10)
    assert fit.formula(0.01, 1.0) == pytest.approx(0.5 * (3e-4 - 0.02 + 0.5), rel=1e-10)


def test_arrays_that_do_not_fit():
    with pytest.raises(InputError, match="one length"):
        force_formulas.fit_quadratic_force([0.0, 1.0, 2.0], [1.0, 2.0])
    with pytest.raises(InputError, match="finite"):
        force_formulas.fit_quadratic_force([0.0, 1.0, np.nan], [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="nominal_current"):
        fit_horizontal_force(X, Z, X, 0.0)
    assert replace(TABLE_4_2, d=1.0).bracket(0.0, 0.0, 1.0) == pytest.approx(1 + 3.4 + 1.0)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("held", [None, 0.3])
def test_fit_of_4_7_and_4_8_with_their_origin_and_current(side, held):
    """At a nominal current of 2 A, with the origin at an end of the pole piece; a held or fitted."""
    true = HorizontalForce(-3e-3, 0.3, 0.05, -7e-3, x0=-0.17 * side, nominal_current=2.0, side=side)
    x, z = (one.ravel() for one in np.meshgrid(np.linspace(-0.1, 0.1, 13), [0.08, 0.1, 0.13]))
    found = fit_horizontal_force(x, z, true(x, z, 2.0), 2.0, -0.17 * side, side=side, a=held)
    for name in ("inductance", "a", "b", "c", "x0", "nominal_current", "side", "d"):
        assert getattr(found.formula, name) == pytest.approx(getattr(true, name), rel=1e-5)
    # The attraction is proportional to I I0, the offset to I / I0.
    bracket = 1 + 0.1 / 0.3 + side * (0.01 + 0.17 * side) / 0.05
    written = side * (3 * 2 * 3e-3 / (2 * 0.05 * bracket**2) - 7e-3 * 1.5)
    assert true(0.01, 0.1, 3.0) == pytest.approx(written, rel=1e-12)


def test_4_4_and_4_6_written_out():
    slope, intercept = Exponential(-8.0, 14.0, -0.17), Exponential(1.1, 10.0, -0.17)
    force = VerticalForce(slope, intercept, 1e6)
    m, b = -8 * np.exp(-14 * 0.2), 1.1 * np.exp(-10 * 0.2)
    assert (float(slope(0.03)), float(intercept(0.03))) == pytest.approx((m, b))
    assert force(0.03, 0.12, 2e6) == pytest.approx(2 * (0.12 * m + b))
    assert force.mirrored()(-0.03, 0.12, 2e6) == pytest.approx(2 * (0.12 * m + b))
    assert Exponential(-8.0, 14.0, 0.17, side=-1)(-0.03) == pytest.approx(m)


@pytest.mark.parametrize(
    ("fit", "least"),
    [
        (lambda n: fit_horizontal_force(X[:n], Z[-n:] + X[:n], Z[:n], 1.0, -1.0), 4),
        (lambda n: fit_horizontal_force(X[:n], Z[-n:] + X[:n], Z[:n], 1.0, -1.0, y=X[:n]), 5),
        (
            lambda n: force_formulas.fit_vertical_force(
                X[[0, 0, 1, 1, 2][:n]], Z[[0, 21, 0, 21, 0][:n]], X[:n], 1.0, 0.0
            ),
            4,
        ),
        (lambda n: force_formulas.fit_quadratic_force(X[:n], X[:n]), 3),
    ],
)
def test_as_many_data_as_constants(fit, least):
    fit(least)
    with pytest.raises(InputError) as error:
        fit(least - 1)
    assert error.value.problems[0].must_hold == f"arrays of one length, {least} or more"


def test_no_force_and_no_dependence():
    """Zero force gives zero inductance; a force independent of y gives the largest length d, 100 m."""
    assert fit_horizontal_force(X, Z, 0 * X, 1.0, -0.17).formula.inductance == 0.0
    y = np.resize([0.0, 0.01, 0.02, 0.03], len(X))
    free = fit_horizontal_force(X, Z, TABLE_4_2(X, Z, 1e6), 1e6, -0.17, y=y)
    assert free.formula.d == pytest.approx(100.0, rel=1e-3)
