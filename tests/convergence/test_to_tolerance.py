"""Runs to a tolerance end within it, against known solutions, or say where the error is and the cost of reducing it."""

import pickle
from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError, ToleranceNotReached
from fieldmap.iron import Tolerance, generate_mesh
from fieldmap.iron.error import (
    ErrorEstimate,
    LargestError,
    MeshStep,
    estimate_error,
    expected_cost,
    faces_within,
    gradient_length,
    workspace_surface,
)
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesher import LocalSizes
from fieldmap.iron.report import Stages
from fieldmap.iron.solvers import to_tolerance
from fieldmap.iron.solvers.refinement import near_kernels, next_sizes

UP = np.array([0.0, 0.0, 1.0])
IRON = {"iron": fm.LinearMaterial("iron", 1000.0)}


def cube_at_an_edge():
    """The workspace is 0.1 mm from an edge of one cube, and far from the other cube."""
    bodies = [
        fm.Body(name, "iron", (fm.Part(fm.Box((0.02,) * 3), fm.placed((x, 0, -0.02))),), 5e-3)
        for name, x in (("near", 0.0), ("far", 0.08))
    ]
    space = fm.WorkspaceBox([1.01e-2, -2e-3, -1e-3], [1.3e-2, 2e-3, 3e-3])
    return fm.Device("cubes", "", (), bodies, IRON, background=fm.Background(1e-2 * UP), workspace=space)


def shell(factor=1.0, size=4e-3):
    parts = (fm.Part(fm.Sphere(0.02)), fm.Part(fm.Sphere(0.016), operation="cut"))
    return fm.Device(
        "shell",
        "",
        (),
        [fm.Body("shell", "iron", parts, size)],
        IRON,
        background=fm.Background(factor * 1e-3 * UP),
        workspace=fm.WorkspaceBox([-6e-3] * 3, [6e-3] * 3),
    )


INSIDE = 9 * 1000.0 / (2001 * 1002 - 2 * 0.8**3 * 999**2) * 1e-3
"""T, in the shell (Jackson 5.121)."""


@pytest.fixture(scope="module")
def shielded():
    return fm.solve_to_tolerance(shell(size=8e-3), 0.01)


def test_a_shielded_uniform_field_ends_within_the_tolerance(shielded):
    """The exact gradient is zero, so no mesh would do for an error relative to its own largest value."""
    b, g = shielded.source_fields(workspace_surface(shell()))
    error = shielded.report.error
    assert np.abs(b[0] - INSIDE * UP).max() < 0.01 * INSIDE
    # L is the distance of the wall, because half the diagonal is only 10.4 mm.
    assert error.length == pytest.approx(0.016, rel=0.02)
    size = error.worst("gradient").size
    assert size == pytest.approx(INSIDE / 0.016, rel=0.02)
    assert np.linalg.norm(g[0], axis=(1, 2)).max() < 0.03 * size
    assert error.gradient <= 0.03
    assert shielded.report.tolerance.reached
    assert len(shielded.report.tolerance.steps) <= 4
    # Only one of the mirrors of ball and box is used: meshes with several mirrors on a sphere are poor.
    assert shielded.mesh.symmetry.group.order == 2


def test_an_absolute_tolerance_is_enough_where_hardly_any_field_is_left():
    """A tenth of the inside field, in T: the first comparison of two meshes is within it."""
    asked = Tolerance(absolute_flux_density=0.1 * INSIDE)
    solution = fm.solve_to_tolerance(shell(), asked)
    error = solution.report.error.worst("B")
    assert error.error <= 0.1 * INSIDE
    b = solution.source_fields(workspace_surface(shell()))[0]
    assert np.abs(b[0] - INSIDE * UP).max() < 0.1 * INSIDE
    assert len(solution.report.tolerance.steps) == 2


