"""On a symmetric mesh fields are symmetric to the accuracy of the solve, and equal to fields on other meshes."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Body, Box, CircularCoil, Device, LinearMaterial, Part, Placement
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.symmetry import find_symmetry
from tests.iron.shared import STEEL

POINTS = np.random.default_rng(3).uniform([-0.03, -0.03, -0.05], [0.03, 0.03, -0.01], (25, 3))


def yoked(material):
    """A bar with two posts and two coils: mirrors x = 0 and y = 0."""
    bodies = [Body("bar", "iron", (Part(Box((0.06, 0.02, 0.01)), Placement(np.array([0, 0, 0.03]))),), 0.012)]
    coils = []
    for name, x in (("left", -0.02), ("right", 0.02)):
        place = Placement(np.array([x, 0.0, 0.0]))
        bodies.append(Body(name, "iron", (Part(Box((0.012, 0.012, 0.03)), place),), 0.01))
        middle = Placement(np.array([x, 0.0, 0.012]))
        coils.append(CircularCoil(name, 0.0095, 0.015, 0.02, 500, placement=middle))
    return Device("yoked", "", tuple(coils), tuple(bodies), {"iron": material})


def mirrors_and_blocks(solution):
    """The mirror planes and the number of matrix blocks in the report."""
    found, used = solution.report.symmetry.split("used: ")
    return re.findall(r"\w = \d+", found), int(used.split()[0])


def asymmetry(device, field, currents):
    """Largest difference between the field at images of points and the image of the field, relative."""
    worst = 0.0
    for operation in find_symmetry(device).operations:
        moved = np.zeros(len(currents))
        for k, image in enumerate(operation.coils):
            moved[image] = operation.coil_signs[k] * currents[k]
        before = operation.handedness * field(POINTS, currents) @ operation.matrix.T
        after = field(operation(POINTS), moved)
        worst = max(worst, np.abs(after - before).max() / np.abs(before).max())
    return worst


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_linear_iron(form):
    device = yoked(LinearMaterial("iron", 1000.0))
    assert str(find_symmetry(device)) == "mirrors x = 0, y = 0"
    solutions = {
        word: fm.solve_linear(device, tolerance=1e-8, form=form, symmetry=word) for word in ("auto", "none")
    }
    currents = np.array([1.0, 0.3])
    # The symmetry is not exact to rounding: rules inside tetrahedra differ for mirror images (flux form), and a factor
    # is regularised (potential form). Measured 2e-8 and 2e-9.
    assert asymmetry(device, solutions["auto"].field, currents) < 1e-7
    assert asymmetry(device, solutions["none"].field, currents) > 1e-4
    ours, other = (solutions[word].field(POINTS, currents) for word in ("auto", "none"))
    assert np.abs(ours - other).max() < 0.02 * np.abs(other).max()
    assert mirrors_and_blocks(solutions["auto"]) == (["x = 0", "y = 0"], 4)
    assert solutions["none"].report.symmetry == "none"
    ratio = solutions["auto"].report.surface_faces / solutions["none"].report.surface_faces
    expected = solutions["none"].report.matrix_bytes * ratio**2 / 4
    assert solutions["auto"].report.matrix_bytes == pytest.approx(expected, rel=1e-6)


def test_saturating_iron_at_currents_without_symmetry():
    device = yoked(STEEL)
    solvers = {word: NonlinearSolver(device, symmetry=word) for word in ("auto", "none")}

    @cache
    def state(word, *currents):
        return solvers[word].solve(currents, tolerance=1e-7)

    def field(points, currents, word="auto"):
        return state(word, *currents).field(points)

    currents = np.array([9.0, -2.0])
    assert asymmetry(device, field, currents) < 1e-8
    other = field(POINTS, currents, "none")
    assert np.abs(field(POINTS, currents) - other).max() < 0.02 * np.abs(other).max()
    assert state("auto", *currents).report.largest_flux_density > 1.5


def test_a_body_out_of_place_takes_the_symmetry_away():
    device = yoked(LinearMaterial("iron", 1000.0))
    bodies = device.bodies[0], device.bodies[1].moved([1e-4, 0.0, 0.0]), device.bodies[2]
    solution = fm.solve_linear(replace(device, bodies=bodies), symmetry="auto")
    assert mirrors_and_blocks(solution) == (["y = 0"], 2)
