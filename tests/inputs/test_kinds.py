"""A file that is clearly of another kind is refused with a message that says so."""

import subprocess
import sys
from pathlib import Path

import pytest

from fieldmap.inputs.kinds import MARKS, kind_of
from fieldmap.inputs.tables import UNITS, Table
from fieldmap.io.json_schema import FILE_KINDS
from fieldmap.shipped import shipped_folder, shipped_names

KINDS = {kind.name: kind for kind in FILE_KINDS}
SHIPPED = [
    (kind, name)
    for kind in KINDS.values()
    for name in shipped_names(kind.folder, kind.subfolder)
    if name.startswith("planar") == (kind.name == "planar device")
]


ALONE = [(KINDS[kind], name) for kind, name in {kind.name: name for kind, name in SHIPPED}.items()]


@pytest.mark.parametrize(("kind", "file"), ALONE, ids=lambda value: str(getattr(value, "name", value)))
def test_a_name_alone_is_that_of_the_shipped_file(kind, file, tmp_path, monkeypatch):
    """A folder, a file of another kind and one that cannot be read do not hide it; of two files none is taken."""
    monkeypatch.chdir(tmp_path)
    shipped = shipped_folder(kind.folder) / f"{file}.toml"
    name, content = shipped.stem, shipped.read_text()
    if shipped.parent != shipped_folder(kind.folder) / kind.subfolder:
        pytest.skip("has no name alone")
    here = tmp_path / name
    here.mkdir()
    assert kind.find(name) == shipped
    here.rmdir()
    for other in (
        b"",
        b"\xff\xfe",
        b"= 3",
        b"H_A_per_m = [1.0]\n" if kind.name != "material" else b"coil = []\n",
    ):
        here.write_bytes(other)
        assert kind.find(name) == shipped
    (tmp_path / f"{name}.toml").write_text(content)
    assert kind.find(name) == shipped
    assert kind.find(f"{name}.toml") == Path(f"{name}.toml")
    here.write_text(content)
    with pytest.raises(kind.error) as caught:
        kind.find(name)
    (problem,) = caught.value.problems
    assert problem.where == name
    assert f"./{name}" in problem.remedy
    assert str(shipped) in problem.remedy
    for path in (f"./{name}", str(here), here):
        assert kind.find(path) == Path(path)


def test_a_name_that_no_shipped_file_has_is_that_of_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("coil = []\n")
    assert KINDS["device"].find("mine") == Path("mine")
    (tmp_path / "folder").mkdir()
    with pytest.raises(KINDS["device"].error, match="a directory"):
        KINDS["device"].find("folder")


def test_every_kind_has_marks_that_its_files_may_have():
    assert set(KINDS) == set(MARKS)
    for kind in FILE_KINDS:
        known = kind.schema.model_fields.keys() | kind.short_forms
        assert MARKS[kind.name].keys <= known
        assert {MARKS[kind.name].key} - {""} <= known


def declared_keys(table=Table):
    """(key, unit) of every table made from a declaration."""
    for one in table.__subclasses__():
        yield from ((key, each.about.unit) for key, each in one.declared.items())
        yield from declared_keys(one)


def test_every_declared_unit_has_its_si_value():
    # A unit without factor would be taken for an SI unit.
    assert {key for key, unit in declared_keys() if unit and unit not in UNITS} == set()


@pytest.mark.parametrize(("kind", "name"), SHIPPED, ids=lambda value: str(getattr(value, "name", value)))
def test_every_shipped_file_is_of_its_kind(kind, name):
    document = kind.load(shipped_folder(kind.folder) / f"{name}.toml")
    assert kind_of(document.data) == kind.name
    kind.contents(document)


@pytest.mark.parametrize("wanted", KINDS)
@pytest.mark.parametrize("given", KINDS)
def test_files_of_another_kind_are_refused(wanted, given, tmp_path):
    if wanted == given or (wanted, given) == ("planar device", "device"):  # which may only lack its mark
        return
    kind = KINDS[given]
    name = next(name for other, name in SHIPPED if other is kind)
    with pytest.raises(KINDS[wanted].error) as caught:
        KINDS[wanted].load(shipped_folder(kind.folder) / f"{name}.toml")
    (problem,) = caught.value.problems
    assert wanted in problem.must_hold
    assert given in problem.received
    assert MARKS[given].taken_by in problem.remedy


@pytest.mark.parametrize("data", [{}, {"format": 1}, {"coil": [], "vary": []}])
def test_data_of_no_kind_or_of_several_is_of_none(data):
    assert kind_of(data) is None


def test_a_reader_knows_kinds_of_packages_that_are_not_loaded(tmp_path):
    """In a subprocess that has loaded only the reader of devices."""
    program = """
import sys
from fieldmap.device import read_device
read_device("single_electromagnet")
assert not [n for n in sys.modules if n.startswith(("fieldmap.iron", "fieldmap.maps", "fieldmap.dynamics"))]
try:
    read_device(sys.argv[1])
except ValueError as error:
    print(error.problems[0].received)
"""
    scenario = shipped_folder("maps") / "scenarios" / "hold.toml"
    run = [sys.executable, "-c", program, str(scenario)]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    assert "scenario" in done.stdout


def test_misspelt_names_of_shipped_files_are_corrected():
    with pytest.raises(KINDS["device"].error) as caught:
        KINDS["device"].find("drive_unti")
    assert "drive_unit" in caught.value.problems[0].remedy