def test_estimates_at_an_edge_fall_and_say_where():
    with pytest.raises(ToleranceNotReached) as caught:
        fm.solve_to_tolerance(cube_at_an_edge(), 0.001, most_meshes=4)
    report = caught.value.report
    assert report.ended == "meshes"
    # So near to an edge the estimates of the first meshes vary by a fifth.
    excess = [step.excess for step in report.steps[1:]]
    assert all(later < 1.2 * earlier for earlier, later in pairwise(excess))
    assert excess[-1] < 0.5 * excess[0]
    # 102 faces per cube at first; each mesh aims at twice the faces of the previous one.
    assert all(later.faces > 1.4 * earlier.faces for earlier, later in pairwise(report.steps))
    # The error is at the workspace's points next to the edge, caused by elements of the near cube below them.
    assert report.worst.at[0] == pytest.approx(1.01e-2)
    assert report.shares[0].body == "near"
    assert report.shares[0].share > 0.9
    x, _, z = report.shares[0].at
    assert (x > 8e-3 and z > -4e-3) or z > -1e-3
    assert report.shares[0].wanted < report.shares[0].size
    assert report.next_mesh.faces > report.steps[-1].faces
    assert report.whole.faces > report.next_mesh.faces
    assert caught.value.solution.report.tolerance == report
    assert "'near'" in str(caught.value)


def test_a_run_that_no_longer_improves_ends(monkeypatch):
    """Every mesh is the same, so the estimate of the error does not fall."""
    monkeypatch.setattr(to_tolerance, "next_sizes", lambda *given: next_sizes(*given[:-2], 1.0, 1.0))
    monkeypatch.setattr(to_tolerance, "estimate_error", lambda *_, **__: estimate)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    one = Made(lambda x: np.broadcast_to(UP, x.shape))
    estimate = estimate_error(points, one, Made(lambda x: np.broadcast_to(1.5 * UP, x.shape)), None)
    with pytest.raises(ToleranceNotReached) as caught:
        fm.solve_to_tolerance(cube_at_an_edge(), 0.01)
    assert caught.value.report.ended == "stalled"
    assert len(caught.value.report.steps) == 5
    assert len(caught.value.residuals) == 4


@dataclass(frozen=True)
class Made:
    """Fields given as functions; the gradient is 0."""

    flux_density: object
    gradient: object = lambda x: np.zeros((len(x), 3, 3))
    sources: tuple = ("one",)
    iron_points: np.ndarray = field(default_factory=lambda: np.array([[0.0, 0.0, 5.0]]))

    def source_fields(self, points):
        return self.flux_density(points)[None], self.gradient(points)[None]


def test_the_estimate_says_of_what_and_where():
    points = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-2.0, 2.0) for z in (-2.0, 2.0)])

    def bent(x):
        return UP + 0.02 * (x[:, :1] > 0) * (x[:, 1:2] > 0) * (x[:, 2:] < 0)

    def slope(x):
        return 0.03 * np.eye(3) * ((x[:, 0] < 0) & (x[:, 2] > 0))[:, None, None]

    exact, ours = Made(lambda x: np.broadcast_to(UP, x.shape)), Made(bent, slope)
    error = estimate_error(points, exact, ours, None)
    b, g = error.worst("B"), error.worst("gradient")
    assert b.at == (1.0, 2.0, -2.0)
    assert b.error == pytest.approx(0.02 * np.sqrt(3))
    assert error.flux_density == pytest.approx(b.relative) == pytest.approx(b.error / b.size)
    assert (g.at[0], g.at[2]) == (-1.0, 2.0)
    assert g.error == pytest.approx(0.03 * np.sqrt(3))
    # |B| = 1 T over the distance of the iron, 5 m, because half the diagonal is only 3 m.
    assert g.size == pytest.approx(0.2)
    assert error.gradient == pytest.approx(0.15 * np.sqrt(3))
    assert error.by_source == (b, g)


@dataclass(frozen=True)
class Several:
    """Uniform fields (c, n, 3) of several sources; the gradient is 0."""

    flux_density: tuple
    iron_points: np.ndarray = field(default_factory=lambda: np.array([[0.0, 0.0, 5.0]]))

    @property
    def sources(self):
        return tuple(f"source {k}" for k in range(len(self.flux_density)))

    def source_fields(self, points):
        b = np.repeat(np.array(self.flux_density, float)[:, None], len(points), axis=1)
        return b, np.zeros((*b.shape, 3))


