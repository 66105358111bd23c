"""`solve_linear`: shipped devices, superposition, limits, derivative and refused input."""

import magpylib
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import FieldmapError, GeometryError, InputError
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.sources import unit_flux_density

BELOW = np.array([[0.0, 0.0, -0.02], [0.01, 0.005, -0.03], [-0.02, 0.01, -0.015]])


def block_and_coil(mu_r=500.0, scale=1.0):
    """A block with a ring coil above it, all lengths times `scale`."""
    body = fm.Body(
        "block", "iron", (fm.Part(fm.Box((0.03 * scale, 0.02 * scale, 0.01 * scale))),), 0.006 * scale
    )
    at = fm.Placement(np.array([0.002, 0.0, 0.02]) * scale, np.eye(3))
    coil = fm.CircularCoil("coil", 0.01 * scale, 0.015 * scale, 0.01 * scale, 100.0, placement=at)
    return fm.Device("block", "", (coil,), (body,), {"iron": fm.LinearMaterial("iron", mu_r)})


@pytest.fixture(scope="module")
def solution():
    return fm.solve_linear(block_and_coil())


def test_shipped_loop_and_sphere_against_its_closed_form():
    """The shipped first example: the references of its file are the Legendre series of the exact solution."""
    device = fm.read_device("loop_and_sphere")
    unit = fm.solve_linear(device)
    assert len(device.references) >= 4
    for reference in device.references:
        if reference.quantity == "Bz":
            ours = unit.field(reference.at, reference.currents)[2]
        else:
            assert reference.quantity == "dBz/dz"
            ours = unit.gradient(reference.at, reference.currents)[2, 2]
        assert ours == pytest.approx(reference.value, rel=1e-3)


@pytest.mark.parametrize("axis", range(3))
def test_taylor_of_the_field(solution, axis):
    step = np.eye(3)[axis]
    slope = solution.gradient(BELOW, [2.0])[:, :, axis]
    remainder = []
    for h in (1e-3, 5e-4, 2.5e-4):
        ahead = solution.field(BELOW + h * step, [2.0])
        remainder.append(np.abs(ahead - solution.field(BELOW, [2.0]) - h * slope).max())
    assert np.log2(remainder[0] / remainder[1]) > 1.9
    assert np.log2(remainder[1] / remainder[2]) > 1.9


def test_gradient_obeys_maxwell_to_rounding(solution):
    gradient = solution.gradient(BELOW, [1.0])
    norm = np.linalg.norm(gradient, axis=(1, 2))
    assert (np.abs(np.trace(gradient, axis1=1, axis2=2)) <= 1e-10 * norm).all()
    antisymmetric = np.linalg.norm(gradient - np.swapaxes(gradient, 1, 2), axis=(1, 2))
    assert (antisymmetric <= 1e-10 * norm).all()


def test_superposition_and_points_of_either_shape(solution):
    many = solution.field(BELOW, [3.0])
    assert many == pytest.approx(3 * solution.unit_fields(BELOW)[0][0], rel=1e-12)
    assert solution.field(BELOW[0], [3.0]) == pytest.approx(many[0], rel=1e-12)
    assert solution.gradient(BELOW[1], [3.0]) == pytest.approx(solution.gradient(BELOW, [3.0])[1], rel=1e-12)


def test_permeability_one_is_the_coil_alone():
    device = block_and_coil()
    unit = fm.solve_linear(device, mu_r=1.0)
    assert unit.field(BELOW, [1.0]) == pytest.approx(unit_flux_density(device.coils[0], BELOW), rel=1e-5)


def test_twice_the_size_is_half_the_field(solution):
    """At given ampere-turns B falls with the inverse of the scale, iron included."""
    large = fm.solve_linear(block_and_coil(scale=2.0))
    assert 2 * large.field(2 * BELOW, [1.0]) == pytest.approx(solution.field(BELOW, [1.0]), rel=1e-3)


def test_flux_density_inside_is_continuous_with_outside():
    """The normal component of B is continuous at the surface of the iron; at mu_r = 500 it is nearly the whole field
    outside. In the flux form that holds element by element."""
    solution = fm.solve_linear(block_and_coil(), form="flux")
    # The place avoids the block's mirror planes, where elements meet that touch the surface at a corner only.
    place = np.array([[0.001, 0.0005, 0.0098]])
    element = solution.mesh.containing(place)
    corners = solution.mesh.points[solution.mesh.tets[element[0]]]
    barycentric = np.linalg.solve(np.vstack([corners.T, np.ones(4)]), np.append(place[0], 1.0))
    inside = solution.state.flux_density_at(element, barycentric[None])[0, 0]
    outside = solution.field([[0.001, 0.0005, 0.0102]], [1.0])[0]
    assert inside[2] == pytest.approx(outside[2], rel=0.1)
    assert abs(inside[0]) > 3 * abs(outside[0])
    mean = solution.flux_density("block", [1.0])
    assert mean[2] > 0
    assert abs(mean[2]) < np.abs(inside).max() * 3


@pytest.mark.parametrize("points", [BELOW[0], BELOW, np.stack([BELOW, 1.5 * BELOW])])
def test_both_in_one_pass_are_those_one_by_one(solution, points):
    apart = solution.field(points, [2.0]), solution.gradient(points, [2.0])
    for found, wanted in zip(solution.field_and_gradient(points, [2.0]), apart, strict=True):
        assert found.shape == wanted.shape
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
    with pytest.raises(InputError):
        solution.field_and_gradient([[0.0, 0.0, 0.005]], [2.0])


