"""Derivatives of solved states by numbers of their device, against differences of whole solves."""

import copy
import gc
import pickle
from functools import cache

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.special import ellipe, ellipk

import fieldmap as fm
from fieldmap.errors import DeviceFileError, InputError
from fieldmap.iron import (
    DipoleForce,
    FieldFunction,
    FluxDensityAt,
    FluxLinkage,
    GradientAt,
    HysteresisSolver,
    NonlinearSolver,
    Pinning,
)
from fieldmap.iron.sensitivity.changes import Parameters
from fieldmap.iron.sensitivity.quantities import Derivatives, Quantity, Samples
from fieldmap.lookup.payload import magnetic_body
from fieldmap.sources import CoilSet
from tests.conftest import DEVICES

DEVICE = DEVICES / "core_and_magnet.toml"
COARSE = 0.5
COILS = ("around", "beside")
POINTS = np.array([[0.0, 0.001, -0.02], [0.01, 0.003, 0.033]])


def lowest_size(field):
    """A function that is not linear in the field."""
    return np.linalg.norm(field.field(POINTS), axis=1).min() + 1e-3 * field.gradient(POINTS[0])[2, 2] ** 2


def test_slopes_of_a_function_of_nothing():
    """At zero field no share of the largest value can be a step; the sine has the slope 1 there."""
    samples = Samples(np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros(1), ("coil",))

    class Sines(FluxDensityAt):
        uses = ("field", "gradient", "linkage")

        def of(self, at):
            return [np.sin(1e3 * at.field).sum(), np.sin(at.gradient).sum(), np.sin(1e3 * at.linkage).sum()]

    found = Quantity.weights(Sines(POINTS[:1]), samples)
    for part, row, slope in ((found.field, 0, 1e3), (found.gradient, 1, 1.0), (found.linkage, 2, 1e3)):
        assert np.ravel(part[row]) == pytest.approx(slope, rel=1e-6)
        assert np.abs(np.delete(part, row, axis=0)).max() < 1e-9


QUANTITIES = {
    "field": FluxDensityAt(POINTS),
    "gradient": GradientAt(POINTS[1]),
    "force": DipoleForce(POINTS[0], [0.0, 0.2, 1.0]),
    "function": FieldFunction(lowest_size),
}


def numbers(state):
    """The same quantities by the state's own methods."""
    gradient = state.gradient(POINTS[0])
    return {
        "field": state.field(POINTS),
        "gradient": state.gradient(POINTS[1]),
        "force": gradient.T @ [0.0, 0.2, 1.0],
        "function": np.asarray(lowest_size(state)),
    }


# The core is far in saturation, below saturation, or linear.
CASES = {"saturated": (60.0, 20.0), "unsaturated": (10.0, 4.0), "linear": (60.0, 20.0)}
# Key: step of the difference, and the value in the device file.
KEYS = {
    "current.around": (0.05, None),
    "current.*": (0.02, None),
    "coil.around.turns": (0.2, 200.0),
    "coil.beside.position_mm.1": (0.02, 18.0),
    "coil.beside.rotation_deg.2": (0.1, 20.0),
    "coil.around.position_mm.3": (0.01, 15.0),
    "coil.beside.inner_radius_mm": (0.01, 5.0),
    "material.iron.mu_r": (5.0, 2000.0),
    "material.iron.saturation_polarisation_T": (2e-3, 2.0),
    "material.steel.B_T.2": (2e-4, 0.06),
    "material.soft.mu_r": (0.3, 40.0),
    "material.magnet.remanence_T.1": (1e-3, 0.2),
    "material.magnet.mu_r": (1e-3, 1.05),
    "background.flux_density_mT.3": (0.02, 3.0),
}
ONLY_SATURATING = {"material.iron.saturation_polarisation_T", "material.steel.B_T.2"}


