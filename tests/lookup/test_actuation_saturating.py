"""Actuation of saturating iron: the derivative of the map by its currents, and compiled lookups at any currents."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from fieldmap.currents import IndependentCurrents
from fieldmap.device.payload import MagnetSphere, Payload, PayloadPiece, SoftSphere
from fieldmap.device.placement import placed
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.iron.elements.bh_law import LawTables
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.lookup import (
    compiled_wrench,
    field_actuation,
    gradient_actuation,
    interpolate,
    magnetic_body,
    wrench_actuation,
)
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.store import MapData, ReducedModel

MOMENT = np.array([0.1, -0.2, 0.7])
PLACE = np.array([0.001, -0.002, 0.003])
CURRENTS = np.array([1.1])
POINTS, MODES = 20, 3


@pytest.fixture(scope="module")
def data(dipoles):
    """A map of one dipole as the coil's field and two dipoles as fields of iron that saturates at half an ampere."""
    rng = np.random.default_rng(7)
    linear, knots = dipoles.map((6, 5, 6)), np.array([0.0, 1e-3, 3e-3])
    model = ReducedModel(
        gradients=3e-3 * rng.standard_normal((3 * POINTS, MODES)),
        source=3e-3 * rng.standard_normal((3 * POINTS, 1)),
        weights=rng.random(POINTS) + 0.1,
        law=np.zeros(POINTS),
        law_offset=[0, 3],
        law_knots=knots,
        law_coefficients=[[0, 0, 2e3, 0], [0, -1999 / 4e-3, 2e3, 2], [0, 0, 1, 4.001]],
        air=1e-4 * np.eye(MODES),
        constant=np.zeros(MODES),
        output=rng.standard_normal((2, MODES)),
        known_currents=[[0.0]],
        known_amplitudes=np.zeros((1, MODES)),
        lower=[-2.0],
        upper=[2.0],
        parametrisation=IndependentCurrents(1),
        reference_weights=np.zeros(2),
    )
    return MapData(
        linear.grid,
        ("a",),
        [1.0],
        flux_density=linear.flux_density,
        gradient=linear.gradient,
        reduced_model=model,
    )


@pytest.fixture(scope="module")
def m(data):
    return interpolate(data)


def rows_of(m, currents):
    """B, five entries of G, force and torque at PLACE."""
    flux, slope = m.field_and_gradient(PLACE, currents)
    five = slope[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]
    return np.concatenate([flux, five, m.wrench(PLACE, MOMENT, currents)])


def test_rows_are_tangent_to_the_map(m):
    found = m.actuation(PLACE, CURRENTS, MOMENT)
    assert found.matrix.shape == (14, 1)
    np.testing.assert_allclose(
        found.matrix @ CURRENTS + found.constant, rows_of(m, CURRENTS), rtol=1e-4, atol=1e-12
    )
    steps, left = 0.1 * 0.5 ** np.arange(5), []
    for t in steps:
        there = rows_of(m, CURRENTS + t)
        left.append(np.abs(there - rows_of(m, CURRENTS) - t * found.matrix[:, 0]) / np.abs(there).max())
    orders = np.log2(np.linalg.norm(left[:-1], axis=1) / np.linalg.norm(left[1:], axis=1))
    assert np.all(np.abs(orders[:3] - 2.0) < 0.3)
    # The iron saturates: the derivative at the origin is another.
    origin = m.actuation(PLACE, [0.0], MOMENT)
    assert np.linalg.norm(origin.matrix - found.matrix) > 0.01 * np.linalg.norm(found.matrix)


def test_parts_are_rows_of_the_whole(m):
    whole = m.actuation(PLACE, CURRENTS, MOMENT)
    for part in (
        field_actuation(m, PLACE, CURRENTS),
        gradient_actuation(m, PLACE, CURRENTS),
        wrench_actuation(m, PLACE, MOMENT, CURRENTS),
    ):
        rows = [whole.rows.index(name) for name in part.rows]
        np.testing.assert_allclose(part.matrix, whole.matrix[rows], rtol=1e-12)
        np.testing.assert_allclose(part.constant, whole.constant[rows], rtol=1e-9, atol=1e-15)


