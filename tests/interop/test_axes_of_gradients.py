"""A gradient whose nine entries differ, through every export: [i, j] is dB_i/dx_j.

No field in air has one: its gradient is symmetric, and would hide a transposition.
"""

import csv
import json

import h5py
import numpy as np
import pytest

from fieldmap.interop import write_csv
from fieldmap.io import FieldSource
from fieldmap.io.answers import probe
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData, write_map

SLOPE = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, -9.0]])
# Three different numbers of nodes and spacings, so that no two axes can be exchanged unseen.
GRID = Grid([-0.02, -0.01, -0.12], [0.01, 0.004, 0.006], (3, 4, 5))
CURRENTS = np.array([1.5, 0.25])
# B = (1.5 - 2 x 0.25) SLOPE x.
TOTAL = 1.0 * SLOPE
POINT = np.array([[-0.001, -0.002, -0.1]])


@pytest.fixture(scope="module")
def data():
    points, coils = GRID.points(), np.array([1.0, -2.0])
    flux = coils[:, None, None] * (points @ SLOPE.T)
    slope = coils[:, None, None, None] * np.broadcast_to(SLOPE, (len(points), 3, 3))
    arrays = {
        "flux_density": flux.reshape(2, *GRID.shape, 3),
        "gradient": slope.reshape(2, *GRID.shape, 3, 3),
    }
    return MapData(GRID, ("left", "right"), np.ones(2), **arrays)


@pytest.fixture(scope="module")
def skew(data):
    return interpolate(data, kind="hermite")


def close(found, exact):
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


def test_lookup(skew):
    close(skew.gradient(POINT, CURRENTS), [TOTAL])
    close(skew.unit_gradient(POINT), [[SLOPE, -2 * SLOPE]])


def test_map_file(data, tmp_path):
    """The record component xy of gradB is dB_x/dy."""
    write_map(tmp_path / "skew.h5", data)
    with h5py.File(tmp_path / "skew.h5") as file:
        for coil, factor in (("left", 1.0), ("right", -2.0)):
            mesh = file[f"data/0/meshes/gradB_{coil}"]
            for i, one in enumerate("xyz"):
                for j, other in enumerate("xyz"):
                    close(mesh[one + other][...], factor * SLOPE[i, j])


@pytest.mark.parametrize("fixed", [True, False])
def test_csv(skew, tmp_path, fixed):
    path = write_csv(skew, tmp_path / "skew.csv", CURRENTS if fixed else None)
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    exact = [TOTAL] if fixed else [SLOPE, -2 * SLOPE]
    for row, slope in zip((rows[0], rows[-1]), (exact[0], exact[-1]), strict=True):
        close([[float(row[f"dB{i}_d{j}_T_per_m"]) for j in "xyz"] for i in "xyz"], slope)


def test_vti(skew, tmp_path):
    pv = pytest.importorskip("pyvista", reason='PyVista is not installed (pip install "fieldmap[plot]")')
    from fieldmap.plot.vti import write_vti

    read = pv.read(write_vti(skew, tmp_path / "at.vti", CURRENTS))
    close(read["gradB_T_per_m"], np.tile(TOTAL.ravel(), (60, 1)))
    read = pv.read(write_vti(skew, tmp_path / "each.vti"))
    close(read["gradB_right_T_per_m_A"], np.tile(-2 * SLOPE.ravel(), (60, 1)))


def test_xarray(skew):
    pytest.importorskip("xarray", reason='xarray is not installed (pip install "fieldmap[xarray]")')
    fixed, each = skew.to_xarray(CURRENTS), skew.to_xarray()
    for i, one in enumerate("xyz"):
        for j, other in enumerate("xyz"):
            axes = {"component": one, "direction": other}
            close(fixed.gradient.sel(axes), TOTAL[i, j])
            close(each.unit_gradient.sel(axes | {"coil": "right"}), -2 * SLOPE[i, j])


def test_json_of_a_probe(skew):
    """With the force F_j = m_i dB_i/dx_j and the torque m x B on a moment."""
    bounds = (skew.lower, skew.upper)
    source = FieldSource("skew", "", "map", skew.coil_names, bounds, None, None, None, lambda: skew)
    moment = np.array([1.0, 10.0, 100.0])
    (answer,) = json.loads(json.dumps(probe(source, POINT, CURRENTS, moment).to_dicts()))
    close(answer["gradient"], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, -9.0]])
    close(answer["force"], [741.0, 852.0, -837.0])
    # B = SLOPE (-0.001, -0.002, -0.1) = (-0.305, -0.614, 0.877).
    close(answer["B"], [-0.305, -0.614, 0.877])
    close(answer["torque"], [10 * 0.877 + 100 * 0.614, -100 * 0.305 - 0.877, -0.614 + 10 * 0.305])