def solved(case, changes=None, currents=None):
    device = fm.read_device(DEVICE, changes or {})
    amperes = CASES[case] if currents is None else currents
    if case == "linear":
        return fm.solve_linear(device, tolerance=1e-6, symmetry="none", refinement=COARSE).at(amperes)
    return NonlinearSolver(device, COARSE, symmetry="none").solve(amperes, tolerance=1e-8)


@cache
def base(case):
    return solved(case)


def shifted(case, key, step):
    """The state with a key a step higher."""
    if key.startswith("current."):
        driven = np.array([key.removeprefix("current.") in (coil, "*") for coil in COILS])
        return solved(case, currents=np.array(CASES[case]) + step * driven)
    return solved(case, {key: KEYS[key][1] + step})


@cache
def found(case, name):
    keys = [key for key in KEYS if case != "linear" or key not in ONLY_SATURATING]
    return base(case).derivative(QUANTITIES[name], keys)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("key", KEYS)
def test_against_differences_of_whole_solves(case, key):
    """All quantities of the field agree within 1e-4 of the largest difference and the rounding of the solves."""
    if case == "linear" and key in ONLY_SATURATING:
        pytest.skip("linear iron has its initial permeability")
    step, _ = KEYS[key]
    ahead, behind = (numbers(shifted(case, key, side * step)) for side in (1, -1))
    for name in QUANTITIES:
        difference = (ahead[name] - behind[name]) / (2 * step)
        derivative = found(case, name)[key]
        assert derivative.shape == difference.shape
        # Rounding moves two solves by up to 1.2e-11 of their size (seen at mu_r of the soft body, saturated).
        size, noise = np.abs(difference).max(), 2e-11 * np.abs(ahead[name]).max() / step
        assert noise < 0.01 * size
        assert np.abs(derivative - difference).max() <= 1e-4 * size + noise, name


LOOPS = """
format = 1
name = "loops"
title = "coaxial loops"

[parameters]
wide = 30
"""
LOOP = """
[[coil]]
name = "{name}"
kind = "circular"
inner_radius_mm = "={radius} - 0.05"
outer_radius_mm = "={radius} + 0.05"
height_mm = 0.1
turns = {turns}
position_mm = [0, 0, {z}]
"""
# Radius (mm), turns, height (mm), current (A).
PLACES = {"a": (20.0, 10, 0.0, 3.0), "b": (30.0, 4, 8.0, -2.0), "c": (15.0, 7, -6.0, 5.0)}


def linkages(field, loops):
    """Flux linkages of thin coaxial loops in a uniform axial field: Maxwell's mutual inductance, Treatise, art. 701,
    and the self-inductance of a ring of square section with the geometric mean distance 0.4470 of its side."""
    loops = [(1e-3 * radius, turns, 1e-3 * z, current) for radius, turns, z, current in loops.values()]

    def mutual(one, other):
        (a, n, z, _), (b, m, w, _) = one, other
        if one == other:
            return mu_0 * n * n * a * (np.log(8 * a / (0.4470 * 1e-4)) - 2)
        k2 = 4 * a * b / ((a + b) ** 2 + (z - w) ** 2)
        return mu_0 * n * m * np.sqrt(a * b / k2) * ((2 - k2) * ellipk(k2) - 2 * ellipe(k2))

    return np.array(
        [
            sum(mutual(one, other) * other[3] for other in loops) + field * one[1] * np.pi * one[0] ** 2
            for one in loops
        ]
    )


@cache
def state_of_loops(text):
    return fm.solve_linear(fm.read_device(text)).at([current for *_, current in PLACES.values()])


