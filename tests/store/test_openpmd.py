"""What other programs see: the openPMD validator, and openPMD-beamphysics' FieldMesh."""

import re
import sys
import time
import warnings

import h5py
import numpy as np
import pytest

from fieldmap.store import write_map


def validated(path, monkeypatch, capsys):
    """Exit status of the validator, errors and warnings, and what it prints."""
    with warnings.catch_warnings(), monkeypatch.context() as patch:
        warnings.simplefilter("ignore")  # of its own, which are not ours to mend
        from openpmd_validator.check_h5 import main

        patch.setattr(sys, "argv", ["check", "-i", str(path)])
        with pytest.raises(SystemExit) as ended:
            main()
    printed = capsys.readouterr().out
    return ended.value.code, re.search(r"Result: (\d+) .* (\d+) ", printed).groups(), printed


@pytest.fixture
def file(make_map, tmp_path):
    data = make_map(coil_names=("1", "upper left", "Spule ø"), reference_current=2.0)
    with h5py.File(write_map(tmp_path / "map.h5", data)) as opened:
        yield opened


def test_validator_finds_no_error_and_no_warning(make_map, tmp_path, monkeypatch, capsys):
    path = write_map(tmp_path / "map.h5", make_map(coil_names=("1", "upper left", "Spule ø")))
    code, found, printed = validated(path, monkeypatch, capsys)
    assert found == ("0", "0"), printed
    assert code == 0


def test_validator_would_find_an_error(data, tmp_path, monkeypatch, capsys):
    path = write_map(tmp_path / "map.h5", data)
    with h5py.File(path, "r+") as opened:
        del opened["/data/0/meshes/B_1"].attrs["unitDimension"]
    code, found, _ = validated(path, monkeypatch, capsys)
    assert code == 1
    assert found[0] != "0"


def test_fieldmesh_reads_every_coil_in_tesla(make_map, file):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own imports, which are not ours to mend
        from beamphysics import FieldMesh
    data = make_map(coil_names=("1", "upper left", "Spule ø"), reference_current=2.0)
    assert list(file["ExternalFieldPath"]) == ["1", "2", "3"]
    for number, record in enumerate(["1", "upper_left", "Spule__"]):
        mesh = FieldMesh(file[f"ExternalFieldPath/{number + 1}"])
        assert mesh.attrs["masterParameter"] == f"I_{record}"
        for c, name in enumerate(("Bx", "By", "Bz")):
            np.testing.assert_allclose(mesh[name], 2.0 * data.flux_density[number, ..., c], rtol=1e-15)
        for c, name in enumerate("xyz"):
            np.testing.assert_allclose(mesh.coord_vec(name), data.grid.axes[c], atol=1e-15)


def test_total_is_the_sum_over_the_coils(make_map, file):
    data = make_map(coil_names=("1", "upper left", "Spule ø"), reference_current=2.0)
    for c, name in enumerate("xyz"):
        total = 2.0 * data.flux_density[..., c].sum(axis=0)
        np.testing.assert_allclose(file[f"/data/0/meshes/B/{name}"][()], total, rtol=1e-14, atol=1e-15)


def test_gradient_component_xy_is_dbx_by_dy(make_map, file):
    data = make_map(coil_names=("1", "upper left", "Spule ø"), reference_current=2.0)
    record = file["/data/0/meshes/gradB_upper_left"]
    assert sorted(record) == sorted(i + j for i in "xyz" for j in "xyz")
    np.testing.assert_array_equal(record.attrs["unitDimension"], [-1, 1, -2, -1, 0, 0, 0])
    np.testing.assert_allclose(record["xy"][()], 2.0 * data.gradient[1, ..., 0, 1], rtol=1e-15)
    np.testing.assert_allclose(record["zx"][()], 2.0 * data.gradient[1, ..., 2, 0], rtol=1e-15)
    assert record.attrs["referenceCurrent"] == 2.0
    assert record.attrs["coilName"].decode() == "upper left"


def test_strings_have_fixed_length_and_numbers_a_checksum(file):
    seen = {"strings": 0, "numbers": 0}

    def look(name, item):
        for key in item.attrs:
            kind = h5py.check_string_dtype(item.attrs.get_id(key).dtype)
            if kind is not None:
                seen["strings"] += 1
                assert kind.length is not None, f"{name}.{key} has variable length"
        if isinstance(item, h5py.Dataset):
            kind = h5py.check_string_dtype(item.dtype)
            assert kind is None or kind.length is not None, name
            if item.dtype == np.float64:
                seen["numbers"] += 1
                assert item.fletcher32, name
                assert np.isnan(item.fillvalue), f"{name}: a block that is missing must be no number"

    file.visititems(look)
    look("/", file)
    assert seen["strings"] > 50
    assert seen["numbers"] == 3 + 3 * 12


def test_the_same_map_has_the_same_bytes_a_second_later(data, tmp_path):
    first = write_map(tmp_path / "first.h5", data).read_bytes()
    time.sleep(1.1)  # what HDF5 counts in, where it keeps times
    assert write_map(tmp_path / "second.h5", data).read_bytes() == first


def test_meshes_state_grid_axes_and_order(file, data):
    for record in file["/data/0/meshes"].values():
        assert record.attrs["dataOrder"] == b"C"
        assert [label.decode() for label in record.attrs["axisLabels"]] == ["x", "y", "z"]
        np.testing.assert_array_equal(record.attrs["gridGlobalOffset"], data.grid.lower)
        np.testing.assert_array_equal(record.attrs["gridSpacing"], data.grid.spacing)
    np.testing.assert_array_equal(file["ExternalFieldPath/1"].attrs["gridLowerBound"], [0, 0, 0])
    link = file["ExternalFieldPath/1"].get("magneticField", getlink=True)
    assert isinstance(link, h5py.SoftLink)


def test_sources_can_be_read_with_their_hashes(file):
    import hashlib

    for name, text in (("recipe", "spacing_mm = 4\n"), ("device", 'title = "µ-metal"\n')):
        stored = file[f"/fieldmap/{name}"]
        assert stored[()].decode() == text
        assert stored.attrs["sha256"].decode() == hashlib.sha256(text.encode()).hexdigest()
    assert re.search(r'"numpy": "2"', file["/fieldmap/header"][()].decode())
    assert re.search(r'"iterations": 7', file["/fieldmap/report"][()].decode())
