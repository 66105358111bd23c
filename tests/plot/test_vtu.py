"""Solved iron as .vtu and .xdmf, read by pyvista and meshio: numbers of elements and faces against the state, the
materials and closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
import pyvista as pv
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.plot.vtu import iron_grid, write_charges_vtu, write_vtu, write_xdmf
from tests.refusals import refused

MATERIALS = {
    "iron": fm.LinearMaterial("iron", 200.0),
    "ndfeb": fm.PermanentMagnet("ndfeb", [0, 0, 1.1], 1.05),
}
COIL = fm.CircularCoil("coil", 0.006, 0.008, 0.01, 100.0).moved([0, 0, 0.01])


@pytest.fixture(scope="module")
def state():
    core = fm.Body("core", "iron", fm.Cylinder(0.005, 0.02), 0.004)
    magnet = fm.Body("magnet", "ndfeb", fm.Box((0.004, 0.004, 0.004)), 0.003).moved([0, 0, 0.03])
    return fm.solve_linear(fm.Device("d", "", (COIL,), (core, magnet), MATERIALS)).at(3.0)


def test_fields_of_the_elements(state, tmp_path):
    grid = pv.read(write_vtu(state, tmp_path / "iron.vtu"))
    assert grid.n_cells == len(state.mesh.tets)
    assert np.array_equal(grid.points, state.mesh.points)
    assert [grid.field_data[f"body {name}"].tolist() for name in ("core", "magnet")] == [[0], [1]]
    assert grid.field_data["currents_A"].tolist() == [3.0]
    flux, strength, polarisation = (grid.cell_data[name] for name in ("B_T", "H_A_per_m", "J_T"))
    assert flux == pytest.approx(state.element_flux_density, rel=1e-12)
    assert mu_0 * strength + polarisation == pytest.approx(flux, rel=1e-12)
    core = grid.cell_data["body"] == 0
    assert grid.cell_data["mu_r"][core] == pytest.approx(200.0, rel=1e-9)
    remanence = (flux - 1.05 * mu_0 * strength)[~core]
    assert remanence == pytest.approx(np.tile([0.0, 0.0, 1.1], (len(remanence), 1)), abs=1e-9)
    volume = grid.compute_cell_sizes()["Volume"]
    for name, of_it in (("core", core), ("magnet", ~core)):
        mean = volume[of_it] @ flux[of_it] / volume[of_it].sum()
        assert mean == pytest.approx(state.flux_density(name), rel=1e-9)


def test_what_cannot_be_written(state, tmp_path):
    with refused(InputError, where=str(tmp_path / "iron.vti")):
        write_vtu(state, tmp_path / "iron.vti")
    with refused(InputError, where="write_vtu, state"):
        write_vtu(fm.solve_linear(fm.Device("d", "", (COIL,))).at(1.0), tmp_path / "iron.vtu")
    assert not list(tmp_path.iterdir())


BALL = fm.Body("ball", "steel", fm.Sphere(0.01), 0.0035)
STEEL = fm.Froehlich("steel", 400.0, 1.6)
EARTH = fm.Background([0.0, 0.0, 0.3])


@pytest.fixture(scope="module")
def ball():
    """A saturating sphere in a uniform field: uniform inside, h = b0 - J / 3."""
    device = fm.Device("ball", "", (COIL.moved([0, 0, 0.1]),), (BALL,), {"steel": STEEL}, background=EARTH)
    return device, fm.solve(device, [0.0])


def saturated(b0, chi, most):
    """mu0 H and J inside: J = most x / (1 + x), x = chi h / most, by bisection."""
    low, high = 0.0, b0
    for _ in range(80):
        h = 0.5 * (low + high)
        j = most * chi * h / (most + chi * h)
        low, high = (h, high) if h + j / 3 < b0 else (low, h)
    return h, j


def test_charges_of_a_sphere_in_a_uniform_field(ball, tmp_path):
    _, state = ball
    grid = pv.read(write_charges_vtu(state, tmp_path / "charges.vtu"))
    _, j = saturated(0.3, 399.0, 1.6)
    charge, normal = grid.cell_data["charge_T"], grid.cell_data["normal"]
    outward = np.einsum("kd,kd->k", normal, grid.cell_centers().points)
    assert (outward > 0).all()
    assert np.abs(charge - j * normal[:, 2]).max() < 0.05 * j  # faces are flat and charges constant
    area = grid.compute_cell_sizes()["Area"]
    assert abs(area @ charge) < 1e-9 * area @ np.abs(charge)
    assert grid.n_points == 2 + grid.n_cells / 2  # Euler: corners are shared
    point = np.array([0.02, 0.01, -0.03])
    r = point - grid.cell_centers().points
    coulomb = (area * charge / (4 * np.pi * np.linalg.norm(r, axis=1) ** 3)) @ r
    assert coulomb + [0, 0, 0.3] == pytest.approx(state.field(point), abs=1e-3 * np.linalg.norm(coulomb))


def test_loss_of_permeability(ball, tmp_path):
    device, state = ball
    grid = pv.read(write_vtu(state, tmp_path / "iron.vtu", device))
    h, j = saturated(0.3, 399.0, 1.6)
    loss = 1 - (1 + j / h) / 400.0
    assert 0.2 < loss < 0.8
    assert np.median(grid.cell_data["permeability_loss"]) == pytest.approx(loss, abs=5e-3)
    assert "permeability_loss" not in pv.read(write_vtu(state, tmp_path / "iron.vtu")).cell_data
    with refused(InputError, where="write_vtu, device"):
        write_vtu(state, tmp_path / "other.vtu", device.replace(bodies=(), background=None))


def test_no_loss_in_linear_iron_and_none_in_magnets(state, tmp_path):
    bodies = (fm.Body("magnet", "ndfeb", fm.Sphere(1), 1), fm.Body("core", "iron", fm.Sphere(1), 1))
    grid = pv.read(write_vtu(state, tmp_path / "iron.vtu", fm.Device("d", "", (), bodies, MATERIALS)))
    loss = grid.cell_data["permeability_loss"]
    assert np.abs(loss[grid.cell_data["body"] == 0]).max() < 1e-9
    assert np.isnan(loss[grid.cell_data["body"] == 1]).all()


def test_meshio_reads_all_of_them(ball, tmp_path):
    meshio = pytest.importorskip("meshio")
    device, state = ball
    for read in (
        meshio.read(write_vtu(state, tmp_path / "iron.vtu", device)),
        meshio.read(write_xdmf(state, tmp_path / "iron.xdmf", device)),
    ):
        assert read.points == pytest.approx(state.mesh.points, rel=1e-15)
        assert np.array_equal(read.cells_dict["tetra"], state.mesh.tets)
        assert read.cell_data["B_T"][0] == pytest.approx(state.element_flux_density, rel=1e-12)
        assert read.cell_data["permeability_loss"][0].shape == (len(state.mesh.tets),)
    # These files may be replaced by the same writers; a mesh of another program may not.
    for write, name in (
        (write_vtu, "iron.vtu"),
        (write_xdmf, "iron.xdmf"),
        (write_charges_vtu, "charges.vtu"),
    ):
        write(state, tmp_path / name)
    pv.examples.cells.Tetrahedron().save(tmp_path / "mesh.vtu")
    with refused(InputError, where=str(tmp_path / "mesh.vtu")):
        write_vtu(state, tmp_path / "mesh.vtu")
    (tmp_path / "mesh.vtu").unlink()
    charges = meshio.read(write_charges_vtu(state, tmp_path / "charges.vtu"))
    assert charges.cell_data["charge_T"][0] == pytest.approx(state.weights @ state.iron.density, rel=1e-12)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["charges.vtu", "iron.vtu", "iron.xdmf"]


def test_numbers_of_made_up_elements():
    """Iron, a magnet and a flux barrier, with bodies numbered in this order. B and J are given, all else is computed by
    hand."""
    corners = np.vstack([np.zeros(3), np.eye(3), [[1.0, 1.0, 1.0]], [[2.0, 0.0, 0.0]]])
    mesh = SimpleNamespace(
        points=corners,
        tets=np.array([[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 4, 5]]),
        body=np.array([0, 1, 2]),
        body_names=("core", "magnet", "gap"),
        iron_names=("core", "magnet"),
        sheets=("gap",),
    )
    flux = np.array([[0.3, 0.0, 0.4], [0.0, 0.0, 1.0], [0.0, 0.2, 0.0]])
    polarisation = np.array([[0.297, 0.0, 0.396], [0.0, 0.0, 1.1], [0.0, 0.0, 0.0]])
    asked = []

    def mean_polarisation(elements, weights):
        asked.append((elements.tolist(), weights))
        return polarisation

    state = SimpleNamespace(
        mesh=mesh,
        iron=SimpleNamespace(mean_polarisation=mean_polarisation),
        weights="weights",
        currents=np.array([1.5, -2.0]),
        element_flux_density=flux,
    )
    bodies = (fm.Body("magnet", "ndfeb", fm.Sphere(1), 1), fm.Body("core", "iron", fm.Sphere(1), 1))
    grid = iron_grid(state, fm.Device("d", "", (), bodies, MATERIALS))
    assert asked == [([0, 1, 2], "weights")]
    cells = grid.cell_data
    np.testing.assert_array_equal(cells["B_T"], flux)
    np.testing.assert_array_equal(cells["J_T"], polarisation)
    np.testing.assert_allclose(cells["H_A_per_m"], (flux - polarisation) / mu_0)
    # |B| / |B - J|: 0.5 / 0.005, 1 / 0.1, 0.2 / 0.2; iron of mu_r 200 has lost half.
    np.testing.assert_allclose(cells["mu_r"], [100.0, 10.0, 1.0])
    np.testing.assert_allclose(cells["permeability_loss"], [0.5, np.nan, np.nan])
    assert (cells["body"].tolist(), grid.field_data["currents_A"].tolist()) == ([0, 1, 2], [1.5, -2.0])
    assert [grid.field_data[f"body {name}"][0] for name in ("core", "magnet", "gap")] == [0, 1, 2]
