"""Files that are no complete, undamaged map: always a MapFileError, never a traceback, never wrong numbers."""

import errno
import hashlib
import json
import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from fieldmap.currents import LiftAndDirections
from fieldmap.errors import MapFileError
from fieldmap.store import checkpoint_path, map_path, open_writer, read_info, read_map, seal_map, write_map
from fieldmap.store.map_format import write_text
from fieldmap.store.map_reader import opened_map
from fieldmap.store.seal import SEAL_LENGTH, check_seal, is_sealed
from tests.refusals import refused as refused_as
from tests.store.conftest import make_saturating


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
    seal_map(path)  # HDF5's own checksum finds it too
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
    told = os.strerror(errno.EISDIR if name.startswith("folder") else errno.ENOENT)
    with refused_as(MapFileError, where=str(tmp_path / name)) as caught:
        seal_map(tmp_path / name)
    assert caught.value.problems[0].received == told
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


def wrong_spacing(file):
    file["/data/0/meshes/B_1"].attrs["gridSpacing"] = [1.0, 1.0, 1.0]


def other_recipe(file):
    write_text(file, "recipe", "spacing_mm = 5\n")


def edited_header(file):
    text = file["/fieldmap/header"][()].decode().replace("0.004", "0.005")
    file["/fieldmap/header"][...] = np.bytes_(text.encode())


def rewritten(text, **changes):
    """Change entries of the header or the report."""

    def change(file):
        contents = json.loads(file[f"/fieldmap/{text}"][()])
        write_text(file, text, json.dumps(contents | changes))

    return change


def hash_of(text, digest):
    def change(file):
        file[f"/fieldmap/{text}"].attrs["sha256"] = np.bytes_(digest)

    return change


def version(number):
    def change(file):
        file["/fieldmap"].attrs["format_version"] = number

    return change


def complete(number):
    def change(file):
        file["/fieldmap/completion"].attrs["complete"] = np.uint8(number)

    return change


def data_set(shape=(4, 3, 5), dtype="f8", filled=True, **options):
    """Replace B_1/x."""

    def make(file):
        data = file.create_dataset(BX, shape, dtype, **options)
        if filled:
            data[...] = np.zeros(shape)

    return replace(BX, make)


def half(file):
    file[BX][:2] = 0.0


def second_name(file):
    del file["/data/0/meshes/B_1/y"]
    file["/data/0/meshes/B_1/y"] = file[BX]


def error(**numbers):
    return rewritten(
        "report", interpolation_error={"flux_density_T": 1e-9, "gradient_T_per_m": 2e-7} | numbers
    )


def magnets(file):
    """Name fixed sources in a map without a constant field."""
    rewritten("header", fixed_sources=["magnet"])(file)


