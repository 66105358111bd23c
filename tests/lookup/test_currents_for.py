"""Actuation matrices and their inverse, judged by the map itself and by scipy's linear programs."""

import numpy as np
import pytest
from scipy.optimize import linprog

from fieldmap.currents import IndependentCurrents
from fieldmap.device.payload import MagnetSphere, Payload, PayloadPiece, SoftSphere
from fieldmap.errors import Infeasible, InputError, OutsideMapError
from fieldmap.field import Field
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import (
    Actuation,
    MagneticBody,
    capability,
    currents_for,
    field_actuation,
    gradient_actuation,
    interpolate,
    magnetic_body,
    wrench_actuation,
)
from fieldmap.lookup.demand import demand_of
from fieldmap.store import Grid, MapData
from tests.dynamics.conftest import saturating_map
from tests.refusals import refused

MOMENT = np.array([0.1, -0.2, 0.8])
LIMIT = 3.5
BEAD = magnetic_body(SoftSphere(3e-3, mu_r=1000.0))
MAGNETS = MagneticBody(
    np.array([[1e-3, 0.0, 0.0], [0.0, 0.0, 1e-3]]), np.array([MOMENT, -0.5 * MOMENT[::-1]])
)
PAIR = magnetic_body(
    Payload(1e-3, pieces=[PayloadPiece(MagnetSphere(2e-3, 1.2)), PayloadPiece(SoftSphere(3e-3, mu_r=100.0))])
)


@pytest.fixture(scope="module")
def eight():
    """A map of eight loops: six on a ring, one in its middle, one above."""
    return loops()


def loops(constant=False):
    """The map of eight loops; constant: with the field of a ninth loop that no current drives."""
    angles = np.arange(6) * np.pi / 3
    ring = np.stack([0.044 * np.cos(angles), 0.044 * np.sin(angles), np.full(6, 0.026)], axis=1)
    others = [[0.0, 0.0, 0.026], [0.01, 0.02, 0.06], [0.02, -0.01, 0.03]]
    centres = np.concatenate([ring, others])[: 8 + constant]
    grid = Grid([-0.02, -0.02, -0.08], [0.01, 0.01, 0.01], (5, 5, 5))
    parts = [loop_flux_density_and_gradient(grid.points() - centre, 0.016) for centre in centres]
    flux, slope = (1e3 * np.stack(part) for part in zip(*parts, strict=True))
    shape = (8 + constant, *grid.shape, 3)
    return interpolate(
        MapData(
            grid,
            tuple("12345678"),
            np.ones(8),
            flux_density=flux.reshape(shape),
            gradient=slope.reshape(*shape, 3),
            constant_field=constant,
            fixed_sources=("loop",) if constant else (),
        )
    )


MAPS = {
    "linear": loops,
    "constant field": lambda: loops(True),
    "saturating iron": lambda: saturating_map(free=True),
    "divided currents": saturating_map,
}


@pytest.fixture(scope="module", params=MAPS)
def any_map(request):
    return MAPS[request.param]()


def known_currents(m, rng):
    model = m.info.reduced_model
    if m.parametrisation is None or isinstance(m.parametrisation, IndependentCurrents):
        return rng.uniform(-1.5, 1.5, len(m.coil_names))
    return model.domain.at(rng.uniform(0.1, 0.9, 3))