def test_two_forms_and_two_meshes_of_several_sources():
    """The mean of two forms is off by half of their difference: 1 % and 10 % for two sources. A change between meshes
    of 2 % counts for the first, a change of 1 % not for the second; a source without field has no error."""
    points = np.array([[-1.0, -2.0, -2.0], [1.0, 2.0, 2.0]])
    ours = Several(((0, 0, 2.0), (0.5, -1.2, 0), (0, 0, 0)))
    other = Several(((0, 0, 2.04), (0.5, -0.94, 0), (0, 0, 0)))
    coarser = Several(((0, 0.04, 2.0), (0.5, -1.213, 0), (0, 0, 0)))
    error = estimate_error(points, ours, coarser, other)
    assert [one.source for one in error.by_source] == 2 * list(ours.sources)
    assert [one.quantity for one in error.by_source] == ["B"] * 3 + ["gradient"] * 3
    assert [one.error for one in error.by_source] == pytest.approx([0.04, 0.13, 0, 0, 0, 0])
    assert [one.size for one in error.by_source] == pytest.approx([2.0, 1.3, 0.0, 0.4, 0.26, 0.0])
    assert (error.flux_density, error.gradient) == (pytest.approx(0.1), 0.0)
    assert error.gap == (pytest.approx(0.2), 0.0)
    assert error.change == (pytest.approx(0.02), 0.0)
    assert error.worst("B").source == "source 1"
    # At the source whose forms differ most: its largest component in the middle.
    forms = error.both_forms
    assert (forms.what, forms.source, forms.at) == ("By", "source 1", (0.0, 0.0, 0.0))
    assert (forms.solution, forms.complement) == (-1.2, -0.94)
    assert error.shares is None
    alone = estimate_error(points, ours, None, other)
    assert alone.change is None
    assert [one.error for one in alone.by_source[:2]] == pytest.approx([0.02, 0.13])
    assert estimate_error(points, ours, coarser, None, np.array([0.3, 0.7, 0.1])).shares == 0.7
    nothing = Several(np.zeros((0, 3)))
    error = estimate_error(points, nothing, nothing, None, np.zeros(0))
    assert (error.change, error.shares, error.flux_density, error.gradient) == ((0.0, 0.0), 0.0, 0.0, 0.0)


def test_growth_and_shares_scale_what_two_meshes_differ_by():
    """A change of 3 % with a quarter more faces is a quarter of the error, with three times the faces all of it; the
    error is limited to twice the faces' share, 0.4 %."""
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    ours = Made(lambda x: np.broadcast_to(UP, x.shape))
    coarser = Made(lambda x: np.broadcast_to(1.03 * UP, x.shape), lambda x: np.full((len(x), 3, 3), 0.01))
    found = [estimate_error(points, ours, coarser, None, growth=growth) for growth in (0.25, 1.0, 3.0)]
    assert [one.flux_density for one in found] == pytest.approx([0.12, 0.03, 0.03])
    assert found[0].gradient == pytest.approx(4 * found[1].gradient)
    assert [one.change[0] for one in found] == pytest.approx([0.03] * 3)
    limited = estimate_error(points, ours, coarser, None, np.array([4e-3]))
    assert limited.flux_density == pytest.approx(8e-3)
    assert limited.gradient == pytest.approx(found[1].gradient)
    assert estimate_error(points, ours, coarser, None, np.array([0.5])).flux_density == pytest.approx(0.03)


def test_the_length_is_the_larger_of_the_two():
    corners = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    assert gradient_length(corners, np.array([[0, 0.3, 0], [0, 4.0, 0]])) == 1.0
    assert gradient_length(corners, np.array([[0, 3.0, 0], [0, 4.0, 0]])) == 3.0
    assert gradient_length(corners, np.zeros((0, 3))) == 1.0


