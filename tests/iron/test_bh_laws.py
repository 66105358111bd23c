"""B(H) laws: analytic ones against their formulas, extensions of tables, and what each law promises the solver."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.optimize import brentq

from fieldmap.device.materials.base import LawPoints
from fieldmap.device.model import Arctangent, BHTable, Froehlich, LinearMaterial, Marrocco
from fieldmap.errors import InputError
from fieldmap.iron.elements.bh_law import _cubics, law_tables, straight_laws

FROEHLICH = Froehlich("f", 4000.0, 2.1)
ARCTANGENT = Arctangent("a", 1500.0, 1.95)
MARROCCO = Marrocco("m", 2e-4, 1.0, 5.5, 5e4)
POINTS = np.array([200.0, 400.0, 1000.0, 3000.0, 1e4, 1e5]), np.array([0.7, 1.1, 1.45, 1.65, 1.85, 2.2])
# The relative permeability is low at H = 0, rises, then falls: 80, 200, 1600, 2500, 1500, ...
FOOT = (
    np.array([20.0, 60.0, 150.0, 200.0, 300.0, 600.0, 2e3, 1e4]),
    np.array([0.002, 0.015, 0.08, 0.4, 0.95, 1.3, 1.55, 1.8]),
)


def table(points, saturation=None):
    h, b = points
    above = "slope mu0" if saturation is None else "towards saturation"
    return BHTable("t", h, b, "straight line to the origin", above, b[0] / h[0] / mu_0, saturation)


LAWS = {
    "froehlich": FROEHLICH,
    "arctangent": ARCTANGENT,
    "marrocco": MARROCCO,
    "table": table(POINTS),
    "table towards saturation": table(POINTS, 2.16),
    "foot": table(FOOT),
    "foot towards saturation": table(FOOT, 2.16),
}


def values(material, h):
    tables = law_tables([material])
    return tables.flux_density(h, np.zeros(len(h), int))[0]


def formula(material, h):
    """b(h) as the literature writes it, both in T; Marrocco's h(b) inverted by root finding."""
    if isinstance(material, Froehlich):
        chi = material.mu_r - 1
        return h + chi * h / (1 + chi * h / material.saturation)
    if isinstance(material, Arctangent):
        chi = material.mu_r - 1
        return h + 2 * material.saturation / np.pi * np.arctan(np.pi * chi * h / (2 * material.saturation))

    def field(b):
        power = b ** (2 * material.alpha)
        return (material.eps + (material.c - material.eps) * power / (power + material.tau)) * b

    return np.array([brentq(lambda b, x=x: field(b) - x, 0.0, 3.0, xtol=1e-14) for x in h])


@pytest.mark.parametrize("material", [FROEHLICH, ARCTANGENT, MARROCCO], ids=lambda m: type(m).__name__)
def test_analytic_laws_are_their_formulas(material):
    end = min(material.field_range[1], 50.0)
    h = np.geomspace(1e-8, 0.999 * end, 400)
    exact = formula(material, h)
    assert values(material, h) - h == pytest.approx(exact - h, rel=1e-6)
    assert values(material, np.array([1e-9]))[0] / 1e-9 == pytest.approx(material.initial_mu_r, rel=1e-4)


def test_slope_and_integral_of_laws_in_turn():
    """Neighbouring elements follow different laws, from H = 0 on; slopes and integrals of the formulas by hand."""
    chi, end = FROEHLICH.mu_r - 1, FROEHLICH.saturation
    turned, most = ARCTANGENT.mu_r - 1, 2 * ARCTANGENT.saturation / np.pi
    steep = turned / most

    def exact(law, h):
        if law == 0:
            bend = 1 + chi * h / end
            return 1 + chi / bend**2, h**2 / 2 + end * h - end**2 / chi * np.log(bend)
        if law == 1:
            return 50.0, 25.0 * h**2
        bend = 1 + (steep * h) ** 2
        return 1 + turned / bend, h**2 / 2 + most * (h * np.arctan(steep * h) - np.log(bend) / 2 / steep)

    materials = [FROEHLICH, LinearMaterial("l", 50.0), ARCTANGENT]
    tables = law_tables(materials)
    h = np.concatenate([np.zeros(3), np.repeat(np.geomspace(1e-5, 1.0, 30), 3)])
    law = np.arange(len(h)) % 3
    b, slope = tables.flux_density(h, law)
    stored = tables.integral(h, law)
    assert slope[:3] == pytest.approx([m.initial_mu_r for m in materials], rel=1e-4)
    for k, of in enumerate(law):
        expected_slope, integral = exact(of, h[k])
        assert slope[k] == pytest.approx(expected_slope, rel=2e-3)
        assert stored[k] == pytest.approx(integral, rel=1e-5, abs=1e-12)
        assert of == 1 or h[k] == 0 or b[k] == pytest.approx(formula(materials[of], h[k]), rel=1e-6)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_keeps_what_the_solver_relies_on(name):
    """The slope is at least free space's everywhere, b is continuous, and the polarisation is bounded."""
    material = LAWS[name]
    h = np.concatenate([[0.0], np.geomspace(1e-9, 1e4, 20000)])
    b = values(material, h)
    # The bound allows for the rounding of b.
    assert (np.diff(b) >= np.diff(h) * (1 - 1e-12) - 4e-16 * b[1:]).all()
    knots = law_tables([material]).knots[1:]
    assert values(material, knots * (1 - 1e-12)) == pytest.approx(values(material, knots), rel=1e-9)
    last = values(material, np.array([1e3, 1e6])) - [1e3, 1e6]
    assert last[0] == pytest.approx(last[1], rel=1e-4)