@pytest.mark.parametrize("load", [MOMENT, MAGNETS, BEAD, PAIR], ids=["dipole", "magnets", "bead", "pair"])
@pytest.mark.parametrize("started", [False, True])
def test_a_force_is_met_in_every_map_on_every_load(any_map, load, started):
    """Where currents are free, the power is at most the power of known currents that give the force."""
    rng, turn = np.random.default_rng(7), None
    middle, size = 0.5 * (any_map.lower + any_map.upper), any_map.upper - any_map.lower
    if isinstance(load, MagneticBody):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for _ in range(4):
        position, known = middle + 0.3 * (rng.random(3) - 0.5) * size, known_currents(any_map, rng)
        force = any_map.wrench(position, load, known, turn)[:3]
        start = 1.02 * known if started else None
        found = any_map.currents_for(position, force, load, 6.0, start=start, orientation=turn)
        made = any_map.wrench(position, load, found, turn)[:3]
        np.testing.assert_allclose(made, force, rtol=0, atol=2e-6 * np.abs(force).max())
        if any_map.info.reduced_model is not None:
            assert any_map.info.reduced_model.domain.holds(found)
        if len(any_map.coil_names) == 8 or isinstance(any_map.parametrisation, IndependentCurrents):
            assert found @ found <= (1 + 1e-5) * (known @ known)


@pytest.mark.parametrize("load", [MOMENT, BEAD], ids=["dipole", "bead"])
def test_a_torque_that_nothing_gives_is_infeasible_in_every_map(any_map, load):
    """The torque is along the moment of a dipole; a sphere of soft iron has no torque. Received is the demand."""
    position = 0.5 * (any_map.lower + any_map.upper)
    with pytest.raises(Infeasible, match=r"received Tx = 0\.0001 N m, Ty = -0\.0002 N m, Tz = 0\.0008 N m"):
        any_map.currents_for(position, torque=1e-3 * MOMENT, moment=load)


def places(m, n, seed=3):
    return m.lower + np.random.default_rng(seed).random((n, 3)) * (m.upper - m.lower)


def test_matrices_times_currents_are_what_the_map_gives(eight):
    position, currents = places(eight, 1)[0], np.random.default_rng(0).normal(size=8)
    flux, slope = eight.field_and_gradient(position, currents)
    np.testing.assert_allclose(field_actuation(eight, position).matrix @ currents, flux, rtol=1e-12)
    eight_rows = gradient_actuation(eight, position)
    five = slope[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]
    assert eight_rows.matrix.shape == (8, 8)
    np.testing.assert_allclose(eight_rows.matrix @ currents, [*flux, *five], rtol=1e-11)
    wrench = wrench_actuation(eight, position, MOMENT)
    np.testing.assert_allclose(wrench.matrix @ currents, eight.wrench(position, MOMENT, currents), rtol=1e-11)


def test_null_space_changes_nothing_and_is_all_that_does_not(eight):
    position = places(eight, 1)[0]
    actuation = wrench_actuation(eight, position, MOMENT)
    # Torque along the moment is always zero: five independent rows of six.
    assert (actuation.rank, actuation.null_space.shape) == (5, (8, 3))
    idle = actuation.null_space @ np.array([1.0, 2.0, -1.0])
    assert np.linalg.norm(idle) == pytest.approx(np.sqrt(6))
    busy = eight.wrench(position, MOMENT, np.ones(8))
    np.testing.assert_allclose(
        eight.wrench(position, MOMENT, 1 + idle), busy, rtol=0, atol=1e-11 * np.abs(busy).max()
    )
    np.testing.assert_allclose(
        np.prod(field_actuation(eight, position).singular_values) ** 2,
        np.linalg.det(field_actuation(eight, position).matrix @ field_actuation(eight, position).matrix.T),
    )


@pytest.mark.parametrize("limits", [LIMIT, (0.0, LIMIT), (np.linspace(-1, 0.5, 8), np.linspace(1, 3, 8))])
def test_capability_is_what_a_linear_program_finds(eight, limits):
    positions, directions = places(eight, 3), np.array([[0.0, 0.0, 2.0], [1.0, -1.0, 0.5]])
    force, torque = capability(eight, positions, MOMENT, directions, limits)
    low, high = (-LIMIT, LIMIT) if np.isscalar(limits) else limits
    bounds = np.stack(np.broadcast_arrays(low, high, np.zeros(8))[:2], axis=1)
    for p, position in enumerate(positions):
        matrix = wrench_actuation(eight, position, MOMENT).matrix
        for d, direction in enumerate(directions / np.linalg.norm(directions, axis=1)[:, None]):
            for rows, found in ((matrix[:3], force), (matrix[3:], torque)):
                best = linprog(-(direction @ rows), bounds=bounds)
                assert found[p, d] == pytest.approx(-best.fun, rel=1e-9)


