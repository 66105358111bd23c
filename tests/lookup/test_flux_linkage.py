"""Flux linkages of maps: closed forms, the co-energy of the reduced model, the solvers, and the work of a magnet."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.interpolate import PPoly
from scipy.optimize import minimize

import fieldmap as fm
from fieldmap.core.iron import FOUND, CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.device.air_sources import AirSource
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import (
    MagneticBody,
    back_emf,
    compiled_linkages,
    compiled_wrench,
    interpolate,
    payload_linkage,
)
from fieldmap.lookup.current_solver import compiled_model
from fieldmap.lookup.soft_body import soft_rule
from fieldmap.store import MapData, StoredLinkage, read_map, write_map
from tests.core.iron_cases import CASES, KNOTS, MODES, POINTS, drawn, residual
from tests.dynamics.conftest import saturating_data
from tests.iron.shared import STEEL, core_and_coils
from tests.lookup.test_heat_and_loops import cycle, energies, led, map_of

PLACE, MOMENT = np.array([1e-3, -2e-3, 3e-3]), np.array([0.1, -0.2, 0.7])
AIR = StoredLinkage(1e-3 * (np.eye(6) + 0.1), 1e-4 * np.arange(6.0))
CURRENTS = np.array([0.3, -0.4, 1.2, 0.8, -0.2, 0.5])


@pytest.fixture(scope="module")
def m():
    """A made-up map of saturating iron with six free currents."""
    return interpolate(replace(saturating_data(free=True), linkage=AIR))


def coenergy_of(of, currents):
    """Reduced co-energy times mu0, the least of a functional over the amplitudes: integral of b - h, and the rest."""
    gradients = of.gradients.astype(np.float32).astype(float)
    applied = of.source @ currents + (of.fixed if of.fixed.size else 0.0)

    def functional(amplitudes):
        size = np.linalg.norm((applied - gradients @ amplitudes).reshape(POINTS, 3), axis=1)
        knots = np.append(KNOTS, 1e3)
        inside = PPoly(of.law_coefficients[:3].T, knots).antiderivative()(size) - size**2 / 2
        return of.weights @ inside - of.constant @ amplitudes + 0.5 * amplitudes @ of.air @ amplitudes

    def slope(amplitudes):
        return -residual(of, amplitudes, currents)

    return minimize(functional, np.zeros(MODES), jac=slope, method="BFGS", options={"gtol": 1e-13}).fun


@cache
def core_of(of):
    return CoreIron(core_numbers(compiled_model(of, False)))


def in_core(of, currents, inductance=True):
    state = core_of(of).state()
    linkages, slopes = np.empty(len(currents)), np.empty((len(currents), len(currents)))
    assert state.linkages(currents, linkages, slopes if inductance else None, tolerance=1e-11) == FOUND
    return linkages, slopes


@pytest.mark.parametrize("name", CASES)
def test_linkages_are_derivatives_of_the_coenergy_of_the_reduced_model(name):
    of = CASES[name]
    for currents in drawn(of, 3):
        linkages, slopes = in_core(of, currents)
        alone, _ = in_core(of, currents, inductance=False)
        np.testing.assert_allclose(alone, linkages, rtol=1e-9, atol=1e-12 * np.abs(linkages).max())
        steps = 1e-4 * np.eye(len(currents))
        fall = [coenergy_of(of, currents + step) - coenergy_of(of, currents - step) for step in steps]
        np.testing.assert_allclose(linkages, np.array(fall) / 2e-4, atol=2e-6 * np.abs(linkages).max())
        # Differences of linkages, of fourth order; symmetric, as second derivatives are.
        near = {k: np.array([in_core(of, currents + k * step)[0] for step in steps]) for k in (-2, -1, 1, 2)}
        wanted = (near[-2] - 8 * near[-1] + 8 * near[1] - near[2]) / 12e-4
        np.testing.assert_allclose(slopes, wanted.T, atol=1e-6 * np.abs(slopes).max())
        np.testing.assert_allclose(slopes, slopes.T, atol=1e-9 * np.abs(slopes).max())


def loop(turns, radius):
    source = AirSource("Circle", fm.placed([0, 0, 0]), current=1.0, diameter=2 * radius)
    return fm.Device("one", "", coils=(fm.MagpylibCoil("loop", (source,), turns=turns),))


def test_a_dipole_on_the_axis_of_a_loop():
    """mu0 N m R^2 / (2 (R^2 + z^2)^1.5), and 3 mu0 N m R^2 z v / (2 (R^2 + z^2)^2.5) where it rises."""
    turns, radius, depth, moment, speed = 50, 0.02, 0.03, 1.3, 0.4
    field, place = fm.solve_linear(loop(turns, radius)), [0.0, 0.0, -depth]
    size = radius**2 + depth**2
    wanted = mu_0 * turns * moment * radius**2 / (2 * size**1.5)
    assert payload_linkage(field, place, 2.0, [0, 0, moment]) == pytest.approx([wanted], rel=1e-9)
    rate = 3 * depth * speed / size * wanted
    assert back_emf(field, place, 2.0, [0, 0, moment], [0, 0, speed]) == pytest.approx([rate], rel=1e-9)
    # Turned towards the plane of the loop, the moment links flux like the cosine: at first no change.
    assert back_emf(field, place, 0.0, [0, 0, moment], np.zeros(3), [3.0, 0, 0]) == pytest.approx(
        [0.0], abs=1e-15
    )
    aside = back_emf(field, place, 0.0, [0, moment, 0], np.zeros(3), [3.0, 0, 0])
    assert aside == pytest.approx([3.0 * wanted], rel=1e-9)


def test_linkages_and_forces_are_derivatives_of_one_coenergy(m):
    """d(linkage)/dx at fixed currents = dF/dI, of magnets and of soft iron; both by differences."""
    step, ampere = 1e-5, 1e-3
    points = np.array([[3e-3, -1e-3, 2e-3], [-2e-3, 0.0, 1e-3]])
    soft = MagneticBody(
        points, np.array([MOMENT, -0.5 * MOMENT]), soft=soft_rule(fm.SoftSphere(2e-3, mu_r=50.0))
    )
    for body in (MagneticBody.dipole(MOMENT), soft):
        for axis in np.eye(3):
            ends = [payload_linkage(m, PLACE + sign * step * axis, CURRENTS, body) for sign in (1, -1)]
            moved = (ends[0] - ends[1]) / (2 * step)
            pulls = [
                [m.wrench(PLACE, body, CURRENTS + sign * ampere * coil)[:3] @ axis for sign in (1, -1)]
                for coil in np.eye(6)
            ]
            wanted = np.array([(a - b) / (2 * ampere) for a, b in pulls])
            assert moved == pytest.approx(wanted, rel=2e-4, abs=2e-4 * np.abs(wanted).max())
            exact = m.back_emf(PLACE, CURRENTS, body, axis)
            assert exact == pytest.approx(moved, rel=1e-5, abs=1e-5 * np.abs(moved).max())


def along_path(m, ends, currents):
    """Voltages and work (k, n + 1) of a dipole along straight lines (k + 1, 3), by a Gauss rule in each cell, and the
    changes of the linkages and of the co-energy, which is m . B and the reaction's part."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    faces, body, found, changes = m.info.grid.points(), MagneticBody.dipole(MOMENT), [], []
    for a, b in itertools.pairwise(ends):
        with np.errstate(divide="ignore", invalid="ignore"):
            meets = np.unique(np.clip((faces - a) / (b - a), 0.0, 1.0))
        sums = np.zeros(len(m.coil_names) + 1)
        for begin, end in itertools.pairwise(meets[np.isfinite(meets)]):
            for share, weight in zip(0.5 * (1 + nodes), 0.5 * (end - begin) * weights, strict=True):
                place = a + (begin + share * (end - begin)) * (b - a)
                force = m.wrench(place, MOMENT, currents)[:3]
                sums += weight * np.append(m.back_emf(place, currents, MOMENT, b - a), force @ (b - a))
        found.append(sums)
        ends_of_line = [
            np.append(payload_linkage(m, end, currents, MOMENT), -body.energy(m, end, currents))
            for end in (a, b)
        ]
        changes.append(ends_of_line[1] - ends_of_line[0])
    return np.array(found), np.array(changes)


