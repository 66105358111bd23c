"""The storage of W must not show in the result: compression is forced on a small mesh, by the public functions."""

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators import assembled
from tests.iron.shared import electromagnet

POINTS = np.array([[x, 0.0, z] for x in (0.0, 0.01, 0.02) for z in (-0.01, -0.02, -0.04)])


def saturating():
    """Disk and core of saturating iron in a coil."""
    h = np.geomspace(20.0, 1e5, 40)
    b = mu_0 * h + 2.0 * h / (h + 400.0)
    law = fm.BHTable("iron", h, b, "straight line to the origin", "slope mu0", b[0] / h[0] / mu_0)
    return electromagnet(law, core_size=0.008)


@pytest.mark.parametrize(
    ("faces", "operations", "memory", "storage"),
    [
        (12_000, 1, None, "dense"),
        (12_001, 1, None, "compressed"),
        # The work for the blocks of a symmetry falls with the square of its order.
        (24_000, 4, None, "dense"),
        (24_001, 4, None, "compressed"),
        # The matrix takes 16 bytes a pair, divided by the number of operations.
        (10_000, 1, 1.61e9, "dense"),
        (10_000, 1, 1.60e9, "compressed"),
        (20_000, 4, 1.61e9, "dense"),
        (20_000, 4, 1.59e9, "compressed"),
    ],
)
def test_dense_where_it_is_quicker_and_fits(monkeypatch, faces, operations, memory, storage):
    monkeypatch.setattr(assembled, "memory_bytes", lambda: memory)
    assert assembled.chosen_storage(faces, operations) == storage
    expected = 16.0 * faces**2 / operations if storage == "dense" else 12e3 * faces
    assert assembled.expected_bytes(faces + 0.2, operations) == pytest.approx(expected, rel=1e-4)


def test_what_does_not_fit_is_told_before_it_is_made(monkeypatch):
    mesh = generate_mesh(saturating(), 0.5)
    faces = len(assembled.build_faces(mesh.points, mesh.tets).surface)
    needed = 16 * faces**2
    monkeypatch.setattr(assembled, "memory_bytes", lambda: 1.001 * needed)
    assert assembled.fits_into_memory(mesh)
    assert assembled.assemble(mesh).mutual.storage == "dense"
    # Compressed storage of so few faces needs more than that.
    monkeypatch.setattr(assembled, "memory_bytes", lambda: needed)
    assert not assembled.fits_into_memory(mesh)
    with pytest.raises(InputError) as caught:
        assembled.assemble(mesh)
    assert caught.value.problems[0].received.startswith(f"{faces} surface faces, ")
    # With four operations a quarter of the memory is enough.
    quarter = generate_mesh(saturating(), 0.5, symmetry="auto")
    count = len(assembled.build_faces(quarter.points, quarter.tets).surface)
    assert quarter.symmetry.group.order == 4
    monkeypatch.setattr(assembled, "memory_bytes", lambda: 4.001 * count**2)
    assert assembled.fits_into_memory(quarter)
    monkeypatch.setattr(assembled, "memory_bytes", lambda: 3.999 * count**2)
    assert not assembled.fits_into_memory(quarter)


def with_storage(monkeypatch, storage, run):
    monkeypatch.setattr(assembled, "chosen_storage", lambda faces, operations: storage)
    solution = run()
    assert solution.report.storage.startswith("compressed") == (storage == "compressed")
    return solution


def assert_same(one, other):
    assert np.abs(one - other).max() < 1e-5 * np.abs(one).max()


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_linear_iron(monkeypatch, form):
    def run():
        return fm.solve_linear(fm.read_device("loop_and_sphere"), mu_r=1000.0, form=form)

    dense, compressed = (with_storage(monkeypatch, s, run) for s in ("dense", "compressed"))
    assert compressed.report.surface_faces > 500
    space = dense.state.faces.centres.max(axis=0)
    points = np.array([[x, 0.0, -z] for x in (0.0, 0.5) for z in (1.5, 2.0)]) * space.max()
    for one, other in zip(dense.unit_fields(points), compressed.unit_fields(points), strict=True):
        assert_same(one, other)


def test_saturating_iron(monkeypatch):
    dense, compressed = (
        with_storage(monkeypatch, s, lambda: fm.solve(saturating(), [40.0])) for s in ("dense", "compressed")
    )
    assert compressed.report.iterations == dense.report.iterations
    assert_same(dense.field(POINTS), compressed.field(POINTS))
    assert_same(dense.gradient(POINTS), compressed.gradient(POINTS))