def test_ten_thousand_feasible_demands_are_met(eight):
    rng = np.random.default_rng(5)
    positions, amperes = places(eight, 10_000), rng.uniform(-LIMIT, LIMIT, (10_000, 8))
    amperes[::4] = np.where(rng.random((2500, 8)) < 0.6, np.sign(amperes[::4]) * LIMIT, amperes[::4])
    moments = rng.normal(size=(10_000, 3))
    wanted = np.concatenate(
        [eight.wrench(p, m, i)[None] for p, m, i in zip(positions, moments, amperes, strict=True)]
    )
    found = np.array(
        [
            eight.currents_for(p, w[:3], m, LIMIT, torque=w[3:])
            for p, w, m in zip(positions, wanted, moments, strict=True)
        ]
    )
    assert np.abs(found).max() <= LIMIT
    assert np.all(np.sum(found**2, axis=1) <= np.sum(amperes**2, axis=1) * (1 + 1e-9))
    given = np.concatenate(
        [eight.wrench(p, m, i)[None] for p, m, i in zip(positions, moments, found, strict=True)]
    )
    for part in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(wanted[:, part], axis=1)
        assert (np.linalg.norm((given - wanted)[:, part], axis=1) / size).max() < 1e-9


def test_what_is_infeasible_says_which_limits_bind_and_what_can_be_had(eight):
    position = np.array([0.0, 0.0, -0.06])
    with pytest.raises(Infeasible) as caught:
        eight.currents_for(position, [0.0, 0.0, 50.0], MOMENT, LIMIT)
    found = caught.value
    at_least = eight.currents_for(position, 0.999999 * found.reachable, MOMENT, LIMIT)
    assert np.abs(at_least).max() > 0.999 * LIMIT
    with pytest.raises(Infeasible):
        eight.currents_for(position, 1.00001 * found.reachable, MOMENT, LIMIT)
    np.testing.assert_allclose(found.reachable, [0, 0, 50 * found.share], atol=1e-12)
    # The named limits are a proof: they alone, with all others lifted, rule the demand out.
    assert 0 < len(found.binding) <= 6
    low, high = np.full(8, -np.inf), np.full(8, np.inf)
    for name, value in found.binding.items():
        assert abs(value) == LIMIT
        (low if value < 0 else high)[int(name) - 1] = value
    with pytest.raises(Infeasible):
        eight.currents_for(position, [0, 0, 50], MOMENT, (low, high))
    low[int(name) - 1], high[int(name) - 1] = -np.inf, np.inf
    assert np.isfinite(eight.currents_for(position, [0, 0, 50], MOMENT, (low, high))).all()
    assert f"{found.share:.6g} of the demand" in str(found)
    assert "coil" in str(found)


def test_no_currents_give_torque_along_the_moment(eight):
    with pytest.raises(Infeasible) as caught:
        eight.currents_for([0, 0, -0.06], moment=[0, 0, 0.8], torque=[1e-3, 0, 1e-3])
    # No coil's limit is the cause.
    assert not caught.value.binding
    np.testing.assert_allclose(caught.value.reachable, [1e-3, 0, 0], atol=1e-12)


