"""Encodings of text files: UTF-8 and marked UTF-16 are read, others are refused or, in tables, read as latin-1."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.control.identification import ROLES, read_log
from fieldmap.errors import DeviceFileError, InputError, MapFileError, ScenarioError
from fieldmap.file_contents import file_in_words, read_text
from fieldmap.interop import read_mag_manip, read_measurements

READ = ("utf-8", "utf-8-sig", "utf-16")
TABLE = "x_mm,y_mm,z_mm,I_ä_A,Bx_mT,By_mT,Bz_mT\n" + "".join(f"{k},0,0,1,0,0,{k}\n" for k in range(4))
LOG = "# °\ntime (s),control (V),position (mm)\n" + "".join(f"{k},{k % 2},{k}\n" for k in range(4))
DEVICE = """format = 1
name = "a"
title = "ä"
[[coil]]
name = "a"
kind = "circular"
turns = 5
inner_radius_mm = 9
outer_radius_mm = 10
height_mm = 1
"""
YAML = 'name: "ä"\nvfields: {}\n'


@pytest.mark.parametrize("encoding", [*READ, "latin-1"])
def test_tables_are_read_in_any_of_four_encodings(tmp_path, encoding):
    path = tmp_path / "table.csv"
    path.write_bytes(TABLE.encode(encoding))
    read = read_measurements(path)
    assert read.coil_names == ("ä",)
    np.testing.assert_allclose(read.flux_density[:, 2], [0, 1e-3, 2e-3, 3e-3])
    path.write_bytes(LOG.encode(encoding))
    np.testing.assert_allclose(read_log(path, ROLES).signals["output"], [0, 1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize("encoding", READ)
def test_a_device_file_is_read_in_unicode(tmp_path, encoding):
    (tmp_path / "a.toml").write_bytes(DEVICE.encode(encoding))
    assert fm.read_device(tmp_path / "a.toml").title == "ä"


@pytest.mark.parametrize(
    ("read", "text", "encoding", "error"),
    [
        (fm.read_device, DEVICE, "latin-1", DeviceFileError),
        (fm.read_device, DEVICE, "utf-16-le", DeviceFileError),
        (fm.read_device, "format = 1", "utf-16-be", DeviceFileError),
        (fm.simulate, DEVICE, "latin-1", ScenarioError),
        (read_mag_manip, YAML, "latin-1", MapFileError),
        (read_measurements, TABLE, "utf-16-le", InputError),
        (lambda path: read_log(path, ROLES), LOG, "utf-16-be", InputError),
    ],
)
def test_what_is_no_text_of_these_is_refused(tmp_path, read, text, encoding, error):
    path = tmp_path / "file.toml"
    path.write_bytes(text.encode(encoding))
    with pytest.raises(error) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert problem.where == str(path)
    assert problem.must_hold == "must be a text in UTF-8"
    assert problem.received.endswith("not of this encoding" if encoding == "latin-1" else "(BOM)")
    if encoding == "latin-1":
        assert "in line 3 " in problem.received or read is read_mag_manip
    assert "UTF-8" in problem.remedy


def test_line_ends_stay(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfa\r\nb\n")
    assert read_text(tmp_path / "a") == "a\r\nb\n"
    with pytest.raises(InputError) as caught:
        read_text(tmp_path)
    assert caught.value.problems[0].where == str(tmp_path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "an empty file"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"\x89PNG", "a picture"),
        (b"PK\x03\x04", "a zip archive"),
        (b"\x7fELF\x02", "a binary file"),
        (b"time\0", "a binary file"),
        (b"\xef\xbb\xbftime,x\r\n", "a text that begins with 'time,x'"),
        ("time,x\r\n".encode("utf-16"), "a text that begins with 'time,x'"),
        (b"\n\n", "a text that begins with ''"),
        (b"\xff\xfe", "a file without a text"),
    ],
)
def test_what_a_file_is(tmp_path, data, words):
    (tmp_path / "file").write_bytes(data)
    assert file_in_words(tmp_path / "file") == words


def test_a_map_that_is_a_text_is_said_to_be_one(tmp_path):
    (tmp_path / "a.h5").write_text("time,x\n" * 100)
    with pytest.raises(MapFileError) as caught:
        fm.open_map(tmp_path / "a.h5")
    (problem,) = caught.value.problems
    assert problem.where == str(tmp_path / "a.h5")
    assert "HDF5" in problem.must_hold
    assert problem.received == "a text that begins with 'time,x'"