def error_of(quantity, error, size):
    return LargestError(quantity, "one", (0.0, 0.0, 0.0), error, size)


def test_the_larger_part_of_a_tolerance_is_allowed():
    b, g = error_of("B", 1e-3, 0.5), error_of("gradient", 1e-3, 2.0)
    assert Tolerance(0.01).allowed(b, 0, 0) == pytest.approx(5e-3)
    assert Tolerance(0.01).allowed(g, 0, 0) == np.inf
    assert Tolerance(0.01, absolute_flux_density=7e-3).allowed(b, 0, 0) == 7e-3
    assert Tolerance(0.01, absolute_gradient=0.5).allowed(g, 0, 0) == 0.5
    # A flux density at 4 A in the first of two coils; further sources are magnets.
    asked = Tolerance(absolute_flux_density=8e-3, currents=(4.0, -2.0))
    assert [asked.allowed(b, k, 2) for k in range(3)] == [2e-3, 4e-3, 8e-3]
    assert Tolerance.of(0.01) == Tolerance(0.01, 0.03)
    assert Tolerance.of(0.01, 1.5).gradient == 1.5
    assert Tolerance.of(0.01, np.inf) == Tolerance(0.01)
    assert Tolerance.of(asked) is asked


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        ({}, "flux_density"),
        ({"flux_density": 0.0}, "flux_density"),
        ({"flux_density": 1.0}, "flux_density"),
        ({"flux_density": 1.5}, "flux_density"),
        ({"gradient": -1.0}, "gradient"),
        ({"gradient": float("inf")}, "gradient"),
        ({"flux_density": float("nan")}, "flux_density"),
        ({"absolute_gradient": float("inf")}, "absolute_gradient"),
        ({"absolute_flux_density": 0.0}, "absolute_flux_density"),
        ({"flux_density": 0.1, "currents": (1.0, float("nan"))}, "currents"),
    ],
)
def test_tolerances_that_cannot_be_meant_are_refused(arguments, where):
    with pytest.raises(InputError) as caught:
        Tolerance(**arguments)
    assert [problem.where for problem in caught.value.problems] == [f"Tolerance, {where}"]


def test_arguments_are_checked_before_anything_is_solved():
    device = shell()
    with pytest.raises(InputError) as caught:
        fm.solve_to_tolerance(device, 0.01, most_meshes=1)
    assert "most_meshes" in caught.value.problems[0].where
    with pytest.raises(InputError) as caught:
        fm.solve_to_tolerance(device, Tolerance(0.01, currents=(1.0,)))
    assert "currents" in caught.value.problems[0].where


def test_cost_follows_the_powers_that_the_meshes_show():
    """Time grows like N^1.7, the excess falls like N^-1.25."""
    steps = [
        MeshStep(n, 2 * n, 1, 1e-5 * n**1.7, 0.0, 0.0, 3.0 * (4000 / n) ** 1.25 if n > 1000 else None)
        for n in (1000, 2000, 4000)
    ]
    assert expected_cost(steps, 9000, 1, 1.0).seconds == pytest.approx(1e-5 * 9000**1.7)
    assert faces_within(steps) == pytest.approx(4000 * 3.0**0.8)
    assert faces_within(steps[:2]) is None
    # An excess that does not fall gives no forecast.
    flat = [MeshStep(n, n, 1, 1.0, 0.0, 0.0, 2.0) for n in (1000, 2000, 4000)]
    assert faces_within(flat) is None


@dataclass(frozen=True)
class Counts:
    """The parts of a report that a run uses."""

    surface_faces: int
    tetrahedra: int = 1
    matrix_bytes: int = 1
    error: object = None
    refinement: tuple = ()
    tolerance: object = None


@dataclass(frozen=True)
class Solved:
    number: int
    report: Counts