no_coils = rewritten("header", coil_names=[], record_names=[])
LONG = [200 * "b", "b"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (nan_node, "B_1/x: finite numbers; received NaN"),
        (version(4), "file format 1, 2, 3; received format 4"),
        (version(3), "file format 1, .* received format 3, and 1 in its header"),
        (version(0), "file format 1, 2, 3; received format 0"),
        (version(2), "file format 1, .* received format 2, and 1 in its header"),
        (rewritten("header", format=2), "received format 1, and 2 in its header"),
        (rewritten("header", format=0), "received format 1, and 0 in its header"),
        (magnets, "file format 2, .* received format 1, and 1 in its header"),
        (complete(0), "a complete map; received 1 of 1 parts; go on with it"),
        (complete(2), "a complete map; received 1 of 1 parts; go on with it"),
        (hash_of("report", 64 * "0"), "damaged or foreign file \\(/fieldmap/report\\)"),
        (hash_of("report", 64 * "f"), "damaged or foreign file \\(/fieldmap/report\\)"),
        (rewritten("header", recipe_sha256=64 * "0"), "the recipe it was made from"),
        (rewritten("header", recipe_sha256=64 * "f"), "the recipe it was made from"),
        (rewritten("header", device_sha256=64 * "0"), "the device it was made from"),
        (rewritten("header", device_sha256=64 * "f"), "the device it was made from"),
        (
            rewritten("header", record_names=["2", "upper_left"]),
            "the records 1, upper_left; received \\['2', 'upper",
        ),
        (
            rewritten("header", record_names=["0", "upper_left"]),
            "the records 1, upper_left; received \\['0', 'upper",
        ),
        (rewritten("header", record_names=["1"]), "the records 1, upper_left; received \\['1'\\];"),
        (rewritten("header", record_names=LONG), f"received \\['{198 * 'b'}; make"),
        (rewritten("header", title=3), "title: int in the place"),
        (rewritten("header", coil_names="ab"), "coil_names: str in the place"),
        (rewritten("header", constant_field=1), "constant_field: int in the place"),
        (rewritten("header", versions={"numpy": 2}), "numpy: int in the place"),
        (error(flux_density_T=-1e-12), "a stated error of \\(-1e-12, 2e-07\\)"),
        (error(gradient_T_per_m=-1e-12), "a stated error of \\(1e-09, -1e-12\\)"),
        (error(gradient_T_per_m=float("inf")), "a stated error of"),
        (error(flux_density_T=float("nan")), "a stated error of"),
        (second_name, "B_1/[xy]: numbers of its own; received numbers that have another name as well"),
        (data_set(chunks=(2, 3, 5), compression="gzip"), "B_1/x: stored as it is, .* received a compressed"),
        (data_set(chunks=(2, 3, 5), shuffle=True, fletcher32=True), "B_1/x: stored as it is"),
        (data_set(filled=False), "B_1/x: all of its .* received shape \\(4, 3, 5\\) with 0 bytes stored"),
        (
            lambda file: (data_set(chunks=(2, 3, 5), filled=False)(file), half(file)),
            "B_1/x: all of its numbers stored; received shape .* with 240 bytes stored",
        ),
        (replace(BX, lambda f: f.__setitem__(BX, h5py.Empty("f8"))), "B_1/x: all of its numbers stored"),
        (
            data_set((9, 3, 5)),
            "B_1/x: float64 numbers of shape \\(4, 3, 5\\); received \\(9, 3, 5\\), float64",
        ),
        (
            data_set(dtype=np.longdouble),
            "B_1/x: float64 numbers of shape .* received .*, float128|longdouble",
        ),
        (data_set(dtype=">f8"), "B_1/x: float64 numbers of shape .* received .*, >f8"),
        (data_set(dtype="i8"), "B_1/x: float64 numbers; received shape \\(4, 3, 5\\), int64"),
        (wrong_spacing, "B_1, gridSpacing: .* received array"),
        (other_recipe, "the recipe it was made from; received a recipe text with another hash"),
        (edited_header, "damaged or foreign"),
        (no_coils, "undamaged map file|at least one coil|positive currents"),
        (replace(BX, lambda f: None), "B_1/x inside the file"),
        (replace(BX, lambda f: f.create_dataset(BX, data=np.zeros((2, 2, 2)))), "float64 numbers of shape"),
        (replace(BX, lambda f: f.create_dataset(BX, data=np.zeros((4, 3, 5), "f4"))), "float64 numbers"),
        (replace(BX, lambda f: f.create_group(BX)), "float64 numbers; received no data set"),
        (replace("/fieldmap/header", lambda f: None), "header inside the file"),
        (replace("/fieldmap/completion", lambda f: None), "completion inside the file"),
    ],
)
def test_edited(path, change, words):
    edited(path, change)
    refused(path, words)


@pytest.mark.parametrize(("bytes_", "gradient"), [(0.0, 0.0), (3e-9, 0.0)])
def test_an_error_of_nothing_is_an_error_too(path, bytes_, gradient):
    edited(path, error(flux_density_T=bytes_, gradient_T_per_m=gradient))
    found = read_info(path).interpolation_error
    assert (found.flux_density, found.gradient) == (bytes_, gradient)


