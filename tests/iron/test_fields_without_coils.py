"""Devices without a driven field: permanent magnets without coils, and iron without any source."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron.error import workspace_surface

SPACE = fm.WorkspaceBox(np.array([-0.005, -0.005, 0.025]), np.array([0.005, 0.005, 0.03]))
IRON = fm.LinearMaterial("iron", 1000.0)
MAGNET = fm.Body("magnet", "ndfeb", fm.Box((0.015, 0.015, 0.015)), mesh_size=0.006)
CUBE = fm.Body("cube", "iron", fm.Box((0.004, 0.004, 0.004)), mesh_size=0.002).moved([0.0, 0.0, 0.0155])
COIL = fm.CircularCoil("coil", 0.02, 0.03, 0.01, 100.0)


def machine(*bodies, coils=(), **materials):
    kinds = {"ndfeb": fm.PermanentMagnet("ndfeb", np.array([0.0, 0.0, 1.2]), 1.05), "iron": IRON} | materials
    used = {body.material: kinds[body.material] for body in bodies}
    return fm.Device("machine", "", coils, bodies, used, workspace=SPACE)


def largest(difference, whole):
    return float(np.linalg.norm(difference, axis=1).max() / np.linalg.norm(whole, axis=1).max())


@pytest.fixture(scope="module")
def points():
    return workspace_surface(machine(MAGNET))


def test_a_magnet_and_a_soft_cube_to_a_tolerance(points):
    """This once ended in a bare ValueError: the estimate took the largest field over an empty list of coils."""
    device = machine(MAGNET, CUBE)
    solution = fm.solve_to_tolerance(device, 0.01)
    error = solution.report.error
    finer = fm.solve_linear(device, refinement=2.0)
    exact = finer.field(points, [])
    assert 0.0 < error.flux_density <= 0.01
    assert largest(solution.field(points, []) - exact, exact) < 3 * error.flux_density
    assert error.both_forms.source == "the permanent magnets"
    assert solution.sources == ("the permanent magnets",)
    # C4v: the mirrors of square blocks that map the square workspace above them onto itself.
    assert solution.mesh.symmetry.group.order == 8


@pytest.mark.parametrize("tolerance", [0.02, 0.005])
def test_a_spherical_magnet_to_a_tolerance(points, tolerance):
    """At mu_r = 1 the ball is a dipole with mu0 m = remanence x volume. Dipoles in the workspace leave no charges on
    such a magnet, and the second mesh for the finer tolerance hardly differs from the first."""
    ball = fm.Body("ball", "ndfeb", fm.Sphere(0.01), mesh_size=0.008)
    device = machine(ball, ndfeb=fm.PermanentMagnet("ndfeb", np.array([0.0, 0.0, 1.2]), 1.0))
    solution = fm.solve_to_tolerance(device, tolerance)
    r = np.linalg.norm(points, axis=1)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    exact = 1.2 * 0.01**3 / 3 * (3 * points * points[:, 2:] / r**2 - up) / r**3
    error = largest(solution.field(points, []) - exact, exact)
    assert error < 2 * solution.report.error.flux_density < 2 * tolerance


def test_the_estimate_of_one_form_alone_sees_the_magnet():
    """With a flux barrier there is no second form: without a coil the estimate was once 0 on every mesh."""
    barrier = fm.Body("barrier", "shield", CUBE.parts, mesh_size=0.002)
    solution = fm.solve_to_tolerance(machine(MAGNET, barrier, shield=fm.FluxBarrier("shield")), 0.02)
    assert 1e-5 < solution.report.error.flux_density <= 0.02


def test_the_magnet_counts_beside_a_coil(points):
    """Both fields are within what the estimate says, and within 0.2 %, each relative to its own largest."""
    device = machine(MAGNET, CUBE, coils=(COIL,))
    solution, finer = fm.solve_to_tolerance(device, 0.02), fm.solve_linear(device, refinement=2.0)
    assert solution.sources == ("1 A in coil 'coil'", "the permanent magnets")
    exact = finer.source_fields(points)[0]
    error = solution.source_fields(points)[0] - exact
    for k in range(2):
        assert largest(error[k], exact[k]) < min(2e-3, solution.report.error.flux_density)
    assert solution.source_fields(points)[1][1] == pytest.approx(solution.constant_fields(points)[1])


@pytest.mark.parametrize("solve", [fm.solve_linear, fm.solve_to_tolerance])
def test_iron_that_nothing_magnetises_is_refused(solve):
    with pytest.raises(InputError) as caught:
        solve(machine(CUBE))
    assert caught.value.problems[0].where == "device 'machine'"
