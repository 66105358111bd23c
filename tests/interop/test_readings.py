"""Files of readings in the dialects of instruments and programs, and the faults that a fit finds because no field has
them.

The field is that of two magnetic charges below the box, by Coulomb's law: free of curl and divergence, and computed
without the package.
"""

import warnings

import h5py
import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.interop import Measurements, fit_map, read_measurements

CHARGES = ((np.array([0.004, -0.003, -0.05]), 2e-6), (np.array([-0.02, 0.01, -0.06]), -1e-6))
GRID = np.stack(
    np.meshgrid(*[np.linspace(-0.01, 0.01, 6)] * 2, np.linspace(-0.008, 0.012, 5), indexing="ij"), -1
)
POINTS = GRID.reshape(-1, 3)


def field(points, nearer=0.0):
    """T, at 1 A. nearer: how far the charges are raised, m."""
    away = [(points - place - [0, 0, nearer], strength) for place, strength in CHARGES]
    return sum(strength * d / np.linalg.norm(d, axis=1)[:, None] ** 3 for d, strength in away)


B = 1.5 * field(POINTS)


def rows(*parts, between=",", decimal="."):
    table = np.hstack([np.asarray(part, dtype=float).reshape(len(POINTS), -1) for part in parts])
    return "\n".join(between.join(f"{v:.12g}".replace(".", decimal) for v in row) for row in table) + "\n"


AMPERES = np.full(len(POINTS), 1.5)
OPERA = """ 6 6 5 1
 1 X [MM]
 2 Y [MM]
 3 Z [CM]
 4 BX [GAUSS]
 5 BY [GAUSS]
 6 BZ [TESLA]
 0
"""
COMSOL = """% Model:              coil.mph
% Version:            COMSOL 6.1.0.252
% Dimension:          3
% Nodes:              180
% Expressions:        3
% Length unit:        mm
% x                       y                        z                        mf.Bx (mT)    mf.By (T)  mf.Bz (T)
"""
FILES = {
    "underscores": "x_mm,y_cm,z_m,I_coil_mA,Bx_G,By_mT,Bz_uT\n"
    + rows(POINTS * [1e3, 1e2, 1], 1e3 * AMPERES, B * [1e4, 1e3, 1e6]),
    "brackets, index, spare columns": "No.;x [mm];y [mm];z [mm];I_coil [A];Bx [mT];By [mT];Bz [mT];temperature [K]\n"
    + rows(range(180), 1e3 * POINTS, AMPERES, 1e3 * B, 300 * AMPERES, between=";", decimal=","),
    "slashes and tabs": "Bz/T\tBy/T\tBx/T\tx/mm\ty/mm\tz/mm\tcurrent coil/A\n"
    + rows(B[:, ::-1], 1e3 * POINTS, AMPERES, between="\t"),
    "a coil's name alone": "x_mm,y_mm,z_mm,coil (mA),Bx_T,By_T,Bz_T\n" + rows(1e3 * POINTS, 1e3 * AMPERES, B),
    "names in a remark": "# a probe\n# x_m y_m z_m I_coil_A Bx_T By_T Bz_T\n"
    + rows(POINTS, AMPERES, B, between=" "),
    "gradients": "x_m,y_m,z_m,I_coil_A,Bx_T,By_T,Bz_T,dBx_dx_T_per_m\n" + rows(POINTS, AMPERES, B, AMPERES),
    "constant current": "x_m,y_m,z_m,Bx_T,By_T,Bz_T\n" + rows(POINTS, B),
    "Opera": OPERA + rows(POINTS * [1e3, 1e3, 1e2], B * [1e4, 1e4, 1], between="  "),
    "COMSOL": COMSOL + rows(1e3 * POINTS, B * [1e3, 1, 1], between="    "),
    "COMSOL with commas": COMSOL.replace("unit:   ", "unit,").rsplit("% x", 1)[0]
    + "% X,Y,Z,mf.Bx (mT),mf.By (T),mf.Bz (T)\n"
    + rows(1e3 * POINTS, B * [1e3, 1, 1]),
    "rules and capitals": "X [mm]  Y [mm]  Z [mm]  Bx [T]  By [T]  Bz [T]\n----------------------------\n"
    + rows(1e3 * POINTS, B, between="   "),
}
NO_COLUMN = ("constant current", "Opera", "COMSOL", "COMSOL with commas", "rules and capitals")