def closed_to(m, ends, currents):
    """Errors of voltages and work along the lines of a path, and of their sums along a closed path: relative."""
    found, changes = along_path(m, ends, currents)
    sizes = np.abs(found).max(axis=0)
    return (np.abs(found - changes) / sizes).max(), (np.abs(found.sum(axis=0)) / sizes).max()


def test_voltages_and_work_along_a_path_are_changes_of_linkages_and_of_the_coenergy(m):
    """At fixed currents of saturating iron; along a closed path the sums vanish."""
    ends = PLACE + np.array([[0, 0, 0], [3e-4, 0, 1e-4], [1e-4, 4e-4, 0], [0, 0, 0]])
    assert max(closed_to(m, ends, CURRENTS)) < 1e-9


def test_paths_through_many_cells_of_a_map(tmp_path):
    """The form "hermite" has no steps between its cells. The steps of "harmonic" are errors of the interpolation; the
    coils of a simulator see them too, because its states are linkages."""
    path = fm.generate(fm.read_device("desk_levitator"), tmp_path / "desk.h5", spacing=3e-3)
    smooth, stepped = (fm.open_map(path, kind=kind) for kind in ("hermite", "harmonic"))
    low, high = (smooth.lower + share * (smooth.upper - smooth.lower) for share in (0.1, 0.9))
    ends = np.array([low, [high[0], low[1], low[2]], high, low])
    assert max(closed_to(smooth, ends, 0.24)) < 1e-9
    assert 1e-6 < max(closed_to(stepped, ends, 0.24)) < 1e-3


