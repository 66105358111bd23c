"""Disk with six cores, without closed form: checked by mesh refinement and the symmetry of the device."""

import numpy as np
import pytest

import fieldmap as fm

# Angle of each coil about the disk's axis (thesis, Fig. 6-4 and Appendix A-3).
ANGLE = {"5": 0, "6": 60, "3": 120, "2": 180, "1": 240, "4": 300}


def workspace_points():
    x = np.linspace(-0.02, 0.02, 5)
    z = np.linspace(-0.14, -0.076, 5)
    return np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)


@pytest.fixture(scope="module")
def coarse():
    return fm.solve_linear("disk_six_cores", refinement=0.5)


def test_last_two_meshes_agree():
    """Within 0.05 % of the largest flux density in the workspace, for one coil."""
    points = workspace_points()
    levels = [fm.solve_linear("disk_six_cores", refinement=refinement) for refinement in (1.2, 1.5)]
    coarse, fine = (level.unit_fields(points) for level in levels)
    one = levels[0].coil_names.index("5")
    assert levels[1].report.surface_faces > 1.35 * levels[0].report.surface_faces
    assert np.abs(fine[0][one] - coarse[0][one]).max() <= 5e-4 * np.abs(fine[0][one]).max()
    assert np.abs(fine[1][one] - coarse[1][one]).max() <= 1.5e-3 * np.abs(fine[1][one]).max()


def test_sixfold_symmetry(coarse):
    """The field of coil k, turned back by its angle, is the field of coil 5. Any mesh has exactly this symmetry, the
    windings only nearly: their squares are not turned with the cores."""
    points, solution = workspace_points(), coarse
    first = solution.unit_fields(points)[0][solution.coil_names.index("5")]
    for name, degrees in ANGLE.items():
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        field = solution.unit_fields(points @ turn.T)[0][solution.coil_names.index(name)]
        assert np.abs(field @ turn - first).max() < 1e-4 * np.abs(first).max()


def test_gradient_obeys_maxwell(coarse):
    gradient = coarse.unit_fields(workspace_points())[1]
    norm = np.linalg.norm(gradient, axis=(-2, -1))
    assert (np.abs(np.trace(gradient, axis1=-2, axis2=-1)) <= 1e-10 * norm).all()
    antisymmetric = np.linalg.norm(gradient - np.swapaxes(gradient, -1, -2), axis=(-2, -1))
    assert (antisymmetric <= 1e-10 * norm).all()


def test_gradient_is_the_derivative_of_the_field(coarse):
    """Taylor: the remainder falls with the square of the step."""
    currents = np.array([1.0, -0.5, 0.3, 0.0, 2.0, 0.7])
    x = np.array([[0.003, -0.007, -0.09]])
    slope = coarse.gradient(x, currents)[0]
    for axis in range(3):
        step = np.eye(3)[axis]
        remainder = [
            np.abs(
                coarse.field(x + h * step, currents) - coarse.field(x, currents) - h * slope[:, axis]
            ).max()
            for h in (4e-3, 2e-3, 1e-3)
        ]
        assert np.log2(remainder[0] / remainder[1]) > 1.8
        assert np.log2(remainder[1] / remainder[2]) > 1.8
