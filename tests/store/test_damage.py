"""Files that are no complete, undamaged map: always a MapFileError, never a traceback, never wrong numbers."""

import json

import h5py
import numpy as np
import pytest

from fieldmap.errors import MapFileError
from fieldmap.store import checkpoint_path, open_writer, read_info, read_map, seal_map, write_map
from fieldmap.store.seal import SEAL_LENGTH
from tests.refusals import refused as refused_as


@pytest.fixture
def path(data, tmp_path):
    return write_map(tmp_path / "map.h5", data)


def refused(path, words):
    with pytest.raises(MapFileError, match=words) as caught:
        read_map(path)
    problem = caught.value.problems[0]
    assert str(path) in problem.where
    assert "fieldmap" in problem.remedy
    assert caught.value.exit_code == 2


def test_missing_file(tmp_path):
    refused(tmp_path / "none.h5", "an existing map file; received no such file")


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        (b"", "an empty file"),
        (b"not a map", "a text that begins with 'not a map'"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "without seal"),
    ],
)
def test_not_hdf5(tmp_path, contents, words):
    path = tmp_path / "map.h5"
    path.write_bytes(contents)
    refused(path, words)


def test_someone_elses_hdf5(tmp_path):
    path = tmp_path / "map.h5"
    with h5py.File(path, "w") as file:
        file["numbers"] = np.arange(5)
    refused(path, "without seal")
    seal_map(path)
    refused(path, "a map written by fieldmap")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_truncated(path, share):
    raw = path.read_bytes()[:-SEAL_LENGTH]
    path.write_bytes(raw[: int(share * len(raw))])
    refused(path, "without seal at its end: cut off")
    seal_map(path)
    refused(path, "damaged or foreign")


def test_flipped_byte_in_a_chunk(path):
    with h5py.File(path) as file:
        info = file["/data/0/meshes/gradB_upper_left/yz"].id.get_chunk_info(0)
    raw = bytearray(path.read_bytes())
    raw[info.byte_offset + info.size // 2] ^= 0x10
    path.write_bytes(raw)
    refused(path, "its SHA-256 is not that of its seal")
    with pytest.raises(MapFileError, match="SHA-256"):
        read_info(path)
    seal_map(path)  # HDF5's own checksum finds it as well
    refused(path, "damaged or foreign")


def test_bytes_added_or_lost_before_the_seal(path):
    raw, seal = path.read_bytes()[:-SEAL_LENGTH], path.read_bytes()[-SEAL_LENGTH:]
    for damaged in (raw + b"x", raw[:-1]):
        path.write_bytes(damaged + seal)
        refused(path, f"received {len(damaged)} bytes, where {len(raw)} were sealed")


def test_sealing_again_changes_nothing(path):
    raw = path.read_bytes()
    seal_map(path)
    assert path.read_bytes() == raw


@pytest.mark.parametrize("name", ["none.h5", "folder.h5"])
def test_what_is_no_file_is_not_sealed(tmp_path, name):
    (tmp_path / "folder.h5").mkdir()
    with refused_as(MapFileError, where=str(tmp_path / name)):
        seal_map(tmp_path / name)
    assert [one.name for one in tmp_path.iterdir()] == ["folder.h5"]


def test_another_program_cuts_the_seal_off(path, data):
    edited(path, lambda file: file.attrs.__setitem__("comment", "changed"), seal=False)
    refused(path, "changed by another program")
    seal_map(path)
    np.testing.assert_array_equal(read_map(path).flux_density, data.flux_density)


def test_incomplete(data, tmp_path):
    with open_writer(tmp_path / "map.h5", data):
        pass
    partial = checkpoint_path(tmp_path / "map.h5")
    refused(partial, "a complete map; received the file of a run that has not finished; go on with it")
    renamed = partial.rename(tmp_path / "renamed.h5")
    refused(renamed, "a text that begins with")
    seal_map(renamed)
    refused(renamed, "a damaged or foreign file")


def test_parts_that_are_not_flagged_as_written(data, tmp_path):
    path = write_map(tmp_path / "map.h5", data)

    def unfinished(file):
        file["/fieldmap/completion"].attrs["complete"] = np.uint8(0)
        file["/fieldmap/completion/chunks"][0] = 0

    edited(path, unfinished)
    refused(path, "a complete map; received 0 of 1 parts; go on with it")


def edited(path, change, seal=True):
    with h5py.File(path, "r+") as file:
        change(file)
    if seal:
        seal_map(path)


def replace(name, make):
    def change(file):
        del file[name]
        make(file)

    return change


BX = "/data/0/meshes/B_1/x"


def nan_node(file):
    file[BX][0, 0, 0] = np.nan


def newer(file):
    file["/fieldmap"].attrs["format_version"] = 4


def of_another_format(file):
    file["/fieldmap"].attrs["format_version"] = 2


def wrong_spacing(file):
    file["/data/0/meshes/B_1"].attrs["gridSpacing"] = [1.0, 1.0, 1.0]


def other_recipe(file):
    from fieldmap.store.map_format import write_text

    write_text(file, "recipe", "spacing_mm = 5\n")


def edited_header(file):
    text = file["/fieldmap/header"][()].decode().replace("0.004", "0.005")
    file["/fieldmap/header"][...] = np.bytes_(text.encode())


def no_coils(file):
    from fieldmap.store.map_format import write_text

    header = json.loads(file["/fieldmap/header"][()])
    write_text(file, "header", json.dumps(header | {"coil_names": [], "record_names": []}))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (nan_node, "B_1/x: finite numbers; received NaN"),
        (newer, "file format 1, 2, 3; received format 4"),
        (of_another_format, "received format 2, and 1 in its header"),
        (wrong_spacing, "B_1, gridSpacing: .* received array"),
        (other_recipe, "the recipe it was made from; received a recipe text with another hash"),
        (edited_header, "damaged or foreign"),
        (no_coils, "undamaged map file|at least one coil|positive currents"),
        (replace(BX, lambda f: None), "B_1/x inside the file"),
        (replace(BX, lambda f: f.create_dataset(BX, data=np.zeros((2, 2, 2)))), "float64 numbers of shape"),
        (replace(BX, lambda f: f.create_dataset(BX, data=np.zeros((4, 3, 5), "f4"))), "float64 numbers"),
        (replace(BX, lambda f: f.create_group(BX)), "float64 numbers"),
        (replace("/fieldmap/header", lambda f: None), "header inside the file"),
        (replace("/fieldmap/completion", lambda f: None), "completion inside the file"),
    ],
)
def test_edited(path, change, words):
    edited(path, change)
    refused(path, words)


