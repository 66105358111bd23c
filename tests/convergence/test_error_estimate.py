"""The estimated error is honest: the true one is at most three times as large, on every case with a known truth."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import WorkspaceBox, WorkspaceCylinder
from fieldmap.errors import InputError, NotConverged
from fieldmap.iron.error_estimate import estimate_error, workspace_surface
from fieldmap.iron.operators import assembled

_SPEC = importlib.util.spec_from_file_location(
    "axisymmetric", Path(__file__).with_name("test_axisymmetric_iron.py")
)
axisymmetric = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(axisymmetric)
SPACE = WorkspaceBox(np.array([-0.02, -0.02, -0.11]), np.array([0.02, 0.02, -0.07]))


def true_error(solution, case, mu_r):
    """Largest error of B and of the gradient's z column over the largest reference value, in the workspace."""
    points, exact = axisymmetric.reference(case, mu_r)
    inside = points[:, 0] <= 0.02
    points, exact = points[inside], exact[inside]
    b, g = solution.unit_fields(points)
    field = np.hypot(b[0, :, 2] - exact[:, 0], b[0, :, 0] - exact[:, 1]).max()
    slope = np.hypot(g[0, :, 2, 2] - exact[:, 2], g[0, :, 0, 2] - exact[:, 3]).max()
    return field / np.hypot(*exact[:, :2].T).max(), slope / np.hypot(*exact[:, 2:].T).max()


@pytest.mark.parametrize(
    ("case", "mu_r"),
    [("disk", 1000), ("diskcore", 1000), ("diskcore", 4000), ("spool", 1000), ("spool", 4000)],
)
def test_estimate_is_honest(case, mu_r):
    device = axisymmetric.device(case, core_size=0.004, edge=0.0015)
    fine, coarse = (fm.solve_linear(device, mu_r=float(mu_r), refinement=r) for r in (1.0, 0.7))
    other = fm.solve_linear(device, mu_r=float(mu_r), form="flux")
    points = workspace_surface(replace(device, workspace=SPACE))
    estimate = estimate_error(points, fine, coarse, other)
    field, gradient = true_error(fine, case, mu_r)
    assert field < 3 * estimate.flux_density
    assert gradient < 3 * estimate.gradient
    # An estimate that is always huge would be honest too.
    assert estimate.flux_density < 0.02


def test_solve_to_tolerance_keeps_its_word():
    device = replace(axisymmetric.device("diskcore", core_size=0.004, edge=0.0015), workspace=SPACE)
    loose = fm.solve_to_tolerance(device, 5e-3, mu_r=1000.0)
    tight = fm.solve_to_tolerance(device, 1.5e-3, mu_r=1000.0)
    for tolerance, solution in ((5e-3, loose), (1.5e-3, tight)):
        assert solution.report.error.flux_density <= tolerance
        assert true_error(solution, "diskcore", 1000)[0] < tolerance
        assert "estimated error" in str(solution.report.error)
    assert tight.report.surface_faces >= loose.report.surface_faces


def test_too_fine_for_the_memory_is_said_before_it_happens(monkeypatch):
    device = replace(axisymmetric.device("diskcore", core_size=0.004, edge=0.0015), workspace=SPACE)
    monkeypatch.setattr(assembled, "_memory_bytes", lambda: 20e6)
    with pytest.raises(InputError, match=r"must fit into 0\.0 GB of memory"):
        fm.solve_linear(device)
    with pytest.raises(NotConverged, match="estimated error must fall to 1e-05"):
        fm.solve_to_tolerance(device, 1e-5)


def test_points_lie_on_the_surface_of_the_workspace():
    device = axisymmetric.device("disk")
    for space in (SPACE, WorkspaceCylinder(np.array([0.0, 0.0, -0.11]), 0.02, 0.04)):
        points = workspace_surface(replace(device, workspace=space))
        on_face = np.isclose(np.abs(points[:, :2]), 0.02).any(axis=1) | np.isclose(
            np.abs(points[:, 2] + 0.09), 0.02
        )
        assert on_face.all()
        assert len(points) == 98


def test_a_workspace_is_needed():
    with pytest.raises(InputError, match="must have a workspace"):
        fm.solve_to_tolerance(axisymmetric.device("disk"))
