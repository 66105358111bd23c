"""A function whose library is not installed names the command that installs it."""

import sys

import numpy as np
import pytest

from fieldmap.control import StateSpace, TransferFunction
from fieldmap.device.mesh_files import read_mesh
from fieldmap.errors import FieldmapError
from fieldmap.extras import require
from fieldmap.interop import JaxEvaluator, MagnetForces, jax_field, read_mag_manip
from fieldmap.interop.levitation_env import LevitationEnv
from fieldmap.lookup.data_set import data_set
from fieldmap.plot.animation import save_animation
from fieldmap.plot.scenes import save_web_page
from fieldmap.plot.vtu import write_xdmf
from fieldmap.studies import optimise
from fieldmap.studies.run import require_xarray

MESH = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"


@pytest.mark.parametrize(
    ("call", "module", "extra"),
    [
        (lambda folder: MagnetForces(None, None, {}, np.zeros(1)), "mujoco", "mujoco"),
        (lambda folder: jax_field(None), "jax", "jax"),
        (lambda folder: JaxEvaluator(None), "jax", "jax"),
        (lambda folder: LevitationEnv(), "gymnasium", "gymnasium"),
        (lambda folder: read_mag_manip("none.yaml"), "yaml", "mag-manip"),
        (lambda folder: data_set(None, "harmonic", None, None, None), "xarray", "xarray"),
        (lambda folder: TransferFunction([1.0], [1.0, 1.0]).to_control(), "control", "control"),
        (lambda folder: StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]).to_control(), "control", "control"),
        (lambda folder: read_mesh(folder / "body.msh", 1.0), "meshio", "mesh"),
        (lambda folder: write_xdmf(None, folder / "iron.xdmf"), "meshio", "mesh"),
        (lambda folder: save_animation(None, folder / "run.mp4"), "imageio_ffmpeg", "video"),
        (lambda folder: save_web_page(None, folder / "scene.html"), "trame_vtk", "web"),
        (lambda folder: require_xarray(), "h5netcdf", "studies"),
        (lambda folder: require_xarray(), "xarray", "studies"),
        (lambda folder: optimise("pair", [], "power", method="optuna"), "optuna", "optuna"),
    ],
)
def test_the_extra_is_named(call, module, extra, tmp_path, monkeypatch):
    (tmp_path / "body.msh").write_text(MESH)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(FieldmapError) as caught:
        call(tmp_path)
    (problem,) = caught.value.problems
    assert problem.must_hold.split()[0] == module
    assert f'pip install "fieldmap[{extra}]"' in problem.remedy


def test_what_is_installed_is_given():
    assert require("numpy", "none", "here") is np
