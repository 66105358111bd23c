"""B-H curves as makers print them: from the origin, in files of any dialect, and with typical mistakes of copying.

The curve is the formula J = Js H / (H + a) with Js = 2 T and a = 500 A/m, not a table of the package.
"""

import re

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import InputError

H = np.array([0.0, 100.0, 300.0, 1000.0, 3000.0, 1e4, 3e4, 1e5])
J = 2.0 * H / (H + 500.0)
B = J + mu_0 * H
COIL = fm.CircularCoil("a", 0.01, 0.02, 0.01, 100)
DEVICE = """format = 1
name = "one"
title = "One coil"
[[coil]]
kind = "circular"
name = "a"
inner_radius_mm = 10
outer_radius_mm = 20
height_mm = 10
turns = 100
"""


def written(rows, head="", between=",", decimal="."):
    lines = [between.join(f"{value:.9g}".replace(".", decimal) for value in row) for row in rows]
    return head + "\n".join(lines) + "\n"


def numbered(h, b):
    return zip(range(1, 9), h, b, b / np.maximum(mu_0 * h, 1e-9), strict=True)


SHEETS = {
    "no names": written(zip(H, B, strict=True)),
    "semicolons, decimal commas": written(zip(H, B, strict=True), "H [A/m];B [T]\n", ";", ","),
    "blanks, decimal commas, no names": written(zip(H[1:], B[1:], strict=True), "", "  ", ","),
    "kA/m behind a slash": written(zip(H / 1e3, B, strict=True), "H/kA/m\tB/T\n", "\t"),
    "units in words": written(zip(1e3 * B, H, strict=True), "B in mT,H in A/m\n"),
    "gauss and oersted": written(zip(H * 4e-3 * np.pi, 1e4 * B, strict=True), "H (Oe), B (G)\n", ", "),
    "keys of this package": written(zip(H, B, strict=True), "# a maker\nH_A_per_m,B_T\n"),
    "names in a remark": written(zip(H, B, strict=True), "# H B\n", " "),
    "more columns": written(numbered(H, B), "No.;H (A/m);B (T);mu_r\n", ";", ","),
    "a title, and units below the names": written(
        zip(H / 1e3, B, strict=True), "M-19, 0.35 mm\nDC curve, measured\nH;B\nkA/m;T\n---;---\n", ";", ","
    ),
    "sentences": written(zip(H, B, strict=True), "Magnetic field strength H (A/m);Flux density B (T)\n", ";"),
}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("sheet", SHEETS)
def test_a_data_sheet_is_a_material_in_one_line(sheet, encoding, tmp_path):
    """In Python and in a device file; the origin, which every curve passes through, is left out."""
    (tmp_path / "steel.csv").write_text(SHEETS[sheet], encoding=encoding)
    (tmp_path / "one.toml").write_text(
        DEVICE + '[material]\niron = {kind = "bh_table", file = "steel.csv"}\n'
    )
    device = fm.read_device(tmp_path / "one.toml")
    for steel in (fm.material(str(tmp_path / "steel.csv")), device.materials["iron"]):
        np.testing.assert_allclose(steel.h, H[1:], rtol=1e-7)
        np.testing.assert_allclose(steel.b, B[1:], rtol=1e-7)
        assert steel.initial_mu_r == pytest.approx(B[1] / (mu_0 * 100.0))
    assert device.included == {"steel.csv": SHEETS[sheet]}
    assert (
        fm.read_device(device.to_toml()).materials["iron"].b.tolist() == device.materials["iron"].b.tolist()
    )


def told(h, b):
    with pytest.raises(InputError) as caught:
        fm.Device("one", "", [COIL], materials={"iron": fm.BHTable("iron", h, b)})
    (in_python,) = caught.value.problems
    numbers = f"H_A_per_m = {[float(x) for x in h]}\nB_T = {[float(x) for x in b]}\n"
    with pytest.raises(InputError) as caught:
        fm.read_device(DEVICE + '[material.iron]\nkind = "bh_table"\n' + numbers)
    (problem,) = caught.value.problems
    assert problem.where.endswith("material.iron.B_T")
    assert (problem.must_hold, problem.remedy[:16]) == (in_python.must_hold, in_python.remedy[:16])
    # A table in Python does not count the origin as a point.
    assert problem.received.partition("(")[2] == in_python.received.partition("(")[2]
    return problem