def test_field_and_gradient_demands_and_unequal_resistances(eight):
    position = np.array([0.005, 0.0, -0.055])
    field, gradient = eight.field_and_gradient(position, np.linspace(-1, 1, 8))
    currents = eight.currents_for(position, field=field, gradient=gradient)
    np.testing.assert_allclose(currents, np.linspace(-1, 1, 8), atol=1e-7)  # eight rows, eight coils
    even = eight.currents_for(position, field=field)
    dear = eight.currents_for(position, field=field, resistance=[1, 1, 1, 1, 1, 1, 100.0, 1])
    np.testing.assert_allclose(
        even, np.linalg.pinv(field_actuation(eight, position).matrix) @ field, rtol=1e-9
    )
    assert abs(dear[6]) < 0.1 * abs(even[6])
    np.testing.assert_allclose(eight.field(position, dear), field, rtol=1e-9)


def test_a_limit_may_be_a_number_on_one_side_and_one_per_coil_on_the_other(eight):
    position, field = np.array([0.005, 0.0, -0.055]), np.array([0.0, 0.0, 2e-3])
    upper = np.full(8, LIMIT)
    mixed = eight.currents_for(position, field=field, limits=(-LIMIT, upper))
    np.testing.assert_array_equal(mixed, eight.currents_for(position, field=field, limits=LIMIT))
    upper[int(np.argmax(mixed))] = 0.5 * mixed.max()
    assert (eight.currents_for(position, field=field, limits=(-LIMIT, upper)) <= upper).all()


def test_nan_leaves_a_component_free(eight):
    position, free = np.array([0.0, 0.0, -0.06]), np.nan
    lift = eight.currents_for(position, [free, free, 0.1], MOMENT)
    exact = eight.currents_for(position, [0.0, 0.0, 0.1], MOMENT)
    assert eight.wrench(position, MOMENT, lift)[2] == pytest.approx(0.1, rel=1e-9)
    row = wrench_actuation(eight, position, MOMENT).matrix[2]
    np.testing.assert_allclose(lift, 0.1 * row / (row @ row), rtol=1e-9)
    assert lift @ lift < exact @ exact


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"field": [0, 0, 1e-3], "start": [1.0]}, "one finite current per coil"),
        ({"force": "up", "moment": BEAD}, "force.*none infinite"),
        ({"torque": [0, 0, np.inf], "moment": BEAD}, "torque.*none infinite"),
        ({"moment": BEAD}, "force, torque, field or gradient"),
        ({"force": [np.nan] * 3, "moment": BEAD}, "not NaN"),
        ({"force": [0, 0, 1], "moment": BEAD, "orientation": np.ones((3, 3))}, "rotation matrices"),
        ({}, "force, torque, field or gradient"),
        ({"force": [0, 0, 1]}, "moment"),
        ({"force": [0, 1], "moment": MOMENT}, r"force.*shape \(3,\)"),
        ({"field": [0, 0, np.inf]}, "none infinite"),
        ({"field": [np.nan] * 3}, "not NaN"),
        ({"force": [0, 0, 1], "moment": [0, 0, np.nan]}, "moment.*finite"),
        ({"force": [0, 0, 1], "moment": [0, 0, 0]}, "not zero"),
        ({"force": [0, 0, 1], "moment": [np.nan, 0, 1]}, "moment.*finite"),
        ({"force": [0, 0, 1], "moment": [0, np.nan, 1]}, "moment.*finite"),
        ({"field": [0, 0, 1], "resistance": np.inf}, "positive"),
        ({"field": [0, 0, 1], "resistance": [1, 1, 1, 1, 1, 1, 1, -1]}, "positive"),
        ({"field": [0, 0, 1], "limits": -1.0}, "a pair"),
        ({"torque": [0, 0, np.nan], "moment": [0, -0.0, 0]}, "moment"),
        ({"field": [0, 0, 1], "limits": (1.0, -1.0)}, "lower <= upper"),
        ({"field": [0, 0, 1], "limits": np.ones(3)}, "a pair"),
        ({"field": [0, 0, 1], "limits": (np.zeros(8), np.ones(3))}, "a pair"),
        ({"field": [0, 0, 1], "limits": "wide"}, "a pair"),
        ({"field": [0, 0, 1], "resistance": 0.0}, "positive"),
        ({"field": [0, 0, 1], "resistance": np.ones(3)}, "8 of them"),
        ({"field": [0, 0, 1], "resistance": "low"}, "8 of them"),
    ],
)
def test_arguments_that_cannot_be_used(eight, arguments, words):
    with pytest.raises(InputError, match=words):
        eight.currents_for([0, 0, -0.06], **arguments)


