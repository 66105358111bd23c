"""Solved iron as .vtu, read by pyvista: the numbers in the elements are those of the state and of the materials."""

import numpy as np
import pytest
import pyvista as pv
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.plot.vtu import write_vtu

COIL = fm.CircularCoil("coil", 0.006, 0.008, 0.01, 100.0).moved([0, 0, 0.01])


@pytest.fixture(scope="module")
def state():
    core = fm.Body("core", "iron", fm.Cylinder(0.005, 0.02), 0.004)
    magnet = fm.Body("magnet", "ndfeb", fm.Box((0.004, 0.004, 0.004)), 0.003).moved([0, 0, 0.03])
    materials = {
        "iron": fm.LinearMaterial("iron", 200.0),
        "ndfeb": fm.PermanentMagnet("ndfeb", [0.0, 0.0, 1.1], 1.05),
    }
    return fm.solve_linear(fm.Device("d", "", (COIL,), (core, magnet), materials)).at(3.0)


def test_fields_of_the_elements(state, tmp_path):
    grid = pv.read(write_vtu(state, tmp_path / "iron.vtu"))
    assert grid.n_cells == len(state.mesh.tets)
    assert np.array_equal(grid.points, state.mesh.points)
    assert [str(name) for name in grid.field_data["body_names"]] == ["core", "magnet"]
    assert grid.field_data["currents_A"].tolist() == [3.0]
    flux, strength, polarisation = (grid.cell_data[name] for name in ("B_T", "H_A_per_m", "J_T"))
    assert flux == pytest.approx(state.element_flux_density, rel=1e-12)
    assert mu_0 * strength + polarisation == pytest.approx(flux, rel=1e-12)
    core = grid.cell_data["body"] == 0
    assert grid.cell_data["mu_r"][core] == pytest.approx(200.0, rel=1e-9)
    remanence = (flux - 1.05 * mu_0 * strength)[~core]
    assert remanence == pytest.approx(np.tile([0.0, 0.0, 1.1], (len(remanence), 1)), abs=1e-9)
    volume = grid.compute_cell_sizes()["Volume"][core]
    assert volume @ flux[core] / volume.sum() == pytest.approx(state.flux_density("core"), rel=1e-9)


def test_what_cannot_be_written(state, tmp_path):
    with pytest.raises(InputError) as caught:
        write_vtu(state, tmp_path / "iron.vti")
    assert caught.value.problems[0].received == "iron.vti"
    with pytest.raises(InputError) as caught:
        write_vtu(fm.solve_linear(fm.Device("d", "", (COIL,))).at(1.0), tmp_path / "iron.vtu")
    assert caught.value.problems[0].where == "write_vtu, state"
    assert not list(tmp_path.iterdir())