SATURATED = np.append(B, B[-1] + 0.9 * mu_0 * 1e5)


@pytest.mark.parametrize(
    ("h", "b", "rule", "point", "remedy"),
    [
        (B, H, "polarisation", 2, "exchange"),
        (H, 1e4 * B, "polarisation", 2, "10 000"),
        (H, 1e3 * B, "polarisation", 2, "by 1000"),
        (1e-3 * H[:-1], B[:-1], "B / (mu0 H)", 2, "H by 1000"),
        (np.append(H, 2e5), np.append(J, J[-1] + 0.001), "slope", 8, "add mu0 H"),
        (np.append(H, 2e5), SATURATED, "slope", 9, "end the table at point 8"),
        (np.append(H, 2e5), np.append(B, 4.0), "polarisation", 9, "correct the point"),
    ],
    ids=["exchanged", "gauss", "mT", "kA/m", "polarisation", "falls below mu0", "above 3 T"],
)
def test_a_mistake_is_named_with_its_point(h, b, rule, point, remedy):
    problem = told(h, b)
    assert rule in problem.must_hold
    assert int(re.findall(r"points? (\d+)", problem.received)[-1]) == point
    assert remedy in problem.remedy
    assert ("looks as if" in problem.remedy) == (
        remedy not in ("exchange", "end the table at point 8", "correct the point")
    )


def test_a_curve_has_no_remanence():
    """(0, 0) is the origin; (0, 0.8 T) is the descending branch of a loop."""
    curve = fm.BHTable("steel", H, B)
    same = fm.BHTable("steel", H[1:], B[1:])
    assert (curve.h.tolist(), curve.initial_mu_r) == (same.h.tolist(), same.initial_mu_r)
    problem = told(H, B + 0.8)
    assert "0.8 T at point 1" in problem.received


@pytest.mark.parametrize(
    ("text", "wheres"),
    [
        ("H (furlong),B (mm)\n1,2\n2,3\n", ["column H", "column B"]),
        ("H (A/m),B (T)\n1,x\n2,3\n", ["2"]),
        ("1,2,3\n2,3,4\n", ["1"]),
        ("field,flux (T)\n1,2\n2,3\n", ["B"]),
        ("H,B\n100,1.0\n200,0.9\n", ["B"]),
        ("H,B\n", [""]),
    ],
)
def test_all_mistakes_of_a_sheet(text, wheres, tmp_path):
    path = tmp_path / "steel.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        fm.material(path)
    assert [one.where for one in caught.value.problems] == [
        f"{path}:{where}" if where.isdigit() else f"{path}: {where}" if where else str(path)
        for where in wheres
    ]


EXTREME = {
    "nickel-iron, permeability 4e5": (
        [0.1, 0.2, 0.4, 0.8, 1.6, 8, 80],
        [0.02, 0.12, 0.4, 0.6, 0.7, 0.78, 0.8],
    ),
    "oriented silicon iron": (
        [2, 5, 10, 15, 30, 100, 800, 1e4],
        [0.1, 0.6, 1.4, 1.62, 1.75, 1.85, 1.94, 2.04],
    ),
    "iron-cobalt": ([4, 8, 16, 24, 40, 160, 800, 4000], [0.02, 0.3, 1.9, 2.1, 2.2, 2.28, 2.33, 2.38]),
    "ferrite": ([5, 10, 20, 50, 100, 250, 1000], [0.02, 0.06, 0.15, 0.28, 0.35, 0.4, 0.45]),
    "iron powder": ([100, 1000, 5000, 2e4, 1e5], [0.005, 0.06, 0.28, 0.8, 1.4]),
}


@pytest.mark.parametrize("name", EXTREME)
def test_the_softest_and_the_strongest_materials_are_taken(name):
    """Rounded values of the usual size pass; in mT or gauss, or with H and B exchanged, they are refused."""
    h, b = map(np.array, EXTREME[name])
    fm.BHTable("iron", h, b).require_physical()
    for wrong in ((h, 1e3 * b), (h, 1e4 * b), (b, h)):
        with pytest.raises(InputError):
            fm.BHTable("iron", *wrong).require_physical()