def test_of_a_map_that_superposes_currents_change_nothing(coarse):
    currents = np.array([1.0, -2.0, 0.5])
    found, units = coarse.actuation(PLACE, currents, MOMENT), wrench_actuation(coarse, PLACE, MOMENT)
    np.testing.assert_array_equal(found.matrix[8:], units.matrix)
    assert found.constant is None
    *_, flux, slope = coarse.by_currents(PLACE, currents)
    np.testing.assert_array_equal(flux, coarse.unit_field(PLACE))
    np.testing.assert_array_equal(slope, coarse.unit_gradient(PLACE))
    np.testing.assert_allclose(found.matrix @ currents, rows_of(coarse, currents), rtol=1e-12, atol=1e-15)


def test_refusals(m):
    with pytest.raises(InputError):
        wrench_actuation(m, PLACE, MOMENT)
    with pytest.raises(OutsideMapError):
        m.actuation(PLACE, [3.0])
    with pytest.raises(OutsideMapError):
        m.actuation([1.0, 0.0, 0.0], CURRENTS)


def test_points_at_once_are_points_one_by_one(m):
    points = PLACE - 0.001 * np.arange(6).reshape(2, 3)
    together = m.by_currents(points, CURRENTS)
    for k, point in enumerate(points):
        for many, one in zip(together, m.by_currents(point, CURRENTS), strict=True):
            np.testing.assert_allclose(many[k], one, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(together[0], m.field(points, CURRENTS), rtol=1e-5)
    np.testing.assert_allclose(together[1], m.gradient(points, CURRENTS), rtol=1e-5, atol=1e-9)


def test_compiled_lookups_solve_for_new_currents(m, data):
    function, own = m.compiled()

    @numba.njit
    def total(function, own, currents):
        found = 0.0
        for value in currents:
            flux, slope = function(own, np.array([value]), 0.001, -0.002, 0.003)
            found += flux[2] + slope[2][2]
        return found

    currents = np.linspace(0.1, 1.9, 40)
    rows = [m.field_and_gradient(PLACE, [i]) for i in currents]
    assert total(function, own, currents) == pytest.approx(sum(b[2] + g[2, 2] for b, g in rows), rel=1e-4)
    assert np.isnan(function(own, np.array([2.5]), *PLACE)[0]).all()
    wide, open_ended = interpolate(data, outside_currents="evaluate").compiled()
    assert np.isfinite(wide(open_ended, np.array([2.5]), *PLACE)[0]).all()


BODY = magnetic_body(
    Payload(
        1e-3,
        pieces=[
            PayloadPiece(SoftSphere(4e-3, mu_r=500.0), placed([0.0, 1e-3, 2e-3])),
            MagnetSphere(2e-3, 1.2),
        ],
    )
)


@pytest.fixture(scope="module")
def in_compiled_code(m):
    """The wrench and its arguments, and a function that has both as globals. numba takes them for constants, but the
    state is written to all the same."""
    function, data = compiled_wrench(m, BODY)

    @numba.njit
    def lift(amperes, place):
        load, by_currents = np.empty(6), np.empty((6, 1))
        function(data, np.array([amperes]), place, np.eye(3), load, by_currents)
        return load[2]

    return function, data, lift


@pytest.mark.parametrize("amperes", [0.2, 1.1, -0.7])
def test_soft_iron_beside_iron_that_saturates(m, in_compiled_code, amperes):
    """Derivatives by the currents contain the induced moment and the model of the machine's iron."""
    currents = np.array([amperes])
    about = m.actuation(PLACE, currents, BODY)
    here = m.wrench(PLACE, BODY, currents)
    np.testing.assert_allclose((about.matrix @ currents + about.constant)[8:], here, rtol=1e-6)
    step = 1e-4
    ahead, behind = (m.wrench(PLACE, BODY, currents + s * step) for s in (1, -1))
    exact = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(about.matrix[8:, 0], exact, atol=2e-5 * np.abs(exact).max())
    function, data, lift = in_compiled_code
    wrench, slopes = np.empty(6), np.empty((6, 1))
    assert function(data, currents, PLACE, np.eye(3), wrench, slopes)
    np.testing.assert_allclose(wrench, here, rtol=1e-6)
    np.testing.assert_allclose(slopes, about.matrix[8:], rtol=1e-6)
    for other in (amperes, 0.9 * amperes, 0.3):
        exact = m.wrench(PLACE, BODY, [other])[2]
        assert lift(other, PLACE) == pytest.approx(exact, rel=1e-6)
    # Constants and arguments have the same types: nothing is compiled twice.
    assert len(function.signatures) == 1


def test_currents_for_soft_iron_beside_iron_that_saturates(m):
    wanted = m.wrench(PLACE, BODY, [0.9])[:3]
    found = m.currents_for(PLACE, [np.nan, np.nan, wanted[2]], BODY)
    assert m.wrench(PLACE, BODY, found)[2] == pytest.approx(wanted[2], rel=1e-7)
    near = m.currents_for(PLACE, [np.nan, np.nan, wanted[2]], BODY, start=[0.85])
    assert near == pytest.approx([0.9], rel=1e-5)


@pytest.mark.parametrize("outside", ["raise", "nan", "clamp"])
def test_one_point_at_the_currents_of_before_is_that_of_many(data, outside):
    """The quick path of one point gives the bits of the general path, follows the currents, and leaves points outside
    and other types of input to the general path."""
    m, fresh = interpolate(data, outside=outside), interpolate(data, outside=outside)
    rng = np.random.default_rng(2)
    for currents in (CURRENTS, CURRENTS, np.array([0.4]), CURRENTS, np.array([-1.9])):
        for point in rng.uniform(m.lower, m.upper, (3, 3)):
            wanted = fresh.field_and_gradient(point[None], currents)
            load = fresh.wrench(point[None], MOMENT, currents)[0]
            for given in (currents, currents.tolist(), currents.astype(np.float32).astype(float)):
                np.testing.assert_allclose(m.wrench(point, MOMENT, given), load, rtol=1e-6, atol=1e-18)
            for found, one in zip(m.field_and_gradient(point, currents), wanted, strict=True):
                np.testing.assert_array_equal(found, one[0])
            np.testing.assert_allclose(m.wrench(point, MOMENT, currents), load, rtol=1e-12, atol=1e-18)
    away = m.upper + 1.0
    if outside == "raise":
        with pytest.raises(OutsideMapError):
            m.wrench(away, MOMENT, currents)
    else:
        beyond = fresh.wrench(away[None], MOMENT, currents)[0]
        np.testing.assert_allclose(m.wrench(away, MOMENT, currents), beyond, rtol=1e-12, atol=1e-18)
    for _ in range(2):
        m.field(PLACE, CURRENTS)
    calls, evaluator = [], m._evaluator
    for name in ("field_at", "dipole_wrench_at"):
        quick = getattr(evaluator, name)
        setattr(evaluator, name, lambda *given, quick=quick: calls.append(given[-1]) or quick(*given))
    m.wrench(PLACE, MOMENT, CURRENTS)
    m.field_and_gradient(PLACE, CURRENTS)
    assert [weights is None for weights in calls] == [False, False]
    # New currents are solved by the general path; then they are known.
    m.wrench(PLACE, MOMENT, 0.9 * CURRENTS)
    assert len(calls) == 2
    m.wrench(PLACE, MOMENT, 0.9 * CURRENTS)
    assert len(calls) == 3


@pytest.fixture(scope="module")
def model(data):
    """The model of the currents, and a model of the same iron that is solved closely in numpy."""
    m = data.reduced_model
    tables = LawTables(
        m.law_offset.astype(np.int64), m.law_knots, m.law_coefficients, np.array([[0.0], [3e-3]])
    )
    exact = GalerkinModel(m.gradients, m.source, m.weights, m.law.astype(np.int64), tables, m.air, m.constant)
    return CurrentModel(m, data.coil_names), exact


AMPERES = np.array([[-1.7], [0.3], [0.9], [1.9]])


def test_weights_and_slopes_of_currents_are_those_of_the_equation(model, data):
    """Against Newton's method in numpy and its central differences, with the accuracy that each function states."""
    ours, exact = model

    def weights_at(amperes):
        rows = np.array([exact.solve(row, np.zeros(MODES), 1e-12)[0] for row in amperes])
        return rows, np.concatenate([amperes, rows @ data.reduced_model.output.T], axis=1)

    amplitudes, weights = weights_at(AMPERES)
    ahead, behind = (weights_at(AMPERES + step)[1] for step in (1e-4, -1e-4))
    slopes = ((ahead - behind) / 2e-4)[:, :, None]
    size = np.abs(weights).max()
    np.testing.assert_allclose(ours.weights(AMPERES), weights, atol=1e-5 * size)
    np.testing.assert_allclose(
        ours.weights(AMPERES.reshape(2, 2, 1)), weights.reshape(2, 2, 3), atol=1e-5 * size
    )
    np.testing.assert_allclose(
        [ours.amplitudes(row) for row in AMPERES], amplitudes, atol=1e-6 * np.abs(amplitudes).max()
    )
    np.testing.assert_allclose(ours.slopes(AMPERES), slopes[:, 1:], atol=1e-4 * np.abs(slopes).max())
    np.testing.assert_allclose(ours.of_amplitudes(amplitudes), weights[:, 1:], rtol=1e-9)
    search = ours.search()
    for row, of_row, slope in zip(AMPERES, weights, slopes, strict=True):
        for found, close in ((ours.weights_and_slopes(row), 1e-5), (search.weights_and_slopes(row), 1e-7)):
            np.testing.assert_allclose(found[0], of_row, atol=close * size)
            np.testing.assert_allclose(found[1], slope, atol=1e-4 * np.abs(slopes).max())
    # Equal currents give equal bits, whatever was asked before; a model that follows its last state comes near.
    np.testing.assert_array_equal(ours.weights(AMPERES[::-1])[::-1], ours.weights(AMPERES))
    following = CurrentModel(data.reduced_model, data.coil_names, follow=True)
    np.testing.assert_allclose([following.weights(row) for row in AMPERES], weights, atol=1e-5 * size)


def test_currents_beyond_the_domain_by_each_rule(model, data):
    """The domain ends at 2 A; a billionth of the range beyond it counts as rounding."""
    rows = np.array([[1.0], [2.0 + 3.9e-9], [2.5]])
    inside = model[0].weights(rows[:2])
    with pytest.raises(OutsideMapError) as caught:
        model[0].weights(rows)
    assert caught.value.problems[0].received == "2.5 A"
    with pytest.raises(OutsideMapError):
        model[0].weights_and_slopes(rows[2])
    flagged = CurrentModel(data.reduced_model, data.coil_names, "nan").weights(rows)
    np.testing.assert_array_equal(flagged[:2], inside)
    np.testing.assert_array_equal(flagged[2], [2.5, np.nan, np.nan])
    anywhere = CurrentModel(data.reduced_model, data.coil_names, "evaluate").weights(rows)
    amplitude = model[1].solve(rows[2], np.zeros(MODES), 1e-12)[0]
    np.testing.assert_allclose(anywhere[2], [2.5, *data.reduced_model.output @ amplitude], rtol=1e-5)
    # Searches and tables may go beyond the domain.
    np.testing.assert_allclose(model[0].amplitudes(rows[2]), amplitude, rtol=1e-5)
    assert np.isfinite(model[0].slopes(rows[2:])).all()


def test_a_background_has_the_weight_1_behind_the_iron(model, data):
    background = CurrentModel(replace(data.reduced_model, fixed=np.zeros(3 * POINTS)), ("a",))
    assert (background.fields_beside_coils, model[0].fields_beside_coils) == (3, 2)
    plain = model[0].weights(AMPERES)
    np.testing.assert_allclose(
        background.weights(AMPERES), np.append(plain, np.ones((4, 1)), axis=1), atol=1e-5
    )
    amplitudes = np.ones((2, 4, MODES))
    found = background.of_amplitudes(amplitudes)
    np.testing.assert_array_equal(found[..., :2], model[0].of_amplitudes(amplitudes))
    np.testing.assert_array_equal(found[..., 2], np.ones((2, 4)))
    assert not background.slopes(AMPERES)[:, 2].any()
