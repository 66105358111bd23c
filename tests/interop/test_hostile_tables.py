"""Faults that mutated tables found: tracebacks, and a few letters that made a reader ask for gigabytes."""

import tracemalloc

import pytest

from fieldmap.control.identification import read_log
from fieldmap.errors import InputError, MapFileError
from fieldmap.interop import fit_map, read_mag_manip, read_measurements

HEADER = "x_mm,y_mm,z_mm,I_a_A,Bx_mT,By_mT,Bz_mT\n"
ROW = "1,2,3,1,0.1,0.2,0.3\n"
COIL = "dim_x: 2, dim_y: 2, dim_z: 2, min_x: 0, max_x: 1, min_y: 0, max_y: 1, min_z: 0, max_z: 1"
VECTORS = "data: [" + ", ".join(["[0.1, 0.2, 0.3]"] * 8) + "]"


@pytest.mark.parametrize(
    "text",
    [
        HEADER,
        "",
        HEADER + "x" * 200_000 + ROW,
        HEADER + ROW.replace("0.1", "1e308"),
        HEADER + ROW.replace("1,", "nan,"),
    ],
)
def test_readings(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_measurements(path)
    assert str(path) in caught.value.problems[0].where


def test_a_box_of_too_many_nodes(tmp_path):
    path = tmp_path / "a.csv"
    rows = [f"{x},{y},{z},1,0.1,0.2,0.3" for x in (0, 1, 1e9) for y in (0, 1, 2) for z in (0, 1, 2)]
    path.write_text(HEADER + "\n".join(rows) + "\n")
    with pytest.raises(InputError) as caught:
        fit_map(read_measurements(path), 1e-3)
    assert "nodes" in caught.value.problems[0].must_hold


LOG = "time (s),x (mm)\n0,1\n1,2\n2,3\n"


@pytest.mark.parametrize(
    "text",
    [LOG.replace("2,3", "2," + "3" * 200_000), LOG.replace("2,3", "2,1e308"), LOG.replace("2,3", "1e300,3")],
)
def test_logs(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    for read in (read_log, lambda one: read_log(one, {"x": ("x",)})):
        with pytest.raises(InputError):
            read(path)


def bomb():
    """Nine nested levels of nine names each: 4e8 texts for a reader that makes an array of them."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [
        f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]"
        for old, new in zip("abcdefgh", "bcdefghi", strict=True)
    ]
    return "\n".join(lines) + f"\nvfields: {{c: {{data: *i, {COIL}}}}}\n"


@pytest.mark.parametrize(
    "text",
    [
        "vfields: {}\n",
        "vfields: " + "[" * 20_000,
        f"vfields: {{c: {{{VECTORS}, {COIL}}}}}\n".replace("dim_x: 2", "dim_x: .inf"),
        f"vfields: {{c: {{{VECTORS}, {COIL}}}}}\n".replace("dim_x: 2", "dim_x: 1"),
        f"vfields: {{c: {{{VECTORS}, {COIL}}}}}\n".replace("max_x: 1", "max_x: .nan"),
        "vfields: {" + ", ".join(f"c{k}: {{{VECTORS}, {COIL}}}" for k in range(200)) + "}\n",
        bomb(),
    ],
    ids=["none", "deep", "infinitely many", "one node", "no box", "200 coils", "bomb"],
)
def test_vector_fields(tmp_path, text):
    pytest.importorskip("yaml", reason="PyYAML is not installed (pip install fieldmap[mag-manip])")
    path = tmp_path / "a.yaml"
    path.write_text(text)
    tracemalloc.start()
    try:
        with pytest.raises(MapFileError):
            read_mag_manip(path)
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()
