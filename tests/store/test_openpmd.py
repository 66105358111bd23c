"""Maps in other programs: the openPMD validator, and openPMD-beamphysics' FieldMesh."""

import hashlib
import json
import re
import sys
import time
import warnings

import h5py
import numpy as np
import pytest

from fieldmap.store import write_map
from tests.store.conftest import make_model, make_saturating


def validated(path, monkeypatch, capsys):
    """The validator's exit status, errors, warnings, and printed text."""
    with warnings.catch_warnings(), monkeypatch.context() as patch:
        warnings.simplefilter("ignore")  # its own warnings, which we cannot mend
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
        warnings.simplefilter("ignore")  # warnings of its own imports, which we cannot mend
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
    time.sleep(1.1)  # HDF5 keeps times in seconds
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


def attributes(item):
    return {name: value.decode() if isinstance(value, bytes) else value for name, value in item.attrs.items()}


def same(found, wanted):
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


def test_every_attribute_of_the_standard(file):
    """Powers of length, mass, time, current, temperature, amount and luminous intensity: T is kg / (s^2 A)."""
    same(
        attributes(file),
        {
            "openPMD": "1.1.0",
            "openPMDextension": 0,
            "basePath": "/data/%T/",
            "meshesPath": "meshes/",
            "iterationEncoding": "groupBased",
            "iterationFormat": "/data/%T/",
            "author": "fieldmap",
            "software": "fieldmap",
            "softwareVersion": "0.1.0",
            "softwareDependencies": "fieldmap 0.1.0; numpy 2",
            "date": "2026-01-02 03:04:05 +0000",
            "comment": "A map for tests, 20 °C",
            "externalFieldPath": "/ExternalFieldPath/%T/",
        },
    )
    same(attributes(file["/data/0"]), {"time": 0.0, "dt": 0.0, "timeUnitSI": 1.0})
    grid = {"gridSpacing": [0.004, 0.005, 0.0031], "gridGlobalOffset": [-0.02, 0.01, -0.14]}
    units = {"B": [0, 1, -2, -1, 0, 0, 0], "gradB": [-1, 1, -2, -1, 0, 0, 0]}
    comments = {
        "B": "total, every coil at its reference current",
        "B_upper_left": 'flux density of coil "upper left" alone at 2 A',
        "gradB_upper_left": 'gradient of the flux density of coil "upper left" alone at 2 A; component xy is dB_x/dy',
    }
    for name, comment in comments.items():
        record, unit = file[f"/data/0/meshes/{name}"], units[name.split("_")[0]]
        of = (
            {"referenceCurrent": 2.0, "coilName": "upper left"}
            if "_" in name
            else {"referenceCurrent": [2.0] * 3}
        )
        about = {"geometry": "cartesian", "dataOrder": "C", "axisLabels": np.array([b"x", b"y", b"z"])}
        about |= {"gridUnitSI": 1.0, "timeOffset": 0.0, "unitDimension": unit, "comment": comment}
        same(attributes(record), grid | of | about)
        for component in record.values():
            same(attributes(component), {"unitSI": 1.0, "position": [0.0] * 3, "unitDimension": unit})
            assert component.chunks == (4, 3, 5)
    same(
        attributes(file["ExternalFieldPath/2"]),
        {
            "eleAnchorPt": "beginning",
            "gridGeometry": "rectangular",
            "axisLabels": np.array([b"x", b"y", b"z"]),
            "gridLowerBound": [0, 0, 0],
            "gridOriginOffset": [-0.02, 0.01, -0.14],
            "gridSpacing": [0.004, 0.005, 0.0031],
            "gridSize": [4, 3, 5],
            "harmonic": 0,
            "fieldScale": 1.0,
            "masterParameter": "I_upper_left",
        },
    )


def test_chunks_are_whole_planes(make_map, tmp_path):
    with h5py.File(write_map(tmp_path / "map.h5", make_map(shape=(9, 20, 30)))) as opened:
        assert opened["/data/0/meshes/B_1/x"].chunks == (1, 20, 30)
        assert opened["/fieldmap/completion/chunks"][()].tolist() == [1] * 9
        assert opened["/fieldmap/completion"].attrs["complete"] == 1


