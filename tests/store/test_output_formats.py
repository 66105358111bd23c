"""Which paths may be written: by their ending, by what lies there, by what else is read or written."""

import os

import pytest

from fieldmap.errors import InputError
from fieldmap.store.output_formats import output_problems
from fieldmap.store.whole_files import whole_file, write_whole

TABLE = "# A field\n# device: unit\n# frame: m\n"


def fault(path, *formats, others=()):
    problems = output_problems("-o", path, formats, others)
    return problems[0].must_hold if problems else ""


def test_a_table_replaces_a_table_alone(tmp_path):
    path = tmp_path / "new" / "a.csv"
    write_whole(path, TABLE, "table of a field")
    write_whole(path, TABLE + "1\n", "table of a field")
    assert path.read_text() == TABLE + "1\n"
    path.write_text("time,x\n")
    with pytest.raises(InputError) as caught:
        write_whole(path, TABLE, "table of a field")
    assert caught.value.problems[0].where == str(path)
    assert caught.value.problems[0].received == f"{path}, a text that begins with 'time,x'"
    assert path.read_text() == "time,x\n"
    assert [one.name for one in path.parent.iterdir()] == ["a.csv"]


def test_a_failure_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(TABLE)
    with pytest.raises(TypeError), whole_file(path, "table of a field") as partial:
        partial.write_bytes("half of it")
    assert path.read_text() == TABLE
    assert list(tmp_path.iterdir()) == [path]


def test_names_folders_and_other_files(tmp_path):
    assert "must end in .h5 or .hdf5" in fault(tmp_path / "a.csv", "map")
    assert "must end in" in fault(tmp_path / ".h5", "map")
    (tmp_path / "a.h5").mkdir()
    assert fault(tmp_path / "a.h5", "map") == "must be a file"
    (tmp_path / "b.h5").touch()
    assert fault(tmp_path / "b.h5", "map") == ""
    os.link(tmp_path / "b.h5", tmp_path / "linked.h5")
    assert "is read" in fault(tmp_path / "b.h5", "map", others=["x" * 5000, tmp_path / "linked.h5"])
    assert "is read" in fault(tmp_path / "c.h5", "map", others=[tmp_path / "new" / ".." / "c.h5"])
    assert "folder" in fault(tmp_path / "b.h5" / "c.h5", "map")