def test_a_table_rises_to_its_saturation():
    """The law passes the points; past them J rises without a jump of slope and ends at the given saturation."""
    h, b = mu_0 * POINTS[0], POINTS[1]
    steel = table(POINTS, 2.16)
    assert values(steel, h) == pytest.approx(b, rel=1e-12)
    x = h[-1] * np.array([1 - 1e-4, 1.0, 1 + 1e-4])
    j = values(steel, x) - x
    assert (j[2] - j[1]) / (j[1] - j[0]) == pytest.approx(1.0, rel=1e-2)
    far = np.array([1e2, 1e5])
    assert values(steel, far) - far == pytest.approx([2.16, 2.16], rel=1e-3)
    # The table ends at 2.074 T; without the extension it stays there.
    assert (values(table(POINTS), far) - far) == pytest.approx([b[-1] - h[-1]] * 2, rel=1e-8)


def test_points_of_a_hyperbola_are_continued_on_it():
    """The extension is the Froehlich-Kennelly hyperbola; a table of its points gives the formula back, beyond too."""
    h = np.geomspace(1.0, 1e5, 200)
    field = mu_0 * h
    sampled = table((h, formula(FROEHLICH, field)), FROEHLICH.saturation)
    beyond = np.geomspace(field[-1], 1e3 * field[-1], 50)
    exact = formula(FROEHLICH, beyond) - beyond
    assert values(sampled, beyond) - beyond == pytest.approx(exact, rel=1e-6)


def test_points_whose_slopes_are_too_steep_still_rise():
    """Slopes of 9 between points with secants of 1 and of 0.1: a cubic falls where a slope exceeds three secants."""
    points = LawPoints(
        np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 1.1, 1.1]), np.array([9.0, 9.0, 9.0, -1.0])
    )
    knots, coefficients = _cubics(points)
    np.testing.assert_array_equal(knots, points.field)
    t = np.linspace(0.0, 1.0, 1001)
    j = np.array([np.polyval(row, t) for row in coefficients[:-1]]) - (knots[:-1, None] + t)
    assert np.diff(j, axis=1).min() > -1e-12
    np.testing.assert_allclose(
        j[:, [0, -1]], np.column_stack([points.polarisation[:-1], points.polarisation[1:]])
    )
    # Each slope is three times the flatter adjacent secant.
    np.testing.assert_allclose(coefficients[:, 2], 1.0 + np.array([3.0, 0.3, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_array_equal(coefficients[-1], [0.0, 0.0, 1.0, 1.1 + 3.0])


def test_the_law_knows_its_range():
    assert FROEHLICH.field_range == (np.inf, np.inf)
    assert table(POINTS).field_range == pytest.approx((mu_0 * 200.0, mu_0 * 1e5))
    first, last = MARROCCO.field_range
    assert first == np.inf
    assert formula(MARROCCO, np.array([last])) == pytest.approx([MARROCCO.end])


@pytest.mark.parametrize(
    ("material", "numbers"),
    [
        (table(POINTS), ["0.7 T", "2.2 T"]),
        (table(POINTS, 2.16), ["0.7 T", "2.16 T", "2.2 T"]),
        (MARROCCO, ["5000", "2.17 T"]),
        (FROEHLICH, ["4000", "2.1 T"]),
    ],
)
def test_the_description_names_the_range(material, numbers):
    assert all(number in material.description for number in numbers)


@pytest.mark.parametrize(
    ("material", "received"),
    [
        (table((np.array([100.0, 200.0, 300.0]), np.array([1.0, 1.2, 1.1]))), "-0.001 T m/A"),
        (table((np.array([100.0, 300.0, 200.0]), np.array([1.0, 1.2, 1.3]))), "200 A/m"),
        (table((np.array([1e5, 2e5]), np.array([1.0, 1.05]))), "5e-07 T m/A"),
        # B that does not rise cannot be H: the check for exchanged columns would divide by its differences.
        (table((np.array([0.1, 0.2, 0.3]), np.array([1.0, 1.2, 1.2]))), "H = 0.1 A/m"),
        (table((np.array([100.0]), np.array([1.0]))), "(1,)"),
        (table((np.array([100.0, 200.0]), np.array([1.0]))), "(2,) and (1,)"),
        (table((np.array([100.0, 200.0]), np.array([1.0, np.nan]))), "(2,)"),
        (table(POINTS, 1.9), "2.074 T"),
        (Froehlich("f", 1.0, 2.0), "mu_r = 1.0"),
        (Arctangent("a", 1000.0, np.inf), "saturation = inf"),
        (Marrocco("m", 2e-4, 0.1, 5.5, 5e4), "(0.0002, 0.1, 5.5, 50000.0)"),
        (Marrocco("m", 0.0, 1.0, 5.5, 5e4), "(0.0, 1.0, 5.5, 50000.0)"),
    ],
)
def test_laws_that_no_iron_follows_are_refused(material, received):
    """Devices made in Python are checked too, although no reader has checked them."""
    with pytest.raises(InputError) as caught:
        law_tables([material])
    (problem,) = caught.value.problems
    assert problem.where == f"material '{material.name}'"
    assert received in problem.received


def test_straight_laws_hold_everywhere():
    """b = mu_r h, without a first or a last point."""
    laws = straight_laws(np.array([1.0, 500.0, 1e5]))
    h = np.array([0.0, 1e-6, 2.0])
    for number, mu_r in enumerate((1.0, 500.0, 1e5)):
        np.testing.assert_allclose(laws.flux_density(h, np.full(3, number))[0], mu_r * h, rtol=1e-14)
    low, high = laws.range_h
    assert np.isinf([low, high]).all()
    assert len(low) == len(high) == 3