@pytest.mark.parametrize("name", FILES)
def test_one_reader_takes_every_dialect(name, tmp_path):
    (tmp_path / "log.txt").write_text(FILES[name])
    found = read_measurements(
        str(tmp_path / "log.txt"), currents={"coil": 1.5} if name in NO_COLUMN else None
    )
    assert found.coil_names == ("coil",)
    np.testing.assert_allclose(found.points, POINTS, atol=1e-12)
    np.testing.assert_allclose(found.flux_density, B, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(found.currents[:, 0], AMPERES, rtol=1e-12)
    spare = {"brackets, index, spare columns": ("No.", "temperature"), "gradients": ("dBx_dx",)}
    assert found.unread == spare.get(name, ())


def test_a_field_mesh_of_another_program(tmp_path):
    """As openPMD-beamphysics writes it: complex numbers, and a constant component as an attribute."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = pytest.importorskip("beamphysics").FieldMesh
    along = {f"magneticField/{axis}": B[:, k].reshape(6, 6, 5) for k, axis in enumerate("xyz")}
    along["magneticField/y"] = np.full((6, 6, 5), 0.25)
    attributes = {
        "eleAnchorPt": "beginning",
        "gridGeometry": "rectangular",
        "axisLabels": ("x", "y", "z"),
        "gridLowerBound": (0, 0, 0),
        "gridOriginOffset": (-0.01, -0.01, -0.008),
        "gridSpacing": (0.004, 0.004, 0.005),
        "gridSize": (6, 6, 5),
        "harmonic": 0,
        "fundamentalFrequency": 0,
        "fieldScale": 2.0,
    }
    path = tmp_path / "mesh.h5"
    mesh(data={"attrs": attributes, "components": along}).write(str(path))
    found = read_measurements(path, currents={"coil": 1.5})
    np.testing.assert_allclose(found.points, POINTS, atol=1e-12)
    np.testing.assert_allclose(found.flux_density, 2 * np.where([True, False, True], B, 0.25), rtol=1e-12)
    for spoil in ("gridSize", "gridGeometry", "axisLabels"):
        with h5py.File(path, "r+") as file:
            kept = file["ExternalFieldPath/1"].attrs[spoil]
            file["ExternalFieldPath/1"].attrs[spoil] = (6, 6, 50) if spoil == "gridSize" else b"cylindrical"
        with pytest.raises(InputError) as caught:
            read_measurements(path, currents={"coil": 1.5})
        assert caught.value.problems[0].where == str(path)
        with h5py.File(path, "r+") as file:
            file["ExternalFieldPath/1"].attrs[spoil] = kept
    with pytest.raises(InputError) as caught:
        read_measurements(path)
    assert caught.value.problems[0].where == f"{path}: currents"


HEADER = "Bz_mT,x_mm,y_mm,z_m,Bx_uT,By_T,I_left_A,I_the right one_A\n"
ROW = "1.5,10,-20,0.03,7,2e-3,1,-2\n"


@pytest.mark.parametrize(
    ("text", "wheres"),
    [
        ("", [""]),
        (HEADER, [""]),
        (ROW, [":1"]),
        ("x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT\n1,2,3,4,5,6\n", [": currents"]),
        (HEADER.replace("Bz_mT", "Bz_furlong") + ROW, [": column Bz_furlong"]),
        (HEADER.replace("Bz_mT", "Bz [furlong]") + ROW, [": column Bz"]),
        (HEADER.replace("Bz_mT", "Bz_A") + ROW, [": column Bz"]),
        (HEADER.replace("I_left_A", "I_left") + ROW, [": column I_left"]),
        (HEADER.replace("I_left_A", "current the right one_mA") + ROW, [": column I_the right one"]),
        (HEADER.replace("y_mm", "x_m") + ROW, [": x", ": y"]),
        (HEADER + "1,2,3\n1,2,3,4,five,6,nan,8\n", [":2", ":3"]),
    ],
)
def test_every_mistake_of_a_file_is_named(tmp_path, text, wheres):
    path = tmp_path / "read.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_measurements(path)
    assert [one.where for one in caught.value.problems] == [f"{path}{where}" for where in wheres]


def test_a_current_is_stated_once(tmp_path):
    """In a column or as a constant; coils are in the order of columns, constants behind them."""
    path = tmp_path / "read.csv"
    path.write_text(HEADER + ROW)
    for name in ("left", "the right one"):
        with pytest.raises(InputError) as caught:
            read_measurements(path, {name: 1.0})
        assert [one.where for one in caught.value.problems] == [f"{path}: column I_{name}"]
    found = read_measurements(path, {"middle": 0.5})
    assert found.coil_names == ("left", "the right one", "middle")
    assert found.currents.tolist() == [[1.0, -2.0, 0.5]]
    np.testing.assert_allclose(found.points, [[0.01, -0.02, 0.03]], rtol=1e-15)
    np.testing.assert_allclose(found.flux_density, [[7e-6, 2e-3, 1.5e-3]], rtol=1e-15)
    assert (found.lines, found.unread, found.where(0)) == ((2,), (), f"{path}:2")


@pytest.mark.parametrize(
    ("largest", "fits"), [(1e30, True), (1.001e30, False), (np.nan, False), (-1.001e30, False)]
)
@pytest.mark.parametrize("name", ["points", "currents", "flux_density"])
def test_numbers_of_arrays_are_checked(name, largest, fits):
    given = {"points": np.zeros((2, 3)), "currents": np.zeros((2, 1)), "flux_density": np.zeros((2, 3))}
    given[name][1, 0] = largest
    if fits:
        assert getattr(Measurements(("coil",), **given), name)[1, 0] == largest
        return
    with pytest.raises(InputError) as caught:
        Measurements(("coil",), **given)
    assert [one.where for one in caught.value.problems] == [f"Measurements, {name}"]
    for shape in ((3, given[name].shape[1]), (2, 4)):
        with pytest.raises(InputError) as caught:
            Measurements(("coil",), **given | {name: np.zeros(shape)})
        assert all(one.received.startswith("shape") for one in caught.value.problems)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError) as caught:
        read_measurements(tmp_path / "none.csv")
    assert caught.value.problems[0].where == str(tmp_path / "none.csv")


def measured(flux_density, points=POINTS, **more):
    return Measurements(("coil",), points, np.full((len(points), 1), 1.5), flux_density, **more)


def with_noise(flux_density):
    return flux_density + 1e-4 * np.abs(B).max() * np.random.default_rng(1).normal(size=flux_density.shape)


def test_nodes_in_any_order_and_missing_ones():
    order = np.random.default_rng(0).permutation(len(POINTS))[:150]
    whole, some = (
        fit_map(measured(B[k], POINTS[k]), 0.005, degree=5) for k in (np.arange(len(POINTS)), order)
    )
    for fit in (whole, some):
        nodes = fit.data.grid.points()
        exact = 1.5 * field(nodes)
        apart = np.abs(1.5 * fit.data.flux_density.reshape(-1, 3) - exact).max(axis=1)
        assert apart[np.abs(nodes).max(axis=1) < 0.007].max() < 2e-3 * np.abs(exact).max()


@pytest.mark.parametrize("factor", [3.0, -1.0, 1e4, 0.0])
def test_a_wild_reading_is_named_with_its_line(factor):
    """Two readings: the sensor slipped or was reversed, the decimal point is wrong, or nothing was read."""
    spoilt = with_noise(B)
    for k in (37, 101):
        spoilt[k] *= factor
    lines = tuple(range(2, 182))
    with pytest.raises(InputError) as caught:
        fit_map(measured(spoilt, source="log.csv", lines=lines), 0.005)
    assert [one.where for one in caught.value.problems] == ["log.csv:39", "log.csv:103"]
    fit_map(measured(np.delete(spoilt, (37, 101), 0), np.delete(POINTS, (37, 101), 0)), 0.005)


@pytest.mark.parametrize("k", [0, 54])
def test_a_wild_reading_of_a_steep_field_does_not_hide_behind_a_low_degree(k):
    spoilt = 1.5 * field(POINTS, 0.031)
    spoilt[k] *= 3
    with pytest.raises(InputError) as caught:
        fit_map(measured(spoilt), 0.005)
    assert [one.where for one in caught.value.problems] == [f"Measurements, row {k}"]


@pytest.mark.parametrize(
    ("order", "signs", "named"),
    [
        ((1, 0, 2), (1, 1, 1), "By, Bx, Bz"),
        ((2, 1, 0), (1, 1, 1), "Bz, By, Bx"),
        ((0, 1, 2), (1, 1, -1), "Bx, By, -Bz"),
        ((1, 0, 2), (1, -1, 1), "-By, Bx, Bz"),
    ],
)
def test_exchanged_and_turned_components_are_named(order, signs, named):
    turned = with_noise(B)[:, order] * signs
    with pytest.raises(InputError) as caught:
        fit_map(measured(turned, source="log.csv"), 0.005)
    (problem,) = caught.value.problems
    assert problem.where == "log.csv"
    assert named in problem.remedy


def test_readings_that_are_no_field():
    noise = np.random.default_rng(3).normal(size=B.shape)
    with pytest.raises(InputError) as caught:
        fit_map(measured(noise), 0.005)
    assert "Measurements, row" in caught.value.problems[0].received


@pytest.mark.parametrize("axis", [0, 2])
def test_one_plane_is_named(axis):
    flat = POINTS.copy()
    flat[:, axis] = 0.003
    with pytest.raises(InputError) as caught:
        fit_map(measured(1.5 * field(flat), flat, source="log.csv"), 0.005)
    (problem,) = caught.value.problems
    assert problem.where == "log.csv"
    assert f"plane {'xyz'[axis]} = 0.003 m" in problem.received