def test_numbers_are_not_taken_from_another_file(path, tmp_path, make_map):
    other = write_map(tmp_path / "other.h5", make_map(title="other"))
    links = {
        "external": h5py.ExternalLink(str(other), BX),
        "soft": h5py.SoftLink("/data/0/meshes/B_upper_left/x"),
    }
    raw = path.read_bytes()
    for link in links.values():
        path.write_bytes(raw)
        edited(path, replace(BX, lambda f, link=link: f.__setitem__(BX, link)))
        refused(path, "B_1/x inside the file; received a link")


@pytest.mark.parametrize(
    "group", ["/fieldmap", "/fieldmap/completion", "/data", "/data/0/meshes", "/data/0/meshes/B_1"]
)
def test_no_group_on_the_way_is_a_link(path, tmp_path, make_map, group):
    other = write_map(tmp_path / "other.h5", make_map(title="other"))
    words = (
        "without the group"
        if group == "/fieldmap"
        else f"received a link, or nothing, at {group.rpartition('/')[0]}"
    )
    raw = path.read_bytes()
    edited(path, lambda f: (f.move(group, "/moved"), f.__setitem__(group, h5py.SoftLink("/moved"))))
    refused(path, words)
    path.write_bytes(raw)
    edited(path, replace(group, lambda f: f.__setitem__(group, h5py.ExternalLink(str(other), group))))
    refused(path, words)


@pytest.mark.parametrize("group", ["/data", "/data/0/meshes"])
@pytest.mark.parametrize("instead", [np.zeros(3), np.dtype("f8")])
def test_numbers_or_a_type_in_the_place_of_a_group(path, group, instead):
    edited(path, replace(group, lambda f: f.__setitem__(group, instead)))
    refused(path, f"received a link, or nothing, at {group};")


def test_numbers_are_not_taken_from_virtual_or_raw_files(path, tmp_path, make_map):
    other = write_map(tmp_path / "other.h5", make_map(title="other"))
    raw = path.read_bytes()
    layout = h5py.VirtualLayout((4, 3, 5), "f8")
    layout[...] = h5py.VirtualSource(str(other), BX, shape=(4, 3, 5))
    edited(path, replace(BX, lambda f: f.create_virtual_dataset(BX, layout)))
    refused(path, "numbers kept in another file")
    path.write_bytes(raw)
    plain = tmp_path / "numbers.bin"
    plain.write_bytes(bytes(480))
    external = [(str(plain), 0, 480)]
    edited(path, replace(BX, lambda f: f.create_dataset(BX, (4, 3, 5), "f8", external=external)))
    refused(path, "numbers kept in another file")
