"""Which paths may be written: by their ending, by an existing file, by the other inputs and outputs."""

import errno
import os
import socket
import subprocess
import sys

import pytest

from fieldmap.errors import FieldmapError, InputError
from fieldmap.store.output_formats import FORMATS, output_problems
from fieldmap.store.whole_files import disk_errors, whole_file, write_whole
from tests.refusals import refused

TABLE = "# A field\n# device: unit\n# frame: m\n"


def fault(path, *formats, others=()):
    problems = output_problems("-o", path, formats, others)
    return problems[0].must_hold if problems else ""


def test_a_table_replaces_a_table_alone(tmp_path):
    path = tmp_path / "new" / "folder" / "a.csv"
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


def test_what_a_killed_process_leaves_is_no_file_of_its_kind(tmp_path):
    path = tmp_path / "a.csv"
    code = f"""
import os, signal
from fieldmap.store.whole_files import whole_file
with whole_file({str(path)!r}, "table of a field") as partial:
    partial.write_text("half of it")
    os.kill(os.getpid(), signal.SIGTERM)
"""
    ended = subprocess.run([sys.executable, "-c", code], check=False)
    (left,) = tmp_path.iterdir()
    assert ended.returncode != 0
    assert left.is_dir()
    assert left.name.startswith(".")
    assert list(tmp_path.glob("*.csv")) == []
    write_whole(path, TABLE, "table of a field")
    plain = tmp_path / "plain"
    plain.write_text(TABLE)
    assert path.read_text() == TABLE
    assert path.stat().st_mode == plain.stat().st_mode


@pytest.mark.parametrize(
    ("formats", "told"),
    [
        (["device"], "must end in .toml"),
        (["map"], "must end in .h5 or .hdf5"),
        (["figure"], "must end in .png, .svg or .pdf"),
        (["map", "recorded run"], "must end in .h5, .hdf5 or .csv"),
        (["map", "recorded runs"], "must end in .h5 or .hdf5"),
    ],
)
def test_endings(tmp_path, formats, told):
    for name in ("a.xyz", ".h5", "h5", "a.h5.bak"):
        assert fault(tmp_path / name, *formats) == told
    for ending in {one for name in formats for one in FORMATS[name].endings}:
        assert fault(tmp_path / f"a{ending}", *formats) == ""


def test_places_that_cannot_be_written(tmp_path, monkeypatch):
    """The nearest existing folder is checked; a file in place of a folder; an existing path that cannot be read."""
    asked = []
    monkeypatch.setattr("os.access", lambda folder, mode: asked.append((folder, mode)))
    (problem,) = output_problems("-o", tmp_path / "new" / "folder" / "a.h5", ["map"])
    assert asked == [(tmp_path, os.W_OK)]
    assert problem.received.endswith(f"{tmp_path} is not writable")
    monkeypatch.undo()
    (tmp_path / "file").touch()
    (problem,) = output_problems("-o", tmp_path / "file" / "folder" / "a.h5", ["map"])
    assert problem.received.endswith(f"{tmp_path / 'file'} is a file")
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as unreadable:
        unreadable.bind("a.h5")
        assert "another origin: it may replace a map or recorded runs" in fault(
            "a.h5", "map", "recorded runs"
        )
    with refused(InputError, where="file/a.h5", must_hold="a folder that can be written"):
        write_whole("file/a.h5", b"", "map")


def test_text_and_bytes_are_written_as_they_are(tmp_path):
    for content, raw in ((TABLE + "µ\r\n", (TABLE + "µ\r\n").encode()), (b"\xff\x00", b"\xff\x00")):
        name = tmp_path / ("a.csv" if isinstance(content, str) else "a.png")
        assert (
            write_whole(name, content, "table of a field" if isinstance(content, str) else "picture") == name
        )
        assert name.read_bytes() == raw


@pytest.mark.parametrize(
    ("raised", "told"), [(OSError("words"), "words"), (OSError(errno.EIO, "failed"), "failed")]
)
def test_a_place_that_fails_while_it_is_written(tmp_path, raised, told):
    with (
        refused(InputError, where=str(tmp_path / "a.csv"), received=told),
        whole_file(tmp_path / "a.csv", "table of a field"),
    ):
        raise raised
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("raised", "told"),
    [
        (OSError(errno.ENOSPC, "full"), "full"),
        (OSError("one\ntwo\nthree"), "one"),
        (RuntimeError("one\ntwo\nthree"), "one"),
        (RuntimeError(), "RuntimeError"),
        (OSError(), "OSError"),
    ],
)
def test_errors_of_the_disk_are_told_in_one_line(raised, told):
    with refused(FieldmapError, where="a.h5", received=told) as caught, disk_errors("a.h5"):
        raise raised
    assert caught.value.exit_code == 1
    assert len(caught.value.problems) == 1


def test_names_folders_and_other_files(tmp_path):
    (tmp_path / "a.h5").mkdir()
    assert fault(tmp_path / "a.h5", "map") == "must be a file"
    (tmp_path / "b.h5").touch()
    assert fault(tmp_path / "b.h5", "map") == ""
    os.link(tmp_path / "b.h5", tmp_path / "linked.h5")
    assert "is read" in fault(tmp_path / "b.h5", "map", others=["x" * 5000, tmp_path / "linked.h5"])
    assert "is read" in fault(tmp_path / "c.h5", "map", others=[tmp_path / "new" / ".." / "c.h5"])
    assert (
        fault(
            tmp_path / "c.h5", "map", others=[tmp_path / "b.h5", tmp_path / "d.h5", tmp_path / "new" / "c.h5"]
        )
        == ""
    )
    assert (
        fault(tmp_path / "b.h5", "map", others=[tmp_path / "a.h5", tmp_path / "d.h5", tmp_path / "e.csv"])
        == ""
    )
    assert "folder" in fault(tmp_path / "b.h5" / "c.h5", "map")