def test_a_map_adds_air_magnets_and_iron(m):
    iron = m._model.linkages(CURRENTS, inductance=True)
    assert m.flux_linkage(CURRENTS) == pytest.approx(
        AIR.inductance @ CURRENTS + AIR.constant + iron[0], rel=1e-12
    )
    assert m.inductance(CURRENTS) == pytest.approx(AIR.inductance + iron[1], rel=1e-7)
    # Equal currents give equal bits, whatever was asked before.
    m.flux_linkage(-CURRENTS), m.inductance(0.5 * CURRENTS)
    for again, before in zip(m._model.linkages(CURRENTS, inductance=True), iron, strict=True):
        np.testing.assert_array_equal(again, before)
    for one in ({"position": PLACE}, {"moment": MOMENT}):
        with pytest.raises(InputError):
            m.flux_linkage(CURRENTS, **one)
    with pytest.raises(OutsideMapError):
        m.flux_linkage(100.0)
    with pytest.raises(InputError):
        interpolate(saturating_data(free=True)).inductance(CURRENTS)


def test_iron_that_remembers_links_what_its_cells_hold():
    """Against moments of the cells in numpy; a question at other currents leaves the memory as it is."""
    remembering = map_of()
    for memory in led(remembering, cycle(8)[:5]):
        linked, _ = memory._model.linkages(memory.last_currents)
        wanted = energies([memory])[0][0]
        assert linked == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())
        before = memory.remembered
        memory._model.linkages(memory.last_currents + 0.1, inductance=True)
        np.testing.assert_array_equal(memory.remembered, before)


@pytest.mark.slow
def test_a_map_of_saturating_iron_against_its_solver(tmp_path):
    """At random currents; the core saturates at 20 A. Linkages are within the error that the map states, trained
    inductances within 0.5 %, at the knee of the law too."""
    device = core_and_coils(STEEL)
    limit = {"lower_A": -80.0, "upper_A": 80.0, "inductance": True, "accuracy": 5e-5}
    box = [[-4e-3, -4e-3, -16e-3], [4e-3, 4e-3, -8e-3]]
    path = fm.generate(
        device, tmp_path / "m.h5", spacing=2e-3, box=box, currents=limit, iron={"model": "saturating"}
    )
    m, solver = fm.open_map(path), NonlinearSolver(device)
    stated = m.info.provenance.solver_report["linkage_error"]
    found = []
    for currents in np.random.default_rng(5).uniform(-80.0, 80.0, (40, len(device.coils))):
        state = solver.solve(currents, 1e-5)
        wanted, matrix = state.flux_linkage(), solver.differential_inductance(state)
        assert np.abs(m.flux_linkage(currents) - wanted).max() < 3 * stated["share"] * np.abs(wanted).max()
        assert np.abs(m.inductance(currents) - matrix).max() < 5e-3 * matrix.max()
        assert matrix == pytest.approx(matrix.T, abs=1e-7 * matrix.max())
        found.append(matrix[0, 0])
    assert min(found) < 0.3 * max(found)
    assert stated["share"] < 3e-3
    assert stated["inductance_share"] < 5e-3


def test_linear_maps_have_what_their_solver_has(tmp_path):
    """With a magnet in the iron and its flux at zero currents; through the file, to the last bit."""
    device = core_and_coils(magnet=True)
    path = fm.generate(
        device, tmp_path / "m.h5", spacing=2e-3, box=[[-4e-3, -4e-3, -16e-3], [4e-3, 4e-3, -8e-3]]
    )
    m, solved = fm.open_map(path), fm.solve_linear(device)
    assert m.inductance() == pytest.approx(solved.inductance(), rel=1e-6)
    currents = np.arange(1.0, 1 + len(device.coils))
    assert m.flux_linkage(currents) == pytest.approx(solved.flux_linkage(currents), rel=1e-6)
    data = read_map(path)
    other = replace(data, linkage=StoredLinkage(data.linkage.inductance, data.linkage.constant + 1.0))
    again = fm.open_map(write_map(tmp_path / "again.h5", other))
    np.testing.assert_array_equal(again.inductance(), m.inductance())
    assert again.flux_linkage(currents) - m.flux_linkage(currents) == pytest.approx(np.ones(len(currents)))
    without = write_map(tmp_path / "without.h5", replace(data, linkage=None))
    with pytest.raises(InputError):
        fm.open_map(without).flux_linkage(currents)


