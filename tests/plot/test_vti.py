""".vti files of a map, read by pyvista: the numbers at the nodes are the map's."""

import re

import numpy as np
import pytest
import pyvista as pv

from fieldmap.errors import InputError
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import interpolate
from fieldmap.plot.vti import write_vti
from fieldmap.store import Grid, MapData

# Three different numbers of nodes and spacings, so that an exchange of axes is noticed.
GRID = Grid([-0.02, -0.01, -0.12], [0.01, 0.004, 0.006], (5, 6, 7))
CURRENTS = np.array([1.5, -0.5])
UNITS = (("B", "T_per_A"), ("gradB", "T_per_m_A"))


def two_loops(points):
    """B (2, n, 3) and G (2, n, 3, 3) per ampere of two loops."""
    centres = np.array([[0, 0, 0.02], [0.03, 0.01, 0.03]])
    parts = [loop_flux_density_and_gradient(points - centre, 0.02) for centre in centres]
    return tuple(np.stack(part) for part in zip(*parts, strict=True))


@pytest.fixture(scope="module")
def loops():
    flux, slope = two_loops(GRID.points())
    arrays = {
        "flux_density": flux.reshape(2, *GRID.shape, 3),
        "gradient": slope.reshape(2, *GRID.shape, 3, 3),
    }
    return interpolate(MapData(GRID, ("left", "right"), np.full(2, 2.0), **arrays), kind="hermite")


def test_fixed_currents(loops, tmp_path):
    read = pv.read(write_vti(loops, tmp_path / "loops.vti", CURRENTS))
    assert read.dimensions == (5, 6, 7)
    np.testing.assert_allclose(read.bounds, [-0.02, 0.02, -0.01, 0.01, -0.12, -0.084], atol=1e-15)
    scale = np.einsum("cni,c->ni", two_loops(GRID.points())[0], CURRENTS)
    # At VTK's own points, from the map and from the closed form.
    flux, slope = loops.field_and_gradient(np.clip(read.points, loops.lower, loops.upper), CURRENTS)
    np.testing.assert_allclose(read["B_T"], flux, rtol=0, atol=1e-13 * np.abs(scale).max())
    np.testing.assert_allclose(
        read["gradB_T_per_m"].reshape(-1, 3, 3), slope, atol=1e-12 * np.abs(slope).max()
    )
    exact = np.einsum("cni,c->ni", two_loops(np.asarray(read.points, float))[0], CURRENTS)
    np.testing.assert_allclose(read["B_T"], exact, atol=1e-6 * np.abs(exact).max())
    stated = re.findall(r"(\S+) A in coil (\w+)", read.field_data["currents"][0])
    assert stated == [("1.5", "left"), ("-0.5", "right")]
    assert "dB_i/dx_j" in read.field_data["frame"][0]


def test_coil_by_coil(loops, tmp_path):
    read = pv.read(write_vti(loops, tmp_path / "loops.vti"))
    names = [f"{quantity}_{name}_{unit}" for quantity, unit in UNITS for name in ("left", "right")]
    assert sorted(read.point_data) == names
    flux, slope = two_loops(np.asarray(read.points, float))
    for k, name in enumerate(("left", "right")):
        np.testing.assert_allclose(read[f"B_{name}_T_per_A"], flux[k], atol=1e-6 * np.abs(flux[k]).max())
        ours = read[f"gradB_{name}_T_per_m_A"].reshape(-1, 3, 3)
        np.testing.assert_allclose(ours, slope[k], atol=1e-5 * np.abs(slope[k]).max())


def test_places_that_cannot_be_written(loops, tmp_path):
    with pytest.raises(InputError, match=r"end in \.vti"):
        write_vti(loops, tmp_path / "loops.vtk")
    (tmp_path / "file").touch()
    with pytest.raises(InputError) as caught:
        write_vti(loops, tmp_path / "file" / "loops.vti")
    assert caught.value.problems[0].where == str(tmp_path / "file" / "loops.vti")
    with pytest.raises(InputError):
        write_vti(loops, tmp_path / "loops.vti", [1.0, 2.0, 3.0])
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]