def run_of(monkeypatch, excess, most_meshes=10, fits=99, own_excess=1.0):
    """A run whose meshes double their faces and have, from the second on, estimates of these multiples of the
    tolerance: its solution or its error, and the requests for meshes and messages on the way."""
    told = {"reductions": [], "growth": [], "fractions": [], "meshes": 0}

    def mesh(*_, local):
        assert (local is None) == (told["meshes"] == 0)
        told["meshes"] += 1
        return told["meshes"]

    def level(_, number, *__):
        return SimpleNamespace(
            solution=Solved(number, Counts(100 * 2**number)),
            complement=None,
            relative_shares=None,
            own_excess=own_excess,
            next_sizes=lambda reduction: told["reductions"].append(reduction) or "sizes",
            shares_of_bodies=lambda _: (),
            growth=lambda _: (3.0, 5.0),
            operations=1,
        )

    def estimate(points, ours, coarser, complement, shares, growth):
        assert ours.number == coarser.number + 1
        told["growth"].append(growth)
        error = 0.01 * excess[coarser.number - 1]
        return ErrorEstimate(error, 0.0, None, None, by_source=(error_of("B", error, 1.0),))

    for name, value in (("generate_mesh", lambda *a, **k: mesh(*a, **k)), ("assemble", lambda mesh: mesh),
                        ("fits_into_memory", lambda mesh: mesh <= fits), ("estimate_error", estimate),
                        ("Level", SimpleNamespace(solved=level))):  # fmt: skip
        monkeypatch.setattr(to_tolerance, name, value)
    stages = Stages(lambda _, fraction: told["fractions"].append(fraction))
    run = to_tolerance._Run(shell(), Tolerance(0.01), np.zeros((1, 3)), None, most_meshes, stages)
    try:
        return run.solution(), told
    except ToleranceNotReached as error:
        return error, told


def test_a_run_ends_within_the_tolerance(monkeypatch):
    """Each mesh must divide the error by 1.6 times its excess; by at least 2 after the first mesh, by 1.5 later."""
    solution, told = run_of(monkeypatch, [4.0, 1.2, 0.9, 0.1])
    assert solution.number == 4
    assert solution.report.refinement == ((400, 0.04), (800, 0.012), (1600, pytest.approx(0.009)))
    assert solution.report.error.flux_density == pytest.approx(0.009)
    report = solution.report.tolerance
    assert (report.ended, report.next_mesh, report.whole) == ("reached", None, None)
    assert [step.faces for step in report.steps] == [200, 400, 800, 1600]
    assert [step.excess for step in report.steps] == [
        None,
        pytest.approx(4),
        pytest.approx(1.2),
        pytest.approx(0.9),
    ]
    assert report.worst.error == pytest.approx(0.009)
    assert told["reductions"] == pytest.approx([2.0, 6.4, 1.92])
    assert told["growth"] == [1.0, 1.0, 1.0]
    assert told["fractions"] == sorted(told["fractions"])
    assert (told["fractions"][0], told["fractions"][-1]) == (0.0, 1.0)
    assert [told["fractions"][2 * k] for k in range(4)] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert run_of(monkeypatch, [1.0], own_excess=10.0)[1]["reductions"] == [16.0]
    # An error equal to the tolerance is within it.
    assert run_of(monkeypatch, [0.93, 0.5])[0].number == 2
    assert run_of(monkeypatch, [1.05, 0.5])[1]["reductions"][1] == pytest.approx(1.68)
    assert run_of(monkeypatch, [1.005, 0.5])[1]["reductions"][1] == pytest.approx(1.608)