@pytest.mark.parametrize(
    ("key", "changed"),
    [
        ("coil.b.position_mm.3", lambda x: {"b": (0, 0, x, 0)}),
        ("coil.*.position_mm.3", None),
        ("coil.c.turns", lambda x: {"c": (0, x, 0, 0)}),
        ("parameters.wide", lambda x: {"b": (x, 0, 0, 0)}),
        ("current.a", lambda x: {"a": (0, 0, 0, x)}),
        ("background.flux_density_mT.3", None),
    ],
)
def test_flux_linkages_of_loops_in_air(key, changed):
    """By a place, turns, a radius, a current and the background, against derivatives of the closed forms."""
    text = LOOPS + "[background]\nflux_density_mT = [0, 0, 2.5]\n"
    for name, (radius, turns, z, _) in PLACES.items():
        text += LOOP.format(name=name, radius="wide" if name == "b" else radius, turns=turns, z=z)
    if "*" in key:
        # All loops at one height move together, which changes nothing.
        for _, _, z, _ in PLACES.values():
            text = text.replace(f"[0, 0, {z}]", "[0, 0, 4]")
    alone = state_of_loops(text)
    derivative = alone.derivative(FluxLinkage(), [key])[key]
    step, sides = 1e-3, []
    for side in (step, -step):
        more = {} if changed is None else changed(side)
        loops = {name: tuple(np.add(PLACES[name], more.get(name, (0, 0, 0, 0)))) for name in PLACES}
        sides.append(linkages(1e-3 * (2.5 + (side if "background" in key else 0.0)), loops))
    expected = (sides[0] - sides[1]) / (2 * step)
    assert derivative == pytest.approx(expected, rel=2e-3, abs=2e-3 * np.abs(expected).max() + 1e-11)
    if "*" not in key:
        assert alone.flux_linkage() == pytest.approx(linkages(2.5e-3, PLACES), rel=1e-3)


def test_linkage_of_a_coil_that_moves_beside_iron_is_its_force():
    """For one coil and linear iron the energy is half of current times linkage. Its derivatives by place and angle at
    constant current are the force and torque of the field on the winding: within 0.4 % on this mesh, 2 to 3 % on a mesh
    of the device's own sizes."""
    bar = fm.Body("bar", "iron", fm.Box((8e-3, 10e-3, 30e-3)), 5e-3)
    place = fm.placed((4e-3, 14e-3, 36e-3), (20.0, 0.0, 0.0))
    coil = fm.CircularCoil("coil", 8e-3, 10e-3, 6e-3, 300, placement=place)
    device = fm.Device("bar", "", (coil,), (bar,), {"iron": fm.LinearMaterial("iron", 50.0)})
    state = fm.solve_linear(device, refinement=1.6).at([4.0])
    keys = [f"coil.coil.position_mm.{k}" for k in (1, 2, 3)]
    found = state.derivative(FluxLinkage("coil"), [*keys, "coil.coil.rotation_deg.1"])
    force = 0.5 * 4.0 * 1e3 * np.array([found[key] for key in keys])
    expected = state.force_on("coil")
    assert np.abs(force - expected).max() < 0.01 * np.abs(expected).max()
    assert np.linalg.norm(expected[:2]) > 0.1 * abs(expected[2])
    torque = 0.5 * 4.0 * np.degrees(1.0) * found["coil.coil.rotation_deg.1"]
    assert torque == pytest.approx(state.torque_on("coil", [4e-3, 14e-3, 36e-3])[0], rel=0.01)
    assert found.value == pytest.approx(state.flux_linkage()[0])


@pytest.mark.parametrize("key", ["coil.around.turns", "material.iron.saturation_polarisation_T"])
def test_flux_linkages(key):
    """In saturated iron. The linkage in air, which is not tested here, is known to 1e-4 only."""
    derivative = base("saturated").derivative(FluxLinkage(), [key])[key]
    step, _ = KEYS[key]
    ahead, behind = (shifted("saturated", key, side * step).flux_linkage() for side in (1, -1))
    difference = (ahead - behind) / (2 * step)
    assert np.abs(derivative - difference).max() <= 1e-4 * np.abs(difference).max()