def test_elements_are_those_of_the_mesh_that_is_asked():
    """Two meshes at once, each asked twice: the stored search of one does not answer for the other."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    inner = np.array([[0.1, 0.2, 0.3]])
    meshes = [
        IronMesh(corners + shift, np.array([[0, 1, 2, 3]]), np.zeros(1, dtype=np.int64), ("one",))
        for shift in (0.0, 0.4)
    ]
    for _ in range(2):
        found = [[mesh.containing(inner + shift)[0] for shift in (0.0, 0.4)] for mesh in meshes]
        assert found == [[0, -1], [-1, 0]]


def test_assumptions_and_counts_are_reported(solution):
    report = solution.report
    assert report.residual < 1e-7
    assert report.magnetic_bodies == 1
    assert any("mu_r = 500" in text for text in report.assumptions)
    assert str(report.tetrahedra) in str(report)


def test_initial_slope_of_a_table_is_named():
    unit = fm.solve_linear(fm.read_device("loop_and_sphere"), mu_r=7.0)
    assert any("mu_r = 7 as requested" in text for text in unit.report.assumptions)


def test_coils_without_iron():
    device = block_and_coil()
    bare = fm.Device("bare", "", device.coils)
    unit = fm.solve_linear(bare)
    assert unit.field(BELOW, [2.0]) == pytest.approx(2 * unit_flux_density(device.coils[0], BELOW), rel=1e-12)
    assert unit.report.surface_faces == 0


def test_progress_is_told_and_ends_at_one():
    seen = []
    fm.solve_linear(block_and_coil(), progress=lambda text, part: seen.append((text, part)))
    fractions = [part for _, part in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


@pytest.mark.parametrize(
    "arguments",
    [
        {"mu_r": 0.0},
        {"mu_r": float("nan")},
        {"mu_r": "initial"},
        {"mu_r": [1000.0]},
        {"tolerance": 0.0},
        {"refinement": -1.0},
        {"form": "vector"},
        {"form": "potential", "mu_r": 0.5},
    ],
)
def test_bad_arguments(arguments):
    with pytest.raises(InputError) as caught:
        fm.solve_linear(block_and_coil(), **arguments)
    assert [problem.where for problem in caught.value.problems] == [f"solve_linear, {next(iter(arguments))}"]


@pytest.mark.parametrize(
    ("points", "currents", "where", "received"),
    [
        ([[0.0, 0.0]], [1.0], "points", "(1, 2)"),
        ([[0.0, 0.0, np.nan]], [1.0], "points", ""),
        ([[0.0, 0.0, -0.02]], [1.0, 2.0], "currents", "(2,)"),
        ([[0.0, 0.0, -0.02]], [np.inf], "currents", "inf"),
        ([[0.0, 0.0, -0.02]], {"cull": 1.0}, "currents", "cull"),
    ],
)
def test_bad_evaluation(solution, points, currents, where, received):
    with pytest.raises(InputError) as caught:
        solution.field(points, currents)
    (problem,) = caught.value.problems
    assert problem.where == where
    assert received in problem.received


def test_gradient_inside_iron_is_refused(solution):
    with pytest.raises(InputError) as caught:
        solution.gradient([[0.0, 0.0, 0.005]], [1.0])
    (problem,) = caught.value.problems
    assert problem.where == "points"
    assert "'block'" in problem.received


def test_unknown_body(solution):
    with pytest.raises(FieldmapError) as caught:
        solution.flux_density("blok", [1.0])
    (problem,) = caught.value.problems
    assert problem.received == "'blok'"
    assert "block" in problem.must_hold


def test_a_coil_through_iron_is_refused_before_any_work():
    device = block_and_coil()
    low = fm.Placement(np.array([0.0, 0.0, 0.005]), np.eye(3))
    coil = fm.CircularCoil("coil", 0.005, 0.008, 0.01, 100.0, placement=low)
    with pytest.raises(GeometryError, match="block"):
        fm.solve_linear(fm.Device("bad", "", (coil,), device.bodies, device.materials))


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_a_magnet_without_any_coil(form):
    """Its remanence is the only source; at mu_r = 1 magpylib's block is exact."""
    body = fm.Body("block", "magnet", (fm.Part(fm.Box((0.02, 0.03, 0.01))),), 0.006)
    device = fm.Device(
        "m", "", (), (body,), {"magnet": fm.PermanentMagnet("magnet", np.array([0.3, 0.0, 1.2]), 1.0)}
    )
    solution = fm.solve_linear(device, form=form)
    block = magpylib.magnet.Cuboid(
        polarization=(0.3, 0, 1.2), dimension=(0.02, 0.03, 0.01), position=(0, 0, 0.005)
    )
    exact = block.getB(BELOW)
    field, gradient = solution.constant_fields(BELOW)
    assert field == pytest.approx(exact, abs=5e-3 * np.abs(exact).max())
    assert solution.field(BELOW, []) == pytest.approx(field, rel=1e-12)
    assert np.abs(np.trace(gradient, axis1=1, axis2=2)).max() < 1e-10 * np.abs(gradient).max()