def test_fields_of_iron_and_a_background_for_other_programs(tmp_path):
    data = make_saturating()
    with h5py.File(write_map(tmp_path / "map.h5", data)) as opened:
        assert opened["/fieldmap"].attrs["format_version"] == 2
        records = ["upper_left", "1", *(f"iron_mode_{k}" for k in (1, 2, 3, 4, 5)), "no_current"]
        scales, weights = [0.3, 7.0, *[1.0] * 6], [1, 1, 0.5, -1.5, 2.5, 3.5, -4.5, 1]
        total = np.zeros((4, 3, 5, 3))
        for number, (record, scale) in enumerate(zip(records, scales, strict=True)):
            link = opened[f"/ExternalFieldPath/{number + 1}"]
            assert link.attrs["masterParameter"].decode() == (
                "none" if record == "no_current" else f"I_{record}"
            )
            assert link.get("magneticField", getlink=True).path == f"/data/0/meshes/B_{record}"
            assert opened[f"/data/0/meshes/gradB_{record}"].attrs["referenceCurrent"] == scale
            total += weights[number] * scale * data.flux_density[number]
        assert len(opened["/ExternalFieldPath"]) == 8
        for c, name in enumerate("xyz"):
            np.testing.assert_allclose(
                opened[f"/data/0/meshes/B/{name}"], total[..., c], rtol=1e-12, atol=1e-14
            )
        comments = [opened[f"/data/0/meshes/B_{name}"].attrs["comment"].decode() for name in records]
        assert comments[:3] == [
            'flux density of coil "upper left" alone at 0.3 A, without iron',
            'flux density of coil "1" alone at 7 A, without iron',
            "flux density of saturating iron, iron mode 1 at weight 1",
        ]
        assert comments[-1] == "flux density of what no current drives: magnet, background"
        header = json.loads(opened["/fieldmap/header"][()])
        assert (header["fixed_sources"], header["constant_field"]) == (["magnet", "background"], True)
    free = make_saturating(
        make_model(fixed=np.zeros(0)),
        constant_field=False,
        flux_density=data.flux_density[:7],
        gradient=data.gradient[:7],
    )
    with h5py.File(write_map(tmp_path / "free.h5", free)) as opened:
        assert json.loads(opened["/fieldmap/header"][()])["constant_field"] is False


def test_the_texts_are_readable(file):
    """One key per line, without decoding."""
    lines = file["/fieldmap/header"][()].decode().splitlines()
    assert ' "title": "A map for tests, 20 °C",' in lines
    header = json.loads(" ".join(lines))
    assert header["format"] == file["/fieldmap"].attrs["format_version"] == 1
    assert (header["coil_names"], header["record_names"]) == (
        ["1", "upper left", "Spule ø"],
        ["1", "upper_left", "Spule__"],
    )
    assert (header["lower_m"], header["spacing_m"]) == ([-0.02, 0.01, -0.14], [0.004, 0.005, 0.0031])
    assert (header["shape"], header["planes_per_chunk"], header["reference_current_A"]) == (
        [4, 3, 5],
        4,
        [2.0] * 3,
    )
    report = json.loads(file["/fieldmap/report"][()])
    assert report["interpolation_error"] == {"flux_density_T": 1e-9, "gradient_T_per_m": 2e-7}
    assert report["error_bounds"]["harmonic"] == {"flux_density_T": 2e-9, "gradient_T_per_m": 3e-7}
    assert report["current_error"] is None


def test_sources_can_be_read_with_their_hashes(file):
    for name, text in (("recipe", "spacing_mm = 4\n"), ("device", 'title = "µ-metal"\n')):
        stored = file[f"/fieldmap/{name}"]
        assert stored[()].decode() == text
        assert stored.attrs["sha256"].decode() == hashlib.sha256(text.encode()).hexdigest()
    assert re.search(r'"numpy": "2"', file["/fieldmap/header"][()].decode())
    assert re.search(r'"iterations": 7', file["/fieldmap/report"][()].decode())
