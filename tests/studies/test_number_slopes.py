"""Exact derivatives of a study's numbers against central differences of whole solves."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.iron.sensitivity.quantities import Samples
from fieldmap.studies import Carrying, Linked, Number, Variable
from fieldmap.studies.design import Search
from fieldmap.studies.design_checks import design_problem
from fieldmap.studies.number_slopes import _Inhomogeneities
from fieldmap.studies.search import Asked, evaluate
from tests.conftest import DEVICES

PAYLOAD = """
[payload]
mass_g = 10.0
moment_A_m2 = 0.3

[parameters]
side = 1.0
"""
SIDE = 'position_mm = ["= side", 0.5, 25.0]'
DEVICE = (DEVICES / "sphere_below_loop.toml").read_text().replace(
    "position_mm = [0.0, 0.0, 25.0]", SIDE
) + PAYLOAD
# The element size grows with the sphere, so the mesh keeps its topology.
VARIABLES = {
    "coil.loop.turns": (100.0, 0.2),
    "coil.loop.position_mm.3": (25.0, 0.1),
    "parameters.side": (1.0, 0.1),
    "coil.loop.outer_radius_mm": (30.5, 2e-2),
    "material.iron.mu_r": (1000.0, 10.0),
    "body.sphere.radius_mm": (10.0, 5e-2),
}
LINKED = {"body.sphere.radius_mm": (Linked(("body.sphere.mesh_size_mm",), 0.4),)}
NUMBERS = (
    *("common_current", "current loop", "power", "flux_density 1 x", "flux_density 1 z", "gradient 1 z z"),
    *("force_per_ampere 1 z", "inhomogeneity", "largest_inhomogeneity", "inductance loop loop"),
    *("equilibrium_x", "equilibrium_y", "equilibrium_z", "stiffness_x", "stiffness_z", "equilibrium_area"),
)
POINTS = [[0.002, 0.001, -0.016]]
BOX = ([0.0, 0.0, -0.02], [0.004, 0.004, -0.016])


def problem(currents, saturating, variables, numbers=NUMBERS):
    made = (
        Variable(key, 0.98 * value, 1.02 * value, value, LINKED.get(key, ()))
        for key, (value, _) in variables.items()
    )
    first = Number("common_current", next(iter(currents)) if isinstance(currents, dict) else "")
    search = Search(objective=first, sign=1.0, variables=tuple(made))
    found = design_problem("optimise", search, DEVICE, currents, saturating, 1.0, POINTS, BOX, 0.005)
    asked = tuple(Number(name, entry.name) for name in numbers for entry in found.current_sets)
    return replace(found, iron=replace(found.iron, tolerance=1e-6), objective=asked[0], besides=asked[1:])


# Derivatives and differences are of the same mesh, a coarse one.
MESH = 0.35


def values_at(made, changes=None):
    return made.values(made.named(made.starts) | (changes or {}))


def slope(made, key, step):
    """Difference quotient of two solved designs."""
    start = made.named(made.starts)[key]
    ahead, behind = (evaluate(made, Asked(values_at(made, {key: start + s * step}), MESH)) for s in (1, -1))
    assert (ahead.failure, behind.failure) == ("", "")
    return {name: (ahead.numbers[name] - behind.numbers[name]) / (2 * step) for name in ahead.numbers}


def compare(made, steps):
    """Check every exact derivative to a bound relative to its size, or for numbers that hardly change to a thousandth
    of a proportional change; return the numbers with exact derivatives."""
    found = evaluate(made, Asked(values_at(made), MESH, made.keys))
    assert found.solved, found.failure
    assert not found.refused
    for key, (value, step) in steps.items():
        wanted = slope(made, key, step)
        for label, by in found.slopes.items():
            size = max(abs(wanted[label]), 1e-3 * abs(found.numbers[label] / value))
            bound = bound_of(label, key, made.iron.saturating)
            assert by[key] == pytest.approx(wanted[label], abs=bound * size), (label, key)
    return set(found.slopes)


def bound_of(label, key, saturating):
    """Accuracy of the differences: lift currents of saturating iron are solved to 1e-4, equilibria that hardly move
    to some nm, and a larger sphere has a slightly different mesh."""
    if saturating and key == "material.iron.mu_r":
        return 2e-2
    if label.startswith(("equilibrium", "stiffness")):
        return 3e-2 if "body" in key or label.startswith("equilibrium_area") else 5e-3
    return 4e-3 if saturating else 1e-3


def test_of_linear_iron_that_carries():
    made = problem(Carrying([0.001, 0.0005, -0.018]), False, VARIABLES)
    assert compare(made, VARIABLES) == {number.label for number in made.numbers}


def test_of_saturating_iron_with_currents_given():
    """Except numbers defined for linear iron alone."""
    keys = ("coil.loop.position_mm.3", "material.iron.mu_r", "body.sphere.radius_mm")
    steps = {key: VARIABLES[key] for key in keys}
    made = problem({"given": 1.5}, True, steps)
    missing = {"force_per_ampere 1 z, given", "inductance loop loop, given"}
    assert compare(made, steps) == {number.label for number in made.numbers} - missing


def test_of_a_current_and_of_a_difference_of_two_sets():
    """A current acts in the set where currents are given, and not in the set that carries the payload."""
    sets = {"given": 1.5, "carries": Carrying([0.001, 0.0005, -0.018])}
    made = problem(sets, False, {"parameters.side": VARIABLES["parameters.side"]}, ("equilibrium_z", "power"))
    current = Variable("current.loop", 1.0, 2.0, 1.5)
    shift = Number("equilibrium_z", "given", minus="carries")
    made = replace(made, variables=(*made.variables, current), besides=(*made.besides, shift))
    steps = {"current.loop": (1.5, 0.01), "parameters.side": (1.0, 0.1)}
    assert compare(made, steps) == {number.label for number in made.numbers}
    slopes = evaluate(made, Asked(values_at(made), MESH, made.keys)).slopes
    by_current = {label: by["current.loop"] for label, by in slopes.items()}
    assert by_current["power, carries"] == 0.0
    assert by_current["equilibrium_z, given - carries"] == by_current["equilibrium_z, given"]


def test_what_changes_otherwise_is_left_to_differences():
    """The payload, a shape that the mesh cannot follow, and a Python function."""
    made = problem(1.0, False, {"payload.mass_g": (10.0, 0.1), "coil.loop.turns": (100.0, 1.0)}, ("power",))
    own = Number("mine", "", of=lambda device, state: float(state.currents[0]))
    made = replace(made, besides=(own,))
    found = evaluate(made, Asked(values_at(made), MESH, made.keys))
    assert (list(found.refused), found.numbers["mine"]) == (["payload.mass_g"], 1.0)
    assert {label: list(by) for label, by in found.slopes.items()} == {"power": ["coil.loop.turns"]}


PAIR = (DEVICES / "pair.toml").read_text().replace("turns = 100\n", "turns = 100\nresistance_ohm = 2.0\n") + (
    "\n[payload]\nmass_g = 12.0\nmoment_A_m2 = 0.5\n"
)
OF_PAIR = (
    *("common_current", "current upper", "current lower", "power", "inhomogeneity", "largest_inhomogeneity"),
    *(f"flux_density {k} {i}" for k in (1, 2) for i in "xyz"),
    *("gradient 1 x y", "gradient 2 z x", "gradient 2 y z", "gradient 1 z z"),
    *("force_per_ampere 1 x", "force_per_ampere 2 y", "force_per_ampere 2 z"),
    "inductance upper lower",
)
OF_PAIR_VARIED = {
    "current.upper": (3.0, 0.01),
    "coil.lower.turns": (200.0, 0.5),
    "coil.upper.outer_radius_mm": (30.0, 0.02),
    "coil.upper.position_mm.1": (1.0, 0.05),
    "coil.lower.height_mm": (12.0, 0.02),
}


def paired(text=PAIR, numbers=OF_PAIR):
    """Two coils with unequal currents of both signs, given, and carrying at a place off the axis."""
    text = text.replace("position_mm = [0.0, 0.0, 40.0]", "position_mm = [1.0, 0.0, 40.0]")
    variables = tuple(Variable(key, 0.9 * v, 1.1 * v, v) for key, (v, _) in OF_PAIR_VARIED.items())
    search = Search(objective=Number("common_current", "given"), sign=1.0, variables=variables)
    sets = {"given": [3.0, -1.0], "carries": Carrying([0.002, 0.003, 0.004], [2.0, -1.0])}
    points, box = (
        [[0.001, 0.002, -0.003], [-0.004, 0.003, 0.005]],
        ([-0.003, -0.002, -0.001], [0.002, 0.004, 0.003]),
    )
    made = design_problem("optimise", search, text, sets, False, 1.0, points, box, 0.01)
    return replace(made, besides=tuple(Number(name, entry) for name in numbers for entry in sets))


def test_of_two_coils_without_iron():
    """Every entry of each number, by currents, turns, shapes and positions."""
    made = paired()
    assert compare(made, OF_PAIR_VARIED) == {number.label for number in made.numbers}


def test_of_a_payload_of_pieces():
    """Numbers that depend on its forces use differences; fields and given currents have exact derivatives."""
    pieces = '[payload]\nmass_g = 12.0\n[[payload.piece]]\nshape = "sphere"\ndiameter_mm = 5.0\nremanence_T = 1.2\n'
    pieces += (
        '[[payload.piece]]\nshape = "soft_sphere"\ndiameter_mm = 4.0\nmu_r = 99\nposition_mm = [0, 0, 6]\n'
    )
    made = paired(PAIR.split("[payload]")[0] + pieces, ("power", "flux_density 1 z", "force_per_ampere 1 z"))
    found = evaluate(made, Asked(values_at(made), MESH, made.keys))
    assert found.solved, found.failure
    assert set(found.slopes) == {f"{name}, given" for name in ("common_current", "power", "flux_density 1 z")}


def test_a_field_that_is_the_same_everywhere_has_no_slopes_of_its_homogeneity():
    field = np.tile([0.125, 0.25, 0.5], (8, 1))
    samples = Samples(field, np.zeros((8, 3, 3)), np.zeros(2), ("a", "b"))
    homogeneity = _Inhomogeneities(np.zeros((8, 3)))
    assert homogeneity.of(samples).tolist() == [0.0, 0.0]
    found = homogeneity.weights(samples)
    assert (found.field.shape, found.gradient.shape, found.linkage.shape) == ((2, 8, 3), (2, 8, 3, 3), (2, 2))
    assert not any(part.any() for part in (found.field, found.gradient, found.linkage))
    # In other fields the weights are its derivatives.
    field = np.random.default_rng(0).normal(size=(8, 3))
    exact = homogeneity.weights(replace(samples, field=field)).field
    step = 1e-6
    for at in np.ndindex(8, 3):
        ahead, behind = field.copy(), field.copy()
        ahead[at] += step
        behind[at] -= step
        sides = [homogeneity.of(replace(samples, field=one)) for one in (ahead, behind)]
        assert exact[(slice(None), *at)] == pytest.approx((sides[0] - sides[1]) / (2 * step), abs=1e-7)