def test_coils_without_an_inductance_of_their_own_are_named(tmp_path):
    path = fm.generate(loop(5, 0.02), tmp_path / "m.h5", spacing=2e-3, box=[[-4e-3] * 3, [4e-3] * 3])
    m = fm.open_map(path)
    assert "loop" in m.info.provenance.solver_report["without_linkage"]
    with pytest.raises(InputError):
        m.inductance()
    # The flux of a magnet in a coil needs no inductance.
    assert m.back_emf([0, 0, 1e-3], 0.0, [0, 0, 1.0], [0, 0, 1.0]).shape == (1,)


@pytest.mark.parametrize(
    "given",
    [
        {"inductance": np.eye(2), "constant": np.zeros(3)},
        {"inductance": np.array([[1.0, 2.0], [0.0, 1.0]]), "constant": np.zeros(2)},
        {"inductance": np.full((1, 1), np.nan), "constant": np.zeros(1)},
    ],
)
def test_damaged_linkages_are_refused(given):
    with pytest.raises(InputError):
        StoredLinkage(**given)


SOFT = MagneticBody(
    np.array([[3e-3, -1e-3, 2e-3]]), MOMENT[None], soft=soft_rule(fm.SoftSphere(2e-3, mu_r=50.0))
)
TURN = np.array([[0.8, 0.6, 0.0], [0.0, 0.0, -1.0], [-0.6, 0.8, 0.0]])


def linear_of(m, constant):
    """The fields of a map as fields of linear iron, the last of them as a field that no current drives."""
    data = saturating_data(free=True)
    fields = {name: getattr(data, name)[: 6 + constant] for name in ("flux_density", "gradient")}
    sources = {"constant_field": True, "fixed_sources": ("background",)} if constant else {}
    return interpolate(MapData(data.grid, data.coil_names, np.ones(6), **fields, **sources, linkage=AIR))


@pytest.mark.parametrize("iron", ["saturating", "linear", "constant"])
def test_compiled_linkages_are_those_of_the_map(m, iron):
    """For coils alone, and with a body of a magnet and soft iron; NaN where the field is not known."""
    of = m if iron == "saturating" else linear_of(m, iron == "constant")
    relative = 1e-4 if iron == "saturating" else 1e-12
    linkages, inductance = np.empty(6), np.empty((6, 6))
    wide = np.repeat(CURRENTS, 2)[::2]
    for body in (None, SOFT):
        evaluate, data = compiled_linkages(of, body)
        assert evaluate(data, wide, PLACE, np.asfortranarray(TURN), linkages, inductance.T)
        wanted = of.flux_linkage(CURRENTS, *(() if body is None else (PLACE, body, TURN)))
        assert np.abs(linkages - wanted).max() < relative * np.abs(wanted).max()
        assert np.abs(inductance - of.inductance(CURRENTS)).max() < relative * np.abs(inductance).max()
    assert not evaluate(data, CURRENTS, PLACE + 1.0, TURN, linkages, inductance)
    assert np.isnan(linkages).all()
    assert np.isnan(inductance).all()
    with pytest.raises(ValueError, match="one current for each coil"):
        evaluate(data, CURRENTS[:5], PLACE, TURN, linkages, inductance)
    # The voltages of a motion follow from the slopes of the wrench, as the docstring says.
    velocity, spin = np.array([0.3, -0.1, 0.2]), np.array([1.0, 3.0, -2.0])
    slopes, (evaluate, data) = np.empty((6, 6)), compiled_wrench(of, SOFT)
    assert evaluate(data, CURRENTS, PLACE, TURN, np.empty(6), slopes)
    wanted = of.back_emf(PLACE, CURRENTS, SOFT, velocity, spin, TURN)
    found = slopes.T @ np.concatenate([velocity, spin])
    assert np.abs(found - wanted).max() < max(relative, 1e-10) * np.abs(wanted).max()


def test_compiled_linkages_need_those_of_the_map():
    with pytest.raises(InputError):
        compiled_linkages(interpolate(saturating_data(free=True)))