@pytest.mark.parametrize("case", ["saturated", "linear"])
@pytest.mark.parametrize("key", ["current.around", "material.iron.mu_r", "coil.beside.position_mm.1"])
def test_taylor(case, key):
    """The remainder after the first order falls with the square of the step."""
    steps = {"current.around": 8.0, "material.iron.mu_r": 400.0, "coil.beside.position_mm.1": 1.0}[key]
    steps = steps * np.array([1.0, 0.5, 0.25])
    here = numbers(base(case))["force"]
    derivative = found(case, "force")[key]
    left = [np.linalg.norm(numbers(shifted(case, key, h))["force"] - here - h * derivative) for h in steps]
    if case == "linear" and key == "current.around":
        # A linear solution has no second order.
        assert max(left) < 1e-6 * np.linalg.norm(steps[0] * derivative)
        return
    slope = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all(np.abs(slope - 2) < 0.2), slope


def test_values_are_those_of_the_state_at_one_solve_for_each_number():
    for name, quantity in QUANTITIES.items():
        value = base("saturated").derivative(quantity, []).value
        np.testing.assert_allclose(value, numbers(base("saturated"))[name])
    assert [found("saturated", name).solves for name in ("force", "function")] == [3, 1]


def test_the_iron_matters_to_every_key():
    """Without the iron, by the coils alone, the derivatives differ by a hundredth at least."""
    device = fm.read_device(DEVICE).replace(bodies=(), materials={})
    alone = fm.solve_linear(device).at(CASES["saturated"])
    keys = [key for key in KEYS if key.startswith(("current", "coil", "background"))]
    bare = alone.derivative(QUANTITIES["field"], keys)
    assert bare.solves == 0
    for key in keys:
        whole = found("saturated", "field")[key]
        assert np.abs(whole - bare[key]).max() > 0.01 * np.abs(bare[key]).max(), key


def test_the_iron_of_another_solver_is_made_anew():
    """A state that was pickled, or whose solver is gone, gives the same derivatives."""
    state = solved("saturated")
    expected = found("saturated", "field")
    keys = ["current.around", "coil.around.turns", "material.iron.mu_r"]
    gc.collect()
    for other in (state, pickle.loads(pickle.dumps(state)), copy.deepcopy(state)):
        again = other.derivative(QUANTITIES["field"], keys)
        for key in keys:
            np.testing.assert_allclose(again[key], expected[key], rtol=1e-5, atol=1e-9)


def test_symmetric_meshes():
    """Meshes with and without the mirror planes of the iron; the displaced coil breaks one of the planes."""
    device = fm.read_device("loop_and_sphere")
    with_planes, without = (
        NonlinearSolver(device, 0.6, symmetry=symmetry).solve([1.5], tolerance=1e-7)
        for symmetry in ("auto", "none")
    )
    quantity, keys = FluxDensityAt([0.002, 0.001, -0.014]), ["current.loop", "coil.loop.position_mm.1"]
    one, other = (state.derivative(quantity, keys) for state in (with_planes, without))
    assert with_planes.mesh.symmetry is not None
    for key in keys:
        # Two meshes of one sphere: their fields differ by some 1e-3.
        np.testing.assert_allclose(one[key], other[key], rtol=0.02, atol=0.02 * np.abs(other[key]).max())


@pytest.mark.parametrize("name", ["eight_coils_bead", "drive_unit"])
def test_wrenches_on_payloads(name):
    """A soft bead, whose force goes with the square of the field, and a magnet of finite size, by the current of a coil
    in saturated iron: against the difference of two states' own wrenches."""
    body = magnetic_body(fm.read_device(name).payload)
    place, key = [0.004, 0.001, 0.07], "current.around"
    step, _ = KEYS[key]
    derivative = base("saturated").derivative(FieldFunction(lambda field: field.wrench(place, body)), [key])[
        key
    ]
    ahead, behind = (shifted("saturated", key, side * step).wrench(place, body) for side in (1, -1))
    difference = (ahead - behind) / (2 * step)
    assert np.abs(derivative - difference)[:3].max() <= 1e-4 * np.abs(difference[:3]).max()


