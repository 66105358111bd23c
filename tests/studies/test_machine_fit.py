"""Parameters of a machine fitted to measurements."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.stats import chi2

import fieldmap as fm
from fieldmap.device.model import Body, Device, Part, Sphere, placed
from fieldmap.errors import InputError
from fieldmap.field import as_field
from fieldmap.sources import CoilSet
from fieldmap.studies import (
    ComputedReadings,
    FieldReadings,
    InductanceReadings,
    LiftCurrentReadings,
    Unknown,
    fit_machine,
)

POINTS = np.array([[x, 0.0, z] for x in (0.0, 0.004, 0.008) for z in (-0.012, -0.018, -0.024)])


def pair(outer=0.012, height=0.01):
    """Two coils in air."""
    coils = [
        fm.CircularCoil("upper", 0.01, outer, height, 100, placement=placed((0, 0, 0.01))),
        fm.CircularCoil("lower", 0.02, 0.024, 0.01, 80, placement=placed((0, 0, -0.04))),
    ]
    return Device("pair", "", coils)


def coils_alone(device):
    return CoilSet(device.coils)


OUTER = Unknown("coil.upper.outer_radius_mm", 14.0, lower=10.5, upper=20.0)
TURNS_LIKE = Unknown("coil.lower.outer_radius_mm", 22.0, lower=20.5, upper=30.0)


def noisy(seed, noise=2e-6, device=None):
    exact = CoilSet((device or pair()).coils).field(POINTS, [1.0, 2.0])
    rng = seed if isinstance(seed, np.random.Generator) else np.random.default_rng(seed)
    read = exact + noise * rng.standard_normal(exact.shape)
    return FieldReadings("table", POINTS, [1.0, 2.0], read, noise or 1e-7)


def fitted(unknowns, *tables, device=None, **how):
    return fit_machine(device or pair(), unknowns, *tables, **{"solve": coils_alone, **how})


def test_the_stated_deviations_are_those_of_the_fits():
    """chi square of 100 fits with different noise, 2 unknowns each; and errors within two deviations."""
    rng, truth, total = np.random.default_rng(5), np.array([12.0, 24.0]), 0.0
    inside = np.zeros(2)
    for _ in range(100):
        found = fitted([OUTER, TURNS_LIKE], [noisy(rng)])
        error = np.array(list(found.values.values())) - truth
        total += error @ np.linalg.solve(found.covariance, error)
        inside += np.abs(error) < 2 * np.array(list(found.deviations.values()))
        assert found.misfit == pytest.approx(1.0, abs=0.6)
        assert found.misfit < found.misfit_before
        assert found.indistinct == ()
    assert chi2.ppf(1e-3, 200) < total < chi2.ppf(1 - 1e-3, 200)
    assert inside.sum() >= 190


def test_without_noise_the_truth_comes_back():
    unknowns = [OUTER, Unknown("coil.upper.height_mm", 9.0, lower=5.0, upper=15.0)]
    found = fitted(unknowns, [noisy(0, 0.0, pair(0.0137, 0.011))])
    assert found.values["coil.upper.outer_radius_mm"] == pytest.approx(13.7, rel=1e-4)
    assert found.values["coil.upper.height_mm"] == pytest.approx(11.0, rel=1e-3)
    assert found.device.coils[0].outer_radius == pytest.approx(0.0137, rel=1e-4)
    assert found.solves < 60


def test_what_the_readings_cannot_tell_apart_is_named():
    """Far away a coil is a dipole of turns times area, so the fields do not separate the two radii."""
    far = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.2]])
    exact = CoilSet(pair().coils).field(far, [1.0, 0.0])
    table = FieldReadings("far", far, [1.0, 0.0], exact, 1e-3 * np.abs(exact).max())
    outer, inner = (
        replace(OUTER, start=12.0),
        Unknown("coil.upper.inner_radius_mm", 10.0, lower=5.0, upper=10.4),
    )
    found = fitted([outer, inner], [table])
    assert found.indistinct == ((outer.key, inner.key),)
    assert found.correlation[0, 1] < -0.999
    # A prior separates them.
    held = fitted([outer, replace(inner, prior=(10.0, 0.01))], [table])
    assert held.indistinct == ()
    assert held.deviations[inner.key] <= 0.01 * 1.001
    assert held.deviations[outer.key] < 0.2 * found.deviations[outer.key]


def test_tables_that_are_not_fitted_are_predicted_with_error_bars():
    elsewhere = np.array([[0.003, 0.002, -0.015], [0.0, 0.006, -0.02]])

    def there(outer):
        return CoilSet(pair(outer).coils).field(elsewhere, [2.0, 0.0])

    found = fitted([OUTER], [noisy(2)], [FieldReadings("other", elsewhere, [2.0, 0.0], there(0.012), 1e-6)])
    used, predicted = found.tables
    assert (used.used, predicted.used) == (True, False)
    # Linear propagation by hand, from the change of B with the radius.
    slope = (there(0.01201) - there(0.01199)).ravel() / 0.02
    deviation = found.deviations[OUTER.key]
    np.testing.assert_allclose(predicted.uncertainty, np.abs(slope) * deviation, rtol=0.02)
    assert (np.abs(predicted.after - predicted.measured) < 4 * predicted.uncertainty + 1e-12).all()
    assert predicted.misfit < 0.1 * predicted.misfit_before


def sphere(mu_r):
    """An iron sphere on the axis of a coil."""
    body = Body("sphere", "iron", (Part(Sphere(0.01)),), mesh_size=0.006)
    coil = fm.CircularCoil("loop", 0.0295, 0.0305, 0.001, 100, placement=placed((0, 0, 0.025)))
    payload = fm.Payload(mass=2e-3, moment=0.5)
    box = fm.WorkspaceBox(np.array([-0.008, -0.008, -0.024]), np.array([0.008, 0.008, -0.012]))
    iron = {"iron": fm.LinearMaterial("iron", mu_r)}
    return Device("sphere", "", [coil], [body], iron, payload=payload, workspace=box)


def test_a_permeability_from_lift_currents_and_an_inductance():
    """Readings of each kind, computed with another permeability on a finer mesh."""
    truth = fm.solve_linear(sphere(5.0), refinement=1.5)
    places = np.array([[0.0, 0.0, -0.014], [0.0, 0.0, -0.018]])
    amperes = [fm.levitation.lift_current(truth, sphere(5.0).payload, place).current for place in places]
    lift = LiftCurrentReadings("lift", places, amperes, 0.002 * np.array(amperes))
    inductance = InductanceReadings("coil", [[0, 0]], truth.inductance()[0], 1e-3 * truth.inductance()[0])
    flux = ComputedReadings(
        "linkage", lambda device, field: field.at([2.0]).flux_linkage(), truth.at([2.0]).flux_linkage(), 1e-6
    )
    unknown = Unknown("material.iron.mu_r", 3.0, lower=1.0, upper=100.0)
    found = fit_machine(sphere(3.0), [unknown], [lift, inductance], [flux])
    deviation = found.deviations[unknown.key]
    assert found.values[unknown.key] == pytest.approx(5.0, abs=3 * deviation)
    assert deviation < 0.2
    assert found.tables[2].after == pytest.approx(found.tables[2].measured, rel=2e-3)


def ring(gap):
    """The magnetising inductance of a closed core in two halves with two joints, from reluctances."""
    reluctance = 0.2 / (1000 * mu_0 * 1e-4) + 2 * gap / (mu_0 * 1e-4)
    return 100**2 / reluctance


def test_a_joint_by_its_reluctance():
    """The gap of a joint from inductances given by a formula, without a solve."""
    base = Body("base", "iron", (Part(fm.Box((0.04, 0.01, 0.01))),), mesh_size=0.005)
    bar = Body("bar", "iron", (Part(fm.Box((0.04, 0.01, 0.01)), placed((0, 0, 0.01))),), mesh_size=0.005)
    device = Device(
        "ring",
        "",
        [fm.CircularCoil("coil", 0.03, 0.032, 0.01, 100)],
        [base, bar],
        {"iron": fm.LinearMaterial("iron", 1000.0)},
        joints=[fm.Joint(0.1e-3, ("base", "bar"), name="ends")],
    )
    table = ComputedReadings("L", lambda machine, _: [ring(machine.joints[0].gap)], [ring(0.07e-3)], 1e-6)
    unknown = Unknown("joint.ends.gap_mm", 0.1, lower=0.001, upper=1.0)
    found = fitted([unknown], [table], device=device)
    assert found.device.joints[0].gap == pytest.approx(0.07e-3, rel=1e-4)


TABLE = noisy(0)
FEW, LONGER = (ComputedReadings("own", lambda device, field, n=n: np.ones(n), [1.0], 1.0) for n in (1, 2))


@pytest.mark.parametrize(
    ("unknowns", "table", "count"),
    [
        ([OUTER, OUTER, Unknown("coil.lower.height_mm", 5.0, lower=6.0)], replace(TABLE, deviation=0.0), 3),
        ([Unknown("coil.upper.radius_mm", 1.0)], TABLE, 1),
        ([OUTER, TURNS_LIKE], FEW, 1),
        ([OUTER], LONGER, 1),
    ],
)
def test_mistakes_are_told_together(unknowns, table, count):
    with pytest.raises(InputError) as told:
        fitted(unknowns, [table])
    assert len(told.value.problems) == count


def test_workers_give_the_same_fit_and_predictions_are_computed_at_the_ends_only():
    table, unknowns = noisy(4), [OUTER, TURNS_LIKE]
    asked = []

    def far_off(device, _):
        asked.append((1e3 * device.coils[0].outer_radius, 1e3 * device.coils[1].outer_radius))
        return CoilSet(device.coils).field([0.0, 0.0, -0.02], [1.0, 1.0])

    other = ComputedReadings("other", far_off, np.zeros(3), 1e-6)

    plain = fitted(unknowns, [table], [other])
    at_the_end = list(plain.values.values())
    assert asked[0] == pytest.approx((14.0, 22.0))
    assert asked[1] == pytest.approx(at_the_end)
    # One difference per unknown.
    assert len(asked) == 4
    assert [round(float(np.abs(np.subtract(one, at_the_end)).max()), 3) for one in asked[2:]] == [0.14, 0.22]
    pytest.importorskip("distributed")
    asked.clear()
    spread = fitted(unknowns, [table], [other], workers=2)
    assert spread.values == plain.values
    np.testing.assert_array_equal(spread.covariance, plain.covariance)
    # Workers computed the differences and other designs.
    assert len(asked) < 4


def test_a_search_that_is_close_enough_ends():
    rough, fine = (fitted([OUTER], [noisy(4)], close=close) for close in (0.05, 1e-6))
    assert rough.solves < fine.solves
    assert rough.values[OUTER.key] == pytest.approx(fine.values[OUTER.key], rel=0.05)


def test_readings_at_other_currents_of_each_point_and_between_coils():
    """Readings of each kind on air coils against closed forms."""
    device, field = pair(), CoilSet(pair().coils)
    currents = np.column_stack([np.linspace(1, 2, len(POINTS)), np.linspace(-3, 1, len(POINTS))])
    found = FieldReadings("t", POINTS, currents, np.zeros((len(POINTS), 3)), 1.0).computed(device, field)
    exact = [CoilSet(device.coils).field(x, i) for x, i in zip(POINTS, currents, strict=True)]
    np.testing.assert_allclose(found, np.ravel(exact))
    for given in (2.0, [2.0, -1.0]):
        found = FieldReadings("t", POINTS, given, np.zeros((len(POINTS), 3)), 1.0).computed(device, field)
        np.testing.assert_allclose(found, field.field(POINTS, np.broadcast_to(given, 2)).ravel())
    matrix = fm.solve_linear(device).inductance()
    for pairs in ([[0, 1], [1, 1], [0, 0]], [["upper", "lower"], ["lower", "lower"], ["upper", "upper"]]):
        found = InductanceReadings("L", pairs, np.zeros(3), 1.0).computed(device, field)
        np.testing.assert_allclose(found, [matrix[0, 1], matrix[1, 1], matrix[0, 0]])
    lifted = replace(device, payload=fm.Payload(mass=0.01, moment=0.5))
    places = np.array([[0.0, 0.0, -0.005], [0.0, 0.0, -0.01]])
    shares = [2.0, 0.0]
    found = LiftCurrentReadings("i", places, np.zeros(2), 1.0, shares).computed(
        lifted, as_field(field, ([-0.01, -0.01, -0.02], [0.01, 0.01, 0.0]))
    )
    slopes = [0.5 * field.gradient(place, np.array(shares))[2, 2] for place in places]
    np.testing.assert_allclose(found, [0.01 * 9.80665 / slope for slope in slopes], rtol=1e-6)


def test_what_a_fit_rests_on():
    """Deviations and correlations follow from the covariance; assumptions name priors and fitted keys."""
    prior = replace(TURNS_LIKE, prior=(24.0, 0.5))
    solved = []
    found = fitted([OUTER, prior], [noisy(3)], on_solve=solved.append)
    assert found.solves == len(solved)
    assert solved[0] == {OUTER.key: 14.0, TURNS_LIKE.key: 22.0}
    covariance = found.covariance
    sizes = [covariance[k, k] ** 0.5 for k in (0, 1)]
    assert list(found.deviations.values()) == pytest.approx(sizes)
    assert found.correlation[0, 1] == pytest.approx(covariance[0, 1] / (sizes[0] * sizes[1]))
    assert np.diag(found.correlation) == pytest.approx([1.0, 1.0])
    assert found.assumptions[0] == f"fitted: {OUTER.key}, {TURNS_LIKE.key}; all else as the device has it"
    assert found.assumptions[-1] == f"prior of {TURNS_LIKE.key}: 24 +- 0.5"
    assert found.device.coils[1].outer_radius == pytest.approx(1e-3 * found.values[TURNS_LIKE.key])