@pytest.mark.parametrize(
    ("excess", "most", "fits", "ended", "meshes", "best"),
    [
        # Three times in a row within a tenth of the best, better or worse.
        ([3.0, 2.9, 2.8, 2.75, 1.0], 10, 99, "stalled", 5, 5),
        ([3.0, 4.0, 5.0, 6.0, 1.0], 10, 99, "stalled", 5, 2),
        ([3.0, 2.9, 2.8, 2.4, 2.3, 2.29, 2.28, 1.0], 10, 99, "stalled", 8, 8),
        ([3.0, 2.0, 1.5, 0.1], 4, 99, "meshes", 4, 4),
        ([3.0, 2.0, 2.5, 0.1], 4, 99, "meshes", 4, 3),
        ([3.0, 2.0, 1.5, 0.1], 10, 3, "memory", 3, 3),
    ],
)
def test_a_run_that_does_not_get_there_says_how_it_ended(
    monkeypatch, excess, most, fits, ended, meshes, best
):
    error, _ = run_of(monkeypatch, excess, most, fits)
    assert isinstance(error, ToleranceNotReached)
    assert error.report.ended == ended
    assert len(error.report.steps) == meshes
    assert error.residuals == pytest.approx([0.01 * value for value in excess[: meshes - 1]])
    assert error.solution.number == best
    assert error.report.worst.error == pytest.approx(0.01 * excess[best - 2])
    assert error.solution.report.error.flux_density == pytest.approx(0.01 * excess[best - 2])
    # The next mesh grows as the sizes give; a mesh within the tolerance by the power of the excess.
    faces = 100 * 2**meshes
    assert error.report.next_mesh.faces == 3 * faces
    assert error.report.next_mesh.tetrahedra == 5
    whole = faces_within(error.report.steps)
    assert (error.report.whole is None) == (whole is None)
    if whole is not None:
        assert error.report.whole.faces == round(whole)
        assert error.report.whole.tetrahedra == round((whole / faces) ** 1.5)


def test_a_run_without_memory_for_a_mesh_has_no_estimate(monkeypatch):
    first, _ = run_of(monkeypatch, [], fits=0)
    assert (first.report, first.solution) == (None, None)
    second, _ = run_of(monkeypatch, [], fits=1)
    assert (second.report.ended, second.solution, second.residuals) == ("memory", None, ())
    assert second.problems[0].received == "no estimate"


def test_in_thin_walls_smaller_elements_have_an_effect():
    """With four layers of edges longer than requested the mesh would stay the same."""
    device = shell()
    mesh = generate_mesh(device, 0.7)
    cells = mesh.cells
    assert cells.sizes.max() <= 4e-3 / 0.7 * (1 + 1e-12)
    finer = generate_mesh(
        device, 0.7, local=LocalSizes(cells.centres, 0.6 * cells.sizes, np.zeros((0, 3)), np.zeros(0))
    )
    assert len(finer.tets) > 1.8 * len(mesh.tets)


@pytest.mark.parametrize("height", [0.1, 0.5, 1.0])
def test_a_charge_that_varies_over_a_face_near_by_is_not_underrated(height):
    """A linear charge of standard deviation 1 T on the face, seen from above its middle and its corner."""
    corners = np.array([[0.0, 0, 0], [2.0, 0, 0], [0.6, 1.8, 0]])
    surface = ChargedFaces.from_nodes(corners, np.array([[0, 1, 2]]))
    pieces, worst = [corners], 0.0
    for _ in range(6):
        pieces = [half for piece in pieces for half in quartered(piece)]
    centres, share = np.array([piece.mean(axis=0) for piece in pieces]), surface.areas[0] / len(pieces)
    places = np.vstack([corners.mean(axis=0), corners[0]]) + height * UP
    for direction in (np.array([1.0, 0, 0]), np.array([0, 1.0, 0])):
        charge = centres @ direction
        charge = (charge - charge.mean()) / charge.std()
        offset = places[:, None] - centres
        b = share * (charge[:, None] * offset / np.linalg.norm(offset, axis=2)[:, :, None] ** 3).sum(axis=1)
        worst = np.maximum(worst, np.linalg.norm(b, axis=1) / (4 * np.pi))
    ratio = near_kernels(surface, places)[:, 0] / worst
    assert (ratio > 0.5).all()
    assert (ratio < 12).all()


def quartered(piece):
    a, b, c = piece
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return [np.array(one) for one in ((a, ab, ca), (ab, b, bc), (bc, c, ca), (ab, bc, ca))]


def test_the_error_travels_between_processes(shielded):
    error = ToleranceNotReached(residuals=(0.1,), report=shielded.report.tolerance)
    back = pickle.loads(pickle.dumps(error))
    assert back.residuals == (0.1,)
    assert back.report == error.report