def test_what_is_certain_has_no_spread():
    found = Derivatives(np.zeros(2), {"a": np.array([3.0, 0.0]), "b": np.array([4.0, 0.0])}, 0)
    spread = found.spread({"a": 1.0, "b": 1.0})
    assert spread.deviation.tolist() == [5.0, 0.0]
    assert [spread.shares[key].tolist() for key in "ab"] == [[9 / 25, 0.0], [16 / 25, 0.0]]
    assert found.spread({}).deviation.tolist() == [0.0, 0.0]
    assert found.change({"a": 2.0, "b": -1.0}).tolist() == [2.0, 0.0]


def test_change_sums_the_first_order():
    result = found("saturated", "force")
    expected = 0.5 * result["current.around"] - 2 * result["coil.beside.position_mm.1"]
    steps = {"current.around": 0.5, "coil.beside.position_mm.1": -2}
    np.testing.assert_allclose(result.change(steps), expected)


@pytest.mark.parametrize("key", ["current.none", "coil.*.turns", "coil.around.name", "coil.around.turn"])
def test_keys_that_cannot_be_followed(key):
    with pytest.raises(DeviceFileError if key.endswith("turn") else InputError) as caught:
        base("saturated").derivative(QUANTITIES["field"], [key])
    assert key.split(".")[-1] in str(caught.value)


def test_a_parameter_whose_expressions_are_written_out():
    """A device with included files has numbers in place of expressions: the key is refused, not taken as 0."""
    with pytest.raises(InputError) as caught:
        Parameters(fm.read_device("drive_unit")).change("parameters.disk")
    assert caught.value.problems[0].where == "derivative, parameters.disk"


def test_points_in_the_iron_and_names_of_no_coil():
    for quantity in (FluxDensityAt([0.0, 0.0, 0.01]), FluxLinkage("none")):
        with pytest.raises(InputError):
            base("saturated").derivative(quantity, ["current.around"])


def test_states_without_their_equations():
    device = fm.read_device("loop_and_sphere")
    solver = HysteresisSolver(device, Pinning(10.0), refinement=0.6)
    with_memory = solver.step([1.0], solver.demagnetised)
    surface = fm.solve_linear(device, form="surface", refinement=0.6).at([1.0])
    for state in (with_memory, surface):
        with pytest.raises(InputError):
            state.derivative(FluxDensityAt([0.0, 0.0, -0.014]), ["current.loop"])


def test_spread_against_whole_solves_with_random_numbers():
    """The standard deviation of the force to first order against 200 random machines, within three times the sampling
    error 1/sqrt(400). The coils are in a uniform background, which has no gradient and so no share."""
    device = fm.read_device(DEVICE).replace(bodies=(), materials={}).to_toml()
    deviations = {
        "coil.around.turns": 2.0,
        "coil.around.position_mm.3": 0.15,
        "coil.beside.position_mm.1": 0.2,
        "coil.beside.rotation_deg.2": 1.0,
        "background.flux_density_mT.3": 0.1,
    }
    quantity = DipoleForce([0.004, 0.001, 0.038], [0.0, 0.2, 1.0])
    found = fm.solve_linear(fm.read_device(device)).at(CASES["linear"]).derivative(quantity, list(deviations))
    told = found.spread(deviations)
    generator = np.random.default_rng(7)
    drawn = []
    for _ in range(200):
        values = {key: KEYS[key][1] + spread * generator.normal() for key, spread in deviations.items()}
        coils = CoilSet(fm.read_device(device, values).coils)
        drawn.append(coils.gradient(quantity.at, CASES["linear"]).T @ quantity.moment)
    assert np.std(drawn, axis=0) == pytest.approx(told.deviation, rel=3 / np.sqrt(400))
    assert sum(share for share in told.shares.values()) == pytest.approx(1.0)
    assert told.shares["background.flux_density_mT.3"].max() < 1e-9
