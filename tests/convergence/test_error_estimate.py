"""The estimated error is honest: the true error is at most three times as large in every case with a known solution."""

import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Body, Device, LinearMaterial, Part, Sphere, WorkspaceBox, WorkspaceCylinder
from fieldmap.errors import InputError, ToleranceNotReached
from fieldmap.iron import NonlinearSolver, generate_mesh
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.error import Tolerance, estimate_error, workspace_surface
from fieldmap.iron.materials import body_properties
from fieldmap.iron.operators import assembled
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.report import Stages
from fieldmap.iron.solvers.to_tolerance import Level


def neighbour(name):
    """A test file of this folder, as a module."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


axisymmetric = neighbour("test_axisymmetric_iron")
saturated = neighbour("test_axisymmetric_saturated")
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


@pytest.mark.parametrize(("case", "mu_r"), [("disk", 1000), ("diskcore", 4000), ("spool", 4000)])
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


@pytest.mark.parametrize(
    ("case", "mu_r", "refinement"), [("disk", 1000, 0.8), ("diskcore", 4000, 0.8), ("spool", 4000, 0.6)]
)
def test_shares_of_the_faces_are_honest(case, mu_r, refinement):
    """Estimates from one mesh: the error of constant charges, weighted by their effect on dipoles in the workspace."""
    device = replace(axisymmetric.device(case, core_size=0.004, edge=0.0015), workspace=SPACE)
    iron, properties = assemble(generate_mesh(device, refinement)), body_properties(device, float(mu_r))
    level = Level.solved(
        device, iron, properties, workspace_surface(device), 1e-3, Stages(None), Tolerance(1e-3)
    )
    field, _ = true_error(level.solution, case, mu_r)
    assert field < 3 * level.face_shares.total < 45 * field


@dataclass(frozen=True)
class InUniformField:
    """A body in a field of 1 T along z, with the interface that the estimate needs."""

    state: IronState
    sources: tuple[str, ...] = ("the applied field",)

    @property
    def iron_points(self):
        return self.state.faces.centres

    def source_fields(self, points):
        b, g = self.state.faces.field_and_gradient(points, self.state.density)
        return b + [0.0, 0.0, 1.0], g

    @classmethod
    def solved(cls, form, parts, size, mu_r):
        body = Body("ball", "iron", parts, size)
        problem = form(
            assemble(generate_mesh(Device("d", "", (), (body,), {"iron": LinearMaterial("iron", 1.0)})))
        )
        count = len(problem.elements.volume)
        laws = law_tables([LinearMaterial("iron", mu_r)])
        material = Magnetisation(np.zeros(count, np.int64), laws, np.zeros((1, count, 3)))
        field = problem.elements.coil_field(lambda x: np.broadcast_to([0.0, 0.0, 1.0], (1, *x.shape)))
        return cls(problem.solve_linear(material, field, 1e-8).iron)


def dipole_field(points):
    """B of a sphere of radius 50 mm and mu_r 1000 in 1 T, applied field included (Jackson 5.11)."""
    r = np.linalg.norm(points, axis=1)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    return up + 999 / 1002 * (0.05 / r) ** 3 * (3 * points * points[:, 2:] / r**2 - up)


def field_in_shell(points):
    """B inside a hollow shell of mu_r 1000, radii 40 and 50 mm (Jackson 5.121)."""
    mu, ratio = 1000.0, 0.8
    inside = 9 * mu / ((2 * mu + 1) * (mu + 2) - 2 * ratio**3 * (mu - 1) ** 2)
    return np.outer(np.ones(len(points)), [0.0, 0.0, inside])


@pytest.mark.parametrize(
    ("parts", "lower", "upper", "exact"),
    [
        ((Part(Sphere(0.05)),), [-0.03, -0.03, -0.1], [0.03, 0.03, -0.06], dipole_field),
        ((Part(Sphere(0.05)), Part(Sphere(0.04), operation="cut")), [-0.02] * 3, [0.02] * 3, field_in_shell),
    ],
)
def test_estimate_is_honest_for_sphere_and_shell(parts, lower, upper, exact):
    space = WorkspaceBox(np.array(lower), np.array(upper))
    points = workspace_surface(replace(axisymmetric.device("disk"), workspace=space))
    fine, coarse = (InUniformField.solved(PotentialForm, parts, size, 1000.0) for size in (0.012, 0.017))
    other = InUniformField.solved(FluxForm, parts, 0.012, 1000.0)
    estimate = estimate_error(points, fine, coarse, other)
    error = np.linalg.norm(fine.source_fields(points)[0][0] - exact(points), axis=1).max()
    error /= np.linalg.norm(exact(points), axis=1).max()
    assert error < 3 * estimate.flux_density
    assert estimate.flux_density < 20 * error


def test_the_truth_may_lie_outside_of_both_forms():
    """Both forms have the same flat faces and charges: on a ball they agree to 1e-7, and are both off by over 1e-4."""
    points = np.array([[0.0, 0.0, -0.09], [0.0, 0.0, -0.07]])
    ball = (Part(Sphere(0.05)),)
    one, other, coarse = (
        InUniformField.solved(form, ball, size, 1000.0)
        for form, size in ((PotentialForm, 0.025), (FluxForm, 0.025), (PotentialForm, 0.04))
    )
    estimate = estimate_error(points, one, coarse, other)
    forms = estimate.both_forms
    assert forms.what == "Bz"
    truth = dipole_field(np.array([forms.at]))[0, 2]
    off = abs(np.array([forms.solution, forms.complement]) - truth)
    assert off.min() > 100 * abs(forms.solution - forms.complement)
    assert off.max() < estimate.flux_density * truth


def test_forms_bracket_the_inductance_and_close_in():
    """The potential form stores too much energy, the flux form too little; the gap falls with the mesh."""
    gaps = []
    for size, edge in ((0.008, 0.004), (0.0055, 0.002)):
        device = axisymmetric.device("spool", core_size=size, edge=edge)
        high, low = (fm.solve_linear(device, form=form).inductance()[0, 0] for form in ("potential", "flux"))
        gaps.append(high / low - 1)
    assert 0 < 1.5 * gaps[1] < gaps[0] < 5e-3


def test_estimate_of_a_saturated_state_is_honest():
    """2.5 T in the core: both forms by Newton's method, and a coarser mesh."""
    solver = NonlinearSolver(Device.unchecked(**{**vars(saturated.device(0.005, 0.002)), "workspace": SPACE}))
    state = solver.solve([15.0])
    estimate = solver.estimate_error(state)
    points, exact = saturated.reference(12600)
    inside = points[:, 0] <= 0.02
    points, exact = points[inside], exact[inside]
    field, gradient = state.field(points), state.gradient(points)
    error = (
        np.hypot(field[:, 2] - exact[:, 0], field[:, 0] - exact[:, 1]).max() / np.hypot(*exact[:, :2].T).max()
    )
    slope = np.abs(gradient[:, 2, 2] - exact[:, 2]).max() / np.abs(exact[:, 2]).max()
    assert error < 3 * estimate.flux_density
    assert slope < 3 * estimate.gradient
    assert estimate.flux_density < 0.01
    assert estimate.gap[0] < 1e-3
    middle = estimate.both_forms
    # The same field, summed in another order.
    assert middle.solution == pytest.approx(state.field(np.array(middle.at))[2], rel=1e-12)