def test_the_largest_component_is_that_of_the_ends_of_each_coil():
    """A coil that does nothing adds nothing, whatever its limits; the constant part counts along the axis."""
    inf, matrix = np.inf, np.array([[0.1, -0.3, 0.0], [0.0, 0.5, 0.0]])
    axes = [[1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [2.0, 1.0]]
    limits = [-1.0, -inf, -inf], [2.0, 4.0, inf]
    free, shifted = Actuation(("Bx", "By"), matrix), Actuation(("Bx", "By"), matrix, np.array([0.5, 0.25]))
    assert free.largest(axes, limits).tolist() == [inf, 2.0, inf, pytest.approx(inf)]
    assert shifted.largest(axes[1], limits).tolist() == [2.25]
    for given in (2, 2.0, ([-2, -2, -2], 2.0)):
        assert free.largest(axes, given) == pytest.approx([0.8, 1.0, 1.0, 0.4 + 0.2])
        assert shifted.largest(axes, given) == pytest.approx([1.3, 1.25, 0.75, 0.6 + 1.25])
    assert free.largest(axes, 0).tolist() == free.largest(axes, 0.0).tolist() == [0.0] * 4


@pytest.mark.parametrize(
    ("matrix", "rank"),
    [
        (np.zeros((2, 3)), 0),
        ([[1e-9, 0, 0], [0, 1e9, 0]], 2),
        ([[1, 0, 0], [1, 2.1e-10, 0]], 2),
        ([[1, 0, 0], [1, 1.9e-10, 0]], 1),
    ],
)
def test_rows_count_by_their_directions(matrix, rank):
    """Two rows are one if their directions are apart by less than 2e-10."""
    found = Actuation(("Bx", "By"), np.array(matrix, float))
    assert (found.rank, found.null_space.shape) == (rank, (3, 3 - rank))
    lengths = np.linalg.norm(matrix, axis=1)[:, None] + 1e-300
    assert np.abs((np.array(matrix) / lengths) @ found.null_space).max() < 1e-9


def test_a_field_that_has_no_derivatives_has_no_matrix(eight):
    class OfItsOwn(Field):
        coil_names = tuple("12345678")

        def field(self, points, currents):
            return eight.field(points, np.square(currents))

        def gradient(self, points, currents):
            return eight.gradient(points, np.square(currents))

    for given in (None, np.ones(8)):
        with pytest.raises(InputError):
            field_actuation(OfItsOwn(), [0, 0, -0.06], given)


COMPONENTS = (
    "Fx",
    "Fy",
    "Fz",
    "Tx",
    "Ty",
    "Tz",
    "Bx",
    "By",
    "Bz",
    "dBx/dx",
    "dBx/dy",
    "dBx/dz",
    "dBy/dy",
    "dBy/dz",
)


@pytest.mark.parametrize("load", [MOMENT, MAGNETS], ids=["dipole", "body"])
@pytest.mark.parametrize("number", range(14))
def test_each_component_of_a_demand_selects_its_own(load, number):
    """A made-up field on a dipole, and a made-up load and field on a body."""
    random, asked = np.random.default_rng(number), {}
    wrench, flux, slope = random.standard_normal(6), random.standard_normal(3), random.standard_normal((3, 3))
    given = [wrench, flux, slope.ravel()]
    if load is MOMENT:
        wrench, given = np.concatenate([MOMENT @ slope, np.cross(MOMENT, flux)]), given[1:]
    values = np.full(14, np.nan)
    values[number] = 0.5
    parts = {
        "force": values[:3],
        "torque": values[3:6],
        "field": values[6:9],
        "gradient": np.full((3, 3), np.nan),
    }
    parts["gradient"][[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]] = values[9:]
    for name, part in parts.items():
        asked[name] = None if np.isnan(part).all() else part
    demand = demand_of(asked["force"], load, asked["torque"], asked["field"], asked["gradient"])
    assert (demand.names, demand.values.tolist()) == ((COMPONENTS[number],), [0.5])
    wanted = [*wrench, *flux, *slope[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]]
    assert demand.selection @ np.concatenate(given) == pytest.approx([wanted[number]], rel=1e-12)
    unit = {"F": "N", "T": "N m", "B": "T", "d": "T/m"}[COMPONENTS[number][0]]
    assert demand.text(demand.values) == f"{COMPONENTS[number]} = 0.5 {unit}"
    assert not demand.on_soft_iron


def test_zeros_of_a_demand_are_not_told():
    demand = demand_of(None, None, None, [1.0, 0.0, -2.0], None)
    assert demand.text(demand.values) == "Bx = 1 T, Bz = -2 T"
    assert demand.text(np.array([1.0, 0.9e-9, 1.1e-9])) == "Bx = 1 T, Bz = 1.1e-09 T"
    assert demand.text(np.zeros(3)) == "zero"
    assert demand_of([0.0, 0.0, 1.0], BEAD, None, None, None).on_soft_iron


@pytest.mark.parametrize("name", ["resistance", "limits", "field", "gradient"])
def test_of_a_long_argument_eighty_signs_are_told(eight, name):
    given = "no numbers" * 20
    with pytest.raises(InputError) as caught:
        eight.currents_for([0, 0, -0.06], **{"field": [0, 0, 1e-3], name: given})
    assert caught.value.problems[0].received == repr(given)[:80]


@pytest.mark.parametrize("moment", [[0, 0, 1], [0, 1, 0], [1, 0, 0], [1, -1, 0], [1, 0, -1], [0, 1, -1]])
def test_a_moment_of_zero_sum_is_a_moment(eight, moment):
    wanted = 1e-3 * wrench_actuation(eight, [0, 0, -0.06], np.array(moment, float)).matrix[:3].sum(axis=1)
    found = eight.currents_for([0, 0, -0.06], wanted, moment)
    np.testing.assert_allclose(
        eight.wrench([0, 0, -0.06], moment, found)[:3], wanted, atol=1e-9 * np.abs(wanted).max()
    )


def test_outside_the_map(eight):
    for position in ([0, 0, 0.5], [np.nan, 0, 0]):
        with pytest.raises(OutsideMapError, match="currents_for, position: a place"):
            eight.currents_for(position, field=[0, 0, 1e-3])
    with pytest.raises(OutsideMapError, match="currents_for, position: the whole body"):
        eight.currents_for([eight.upper[0] - 1e-4, 0, -0.06], [0, 0, 1e-3], MAGNETS)


class Tilted(Field):
    """One coil over a magnet on its axis; the iron pulls a little to the side; curved: where the iron saturates."""

    coil_names = ("a",)

    def __init__(self, aside, curved):
        self.aside, self.curved = aside, curved
        self.slope = np.array([[-0.5, 0.0, aside], [0.0, -0.5, 0.0], [aside, 0.0, 1.0]])

    @property
    def affine(self):
        return not self.curved

    proportional = affine

    def field(self, points, currents):
        drive = np.asarray(currents, float)[..., 0]
        return (drive - 0.1 * self.curved * drive**3) * (np.asarray(points) @ self.slope.T)

    def gradient(self, points, currents):
        drive = np.asarray(currents, float)[..., 0]
        return (drive - 0.1 * self.curved * drive**3) * np.broadcast_to(self.slope, (len(points), 3, 3))

    def by_currents(self, points, currents):
        b, g = self.field(points, currents), self.gradient(points, currents)
        rise = 1.0 - 0.3 * self.curved * np.asarray(currents, float)[0] ** 2
        unit = points @ self.slope.T, np.broadcast_to(self.slope, (len(points), 3, 3))
        return b, g, rise * unit[0][:, None], rise * unit[1][:, None]


@pytest.mark.parametrize("curved", [False, True])
def test_a_mesh_that_is_less_symmetric_than_its_machine_is_no_reason_to_refuse(curved):
    """One current for three components: a force along the axis, to within the sideways pull of the mesh."""
    ask = {"position": np.zeros(3), "force": [0.0, 0.0, 0.6], "moment": [0.0, 0.0, 1.0], "limits": 1.5}
    (current,) = currents_for(Tilted(5e-5, curved), **ask)
    assert current - 0.1 * curved * current**3 == pytest.approx(0.6, rel=1e-4)
    with pytest.raises(Infeasible):
        currents_for(Tilted(5e-4, curved), **ask)
    with pytest.raises(Infeasible):
        currents_for(Tilted(0.0, curved), **(ask | {"force": [1e-3, 0.0, 0.6]}))


class AlmostAlike(Field):
    """Two coils of nearly one direction, with a small pull along x and y; curved: where the iron saturates."""

    coil_names = ("a", "b")

    def __init__(self, aside, curved=False):
        self.curved = curved
        self.slopes = np.array([[[-0.5, y, x], [y, -0.5, y], [x, y, 1.0]] for x, y in aside])

    @property
    def affine(self):
        return not self.curved

    proportional = affine

    def field(self, points, currents):
        return np.asarray(points) @ self.gradient(points, currents)[0]

    def gradient(self, points, currents):
        drive = np.asarray(currents, float).reshape(2)
        slope = np.einsum("c,cij->ij", drive - 0.1 * self.curved * drive**3, self.slopes)
        return np.broadcast_to(slope, (len(points), 3, 3))

    def by_currents(self, points, currents):
        rise = 1.0 - 0.3 * self.curved * np.asarray(currents, float) ** 2
        slopes = np.broadcast_to(rise[:, None, None] * self.slopes, (len(points), 2, 3, 3))
        by_field = np.einsum("pcij,pj->pci", slopes, points)
        return self.field(points, currents), self.gradient(points, currents), by_field, slopes


PULL = {"position": np.zeros(3), "force": [0.0, 0.0, 0.6], "moment": [0.0, 0.0, 1.0]}


def test_what_only_a_weak_combination_gives_is_met_as_nearly_as_the_mesh_allows():
    """Fx = 0.02 (a + b) + 5e-4 b vanishes at a = 24.6, b = -24, and leaves 2.4e-6 along y."""
    alike = AlmostAlike([(0.02, 0.0), (0.0205, 1e-7)])
    np.testing.assert_allclose(currents_for(alike, **PULL), [24.6, -24.0], rtol=1e-4)
    with pytest.raises(Infeasible):
        currents_for(alike, **(PULL | {"force": [0.0, 1e-3, 0.6]}))
    with refused(Infeasible, must_hold="within the limits"):
        currents_for(alike, limits=20.0, **PULL)


def test_a_search_that_ends_near_the_demand_has_met_it():
    """5e-5 of the force along x is left: currents that remove it would be beyond saturation."""
    force = [0.0, np.nan, 0.6]
    currents = currents_for(
        AlmostAlike([(5e-5, 0.0), (5.2e-5, 0.0)], curved=True), **(PULL | {"force": force})
    )
    assert (currents - 0.1 * currents**3).sum() == pytest.approx(0.6, rel=1e-4)
    with pytest.raises(Infeasible):
        currents_for(AlmostAlike([(5e-4, 0.0), (5.2e-4, 0.0)], curved=True), **(PULL | {"force": force}))