def test_plain_arrays_of_another_program_will_do(path, data):
    """Without chunks and checksums, under a seal."""

    def plain(file):
        values = file[BX][()]
        del file[BX]
        file[BX] = values

    edited(path, plain)
    np.testing.assert_array_equal(read_map(path).flux_density, data.flux_density)


@pytest.mark.parametrize(
    ("raised", "told"), [(OSError("one\ntwo\nthree"), "(one)"), (OSError(), "(no text)")]
)
def test_an_error_of_the_library_is_told_in_one_line(path, raised, told):
    with (
        refused_as(MapFileError, where=str(path), received=f"a damaged or foreign file {told}"),
        opened_map(path),
    ):
        raise raised


def test_a_reduced_model_is_a_group_and_has_one_parametrisation(tmp_path):
    path = write_map(tmp_path / "map.h5", make_saturating())
    raw = path.read_bytes()
    name = "/fieldmap/reduced_model"
    edited(path, replace(name, lambda file: file.__setitem__(name, np.zeros(3))))
    refused(path, "reduced_model: a group; received numbers")
    path.write_bytes(raw)
    edited(
        path,
        replace(
            f"{name}/division_exponent", lambda file: file.__setitem__(f"{name}/division_exponent", [2.0])
        ),
    )
    refused(path, f"one parametrisation of the currents, .*{re.escape(repr(LiftAndDirections(2.0)))} as well")
    path.write_bytes(raw)
    edited(path, replace(f"{name}/fixed", lambda file: None))
    refused(path, "reduced_model: a background that both the iron and the air have, or neither")


def test_shipped_maps_have_names(tmp_path, monkeypatch):
    """A name without folder and ending; a file of this name takes precedence."""
    monkeypatch.chdir(tmp_path)
    shipped = map_path("sample")
    assert (shipped.name, shipped.is_file()) == ("sample.h5", True)
    for name in ("zoo/sample", "a/sample", "./sample", "sample.h5", "no_such"):
        assert map_path(name) == Path(name)
    (tmp_path / "sample").touch()
    assert map_path("sample") == Path("sample")


@pytest.mark.parametrize("length", [0, 1, 255, 3_000_000])
def test_the_seal_is_a_line_of_text(tmp_path, length):
    path = tmp_path / "file"
    raw = bytes(range(256)) * (length // 256) + bytes(length % 256)
    path.write_bytes(raw)
    assert not is_sealed(path)
    for _ in range(2):
        seal_map(path)
        assert is_sealed(path)
        check_seal(path)
        line = f"\n# sealed by fieldmap: {length:016x} {hashlib.sha256(raw).hexdigest()}\n"
        assert path.read_bytes() == raw + line.encode()
    # Lines with other characters or without their end are no seals; seals of another length or digest do not fit.
    for wrong in (line[:-1] + "x", line[1:], line.replace(" sealed", " Sealed"), line.replace(": ", ": g")):
        path.write_bytes(raw + wrong.encode())
        assert not is_sealed(path)
    for other in (raw + b"\1", raw[:-1] or b"\1\2"):
        path.write_bytes(other + line.encode())
        with refused_as(MapFileError, received="a damaged file"):
            check_seal(path)
    if raw:
        for place in (0, length // 2, length - 1):
            changed = raw[:place] + bytes([raw[place] ^ 1]) + raw[place + 1 :]
            path.write_bytes(changed + line.encode())
            with refused_as(MapFileError, received="not that of its seal"):
                check_seal(path)
    for digest in (64 * "0", 64 * "f"):
        path.write_bytes(raw + (line[: -len(digest) - 1] + digest + "\n").encode())
        with refused_as(MapFileError, received="not that of its seal"):
            check_seal(path)


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