def test_solve_states_its_estimate_on_request():
    device = fm.read_device("loop_and_sphere")
    state = fm.solve(device, [1.0], estimate=True)
    error = state.report.error
    known = device.references[0]
    assert known.quantity == "Bz"
    assert abs(state.field(known.at)[2] / known.currents[0] / known.value - 1) < 3 * error.flux_density
    assert "Bz" in str(error)
    assert fm.solve(device, [1.0]).report.error is None


def test_solve_to_tolerance_keeps_its_word():
    device = replace(axisymmetric.device("diskcore", core_size=0.004, edge=0.0015), workspace=SPACE)
    loose = fm.solve_to_tolerance(device, 5e-3, mu_r=1000.0)
    tight = fm.solve_to_tolerance(device, 6e-4, mu_r=1000.0)
    for tolerance, solution in ((5e-3, loose), (6e-4, tight)):
        assert solution.report.error.flux_density <= tolerance
        assert true_error(solution, "diskcore", 1000)[0] < tolerance
        assert f"{100 * solution.report.error.flux_density:.2g} %" in str(solution.report.error)
    assert tight.report.surface_faces >= loose.report.surface_faces


def test_too_fine_for_the_memory_is_said_before_it_happens(monkeypatch):
    device = fm.read_device("sphere_in_field", {"body.sphere.mesh_size_mm": 4.0})
    monkeypatch.setattr(assembled, "memory_bytes", lambda: 2e5)
    with pytest.raises(InputError) as caught:
        fm.solve_linear(device, refinement=2.0)
    assert "memory" in caught.value.problems[0].must_hold
    with pytest.raises(ToleranceNotReached) as caught:
        fm.solve_to_tolerance(device, 1e-5)
    report = caught.value.report
    assert report.ended == "memory"
    assert report.asked.flux_density == 1e-5
    # The mesh that was made but not solved would have needed more memory than available.
    assert report.next_mesh.faces > report.steps[-1].faces
    assert report.next_mesh.matrix_bytes > 2e5


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
    with pytest.raises(InputError) as caught:
        fm.solve_to_tolerance(axisymmetric.device("disk"))
    assert "[workspace]" in caught.value.problems[0].remedy
