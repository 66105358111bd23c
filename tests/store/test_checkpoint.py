"""Pieces of long work: present after a kill at any moment, absent if incomplete."""

import errno
import hashlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.errors import FieldmapError, InputError
from fieldmap.store import checkpoint as module
from fieldmap.store.checkpoint import Checkpoint, checkpoint_path
from tests.refusals import refused

PIECES = {
    "first": ({"field": np.linspace(0.0, 1.0, 7).reshape(7, 1), "law": np.arange(3)}, {"seconds": 0.1}),
    "second": (
        {"empty": np.empty((0, 3)), "number": np.float64(np.pi)},
        {"reason": "µ\n", "share": float("nan")},
    ),
    "third": ({}, {}),
}


@pytest.fixture
def path(tmp_path):
    return checkpoint_path(tmp_path / "new" / "folder" / "map.h5")


@pytest.fixture
def filled(path):
    with Checkpoint(path, "one") as checkpoint:
        for key, piece in PIECES.items():
            checkpoint.put(key, *piece)
    return path


def check(checkpoint, keys):
    assert tuple(checkpoint) == tuple(keys)
    for key, (arrays, about) in PIECES.items():
        found = checkpoint.get(key)
        assert (found is not None) == (key in keys) == (key in checkpoint)
        if found is not None:
            assert {name: (v.dtype, v.shape, v.tobytes()) for name, v in found.arrays.items()} == {
                name: (v.dtype, v.shape, v.tobytes())
                for name, v in ((k, np.asarray(v)) for k, v in arrays.items())
            }
            assert json.dumps(found.about) == json.dumps(about)


def test_pieces_come_back_to_the_bit(filled):
    with Checkpoint(filled, "one") as checkpoint:
        assert checkpoint.note == ""
        check(checkpoint, PIECES)
        found = checkpoint.get("first").arrays["field"]
        found[0] = 5.0  # it must be a copy
        check(checkpoint, PIECES)
    assert filled.name == "map.h5.partial"
    assert checkpoint_path("study.nc", stays=True).name == "study.nc.kept"


def test_the_file_is_laid_out_as_its_description_says(filled):
    """By the module's description: a line of JSON; for each piece a line of 99 bytes, header, arrays, a newline."""
    stream = io.BytesIO(filled.read_bytes())
    assert json.loads(stream.readline()) == {"fieldmap_checkpoint": 1, "fingerprint": {"fingerprint": "one"}}
    for key, (arrays, about) in PIECES.items():
        digest, *lengths = stream.read(99).decode().removesuffix("\n").split(" ")
        header, payload = (stream.read(int(length, 16)) for length in lengths)
        assert (len(digest), *map(len, lengths)) == (64, 16, 16)
        assert hashlib.sha256(header + payload).hexdigest() == digest
        told = json.loads(header)
        assert (told["key"], json.dumps(told["about"])) == (key, json.dumps(about))
        assert told["arrays"] == [
            [name, np.asarray(v).dtype.str, [*np.shape(v)]] for name, v in arrays.items()
        ]
        assert payload == b"".join(np.asarray(v).tobytes() for v in arrays.values())
        assert stream.read(1) == b"\n"
    assert stream.read() == b""
    plain = filled.with_name("plain")
    plain.touch()
    assert filled.stat().st_mode == plain.stat().st_mode


def test_one_call_may_read_or_write_less_than_asked_for(path, monkeypatch):
    class Slow(io.FileIO):
        def read(self, count=-1):
            return super().read(min(count, 7))

        def write(self, content):
            return super().write(content[:5])

    monkeypatch.setattr(module, "FileIO", Slow)
    for _ in range(2):
        with Checkpoint(path, "one") as checkpoint:
            for key, piece in PIECES.items():
                checkpoint.put(key, *piece)
            check(checkpoint, PIECES)
    with Checkpoint(path, "one") as checkpoint:
        assert checkpoint.note == ""
        check(checkpoint, PIECES)


def test_a_later_piece_takes_the_place_of_an_earlier_one(filled):
    with Checkpoint(filled, "one") as checkpoint:
        checkpoint.put("first", about={"again": 1})
        assert checkpoint.get("first").about == {"again": 1}
    with Checkpoint(filled, "one") as checkpoint:
        assert tuple(checkpoint) == ("second", "third", "first")
        assert checkpoint.get("first").about == {"again": 1}


def test_a_file_cut_anywhere_holds_the_pieces_before_the_cut(filled):
    whole = filled.read_bytes()
    first = len(whole.split(b"\n")[0]) + 1
    ends = [first]
    for key, piece in PIECES.items():
        single = filled.with_name("single")
        with Checkpoint(single, "one") as checkpoint:
            checkpoint.put(key, *piece)
        ends.append(ends[-1] + single.stat().st_size - first)
        single.unlink()
    assert ends[-1] == len(whole)
    near = {end + step for end in ends for step in (-1, 0, 1)}
    for length in sorted((near | set(range(0, len(whole), 17))) - {len(whole), len(whole) + 1}):
        filled.write_bytes(whole[:length])
        keys = list(PIECES)[: sum(length >= end for end in ends[1:])]
        with Checkpoint(filled, "one") as checkpoint:
            check(checkpoint, keys)
            assert bool(checkpoint.note) == (0 < length < first)
            checkpoint.put("third", *PIECES["third"])
        with Checkpoint(filled, "one") as checkpoint:
            check(checkpoint, [key for key in keys if key != "third"] + ["third"])


def test_a_wrong_byte_anywhere_costs_pieces_and_gives_no_wrong_one(filled):
    whole = filled.read_bytes()
    first = len(whole.split(b"\n")[0]) + 1
    # A file whose first word is wrong may belong to another program, and is refused.
    for place in range(25, len(whole), 5):
        filled.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with Checkpoint(filled, "one") as checkpoint:
            check(checkpoint, tuple(checkpoint))
            assert set(checkpoint) <= set(PIECES)
            # The byte between two pieces is not read; any other wrong byte makes a piece absent.
            assert len(checkpoint) < 3 or place < first or whole[place : place + 1] == b"\n"


KILLED = """
import os, signal, sys
import numpy as np
from fieldmap.store.checkpoint import Checkpoint

count, late = int(sys.argv[2]), sys.argv[3] == "after"
real, seen = os.fsync, [0]

def dying(handle):
    seen[0] += 1
    if seen[0] == count and not late:
        os.kill(os.getpid(), signal.SIGKILL)
    real(handle)
    if seen[0] == count:
        os.kill(os.getpid(), signal.SIGKILL)

os.fsync = dying
with Checkpoint(sys.argv[1], "one") as checkpoint:
    for number in range(4):
        checkpoint.put(str(number), {"values": np.arange(5.0) + number})
"""


@pytest.mark.parametrize(("count", "late"), [(1, "before"), (1, "after"), (3, "before"), (4, "after")])
def test_killed_while_it_writes(path, count, late):
    command = [sys.executable, "-c", KILLED, str(path), str(count), late]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    with Checkpoint(path, "one") as checkpoint:
        # The first piece is on the disk at the second sync.
        assert len(checkpoint) >= count - 1 - (late == "before")
        for key in checkpoint:
            np.testing.assert_array_equal(checkpoint.get(key).arrays["values"], np.arange(5.0) + int(key))


@pytest.mark.parametrize(
    ("before", "now", "named"),
    [
        ("one", "two", "fingerprint"),
        ("two", "one", "fingerprint"),
        ({"recipe": "a", "device": "b"}, {"recipe": "a", "device": "c"}, "device"),
        ({"recipe": "b", "device": "b"}, {"recipe": "a", "device": "c"}, "recipe, device"),
        ({"recipe": "a"}, {"recipe": "a", "device": "c"}, "device"),
        ({"recipe": "a", "device": "c"}, {"recipe": "a"}, "fingerprint"),
    ],
)
def test_another_fingerprint_begins_anew_and_is_named(path, before, now, named):
    with Checkpoint(path, before) as checkpoint:
        checkpoint.put("first", *PIECES["first"])
    with Checkpoint(path, now) as checkpoint:
        assert len(checkpoint) == 0
        assert checkpoint.note == f"made with another {named}, begun anew"
        checkpoint.put("third", *PIECES["third"])
    with Checkpoint(path, now) as checkpoint:
        check(checkpoint, ["third"])


@pytest.mark.parametrize(
    "contents", [b"rubbish" * 100, b"\x89HDF\r\n\x1a\n" + bytes(500), b"[]\n", b'{"a": 1}\n', b"1\n"]
)
@pytest.mark.parametrize("resume", [True, False])
def test_a_foreign_file_is_refused_and_stays(path, contents, resume):
    path.parent.mkdir(parents=True)
    path.write_bytes(contents)
    with pytest.raises(InputError) as caught:
        Checkpoint(path, "one", resume=resume)
    assert caught.value.problems[0].where == str(path)
    assert path.read_bytes() == contents


@pytest.mark.parametrize("length", [1, 10, 30])
def test_a_torn_first_line_is_begun_anew(filled, length):
    filled.write_bytes(filled.read_bytes()[:length])
    with Checkpoint(filled, "one") as checkpoint:
        assert checkpoint.note
        assert len(checkpoint) == 0
        checkpoint.put("third", *PIECES["third"])
    with Checkpoint(filled, "one") as checkpoint:
        check(checkpoint, ["third"])


def test_begun_anew_on_request(filled):
    with Checkpoint(filled, "one", resume=False) as checkpoint:
        assert len(checkpoint) == 0
        assert checkpoint.note


def test_removed_when_the_work_is_done(filled):
    with Checkpoint(filled, "one") as checkpoint:
        checkpoint.remove()
        assert not filled.exists()
        checkpoint.remove()


def test_a_system_that_deletes_no_open_file(filled, monkeypatch):
    checkpoint, real = Checkpoint(filled, "one"), type(filled).unlink

    def unlink(path, missing_ok=False):
        if not checkpoint._file.closed:
            raise PermissionError
        real(path, missing_ok)

    monkeypatch.setattr(type(filled), "unlink", unlink)
    checkpoint.remove()
    assert not filled.exists()


@pytest.mark.parametrize("taken", [False, True])
def test_windows_locks_a_byte_beyond_all_others(filled, monkeypatch, taken):
    """At the largest 31-bit offset whose next byte is still below 2^31."""
    locked = []

    def locking(handle, mode, count):
        locked.append((os.lseek(handle, 0, os.SEEK_CUR), mode, count))
        if taken:
            raise OSError(errno.EACCES, "taken")

    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    monkeypatch.setattr(module, "sys", SimpleNamespace(platform="".join(["win", "32"])))
    if taken:
        with refused(InputError, received="a file that another run has open"):
            Checkpoint(filled, "one")
    else:
        with Checkpoint(filled, "one") as checkpoint:
            check(checkpoint, PIECES)
    assert locked == [(2**31 - 2, 2, 1)]


def test_a_file_system_without_locks_does_without(filled, monkeypatch):
    def flock(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr("fcntl.flock", flock)
    with Checkpoint(filled, "one") as checkpoint:
        check(checkpoint, PIECES)


def test_one_run_at_a_time(filled):
    program = (
        "import sys; from fieldmap.store.checkpoint import Checkpoint; c = Checkpoint(sys.argv[1], 'one')"
    )
    program += "; print('open', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", program, str(filled)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "open\n"
        for resume in (True, False):
            with refused(InputError, where=str(filled), received="a file that another run has open"):
                Checkpoint(filled, "one", resume)
        other.stdin.close()
    with Checkpoint(filled, "one") as checkpoint:
        check(checkpoint, PIECES)


def test_nobody_waits_who_was_not_asked_to(filled, monkeypatch):
    """With a wait the lock is tried at least ten times a second."""
    slept = []
    monkeypatch.setattr("time.sleep", slept.append)
    with Checkpoint(filled, "one"):
        with pytest.raises(InputError):
            Checkpoint(filled, "one")
        assert slept == []
        begin = time.monotonic()
        with pytest.raises(InputError):
            Checkpoint(filled, "one", wait=0.05)
        assert 0.05 <= time.monotonic() - begin < 1.0
    assert 0 < min(slept) <= max(slept) <= 0.1


def test_a_run_waits_for_another_that_has_the_file_for_a_moment(path):
    with Checkpoint(path, "one") as first, ThreadPoolExecutor() as pool:
        first.put("a", {"x": np.arange(3.0)})
        second = pool.submit(Checkpoint, path, "one", wait=30.0)
        with pytest.raises(TimeoutError):
            second.result(timeout=0.2)
        first.close()
        with second.result(timeout=30.0) as opened:
            assert list(opened) == ["a"]
            with pytest.raises(InputError):
                Checkpoint(path, "one", wait=0.1)


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with refused(InputError, must_hold="can be written", received=os.strerror(errno.ENOTDIR)):
        Checkpoint(tmp_path / "file" / "folder" / "map.partial", "one")
    with refused(InputError, where=str(tmp_path), received=os.strerror(errno.EISDIR)):
        Checkpoint(tmp_path, "one")


def test_a_full_disk_costs_only_the_piece_that_did_not_fit(filled, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Checkpoint(filled, "one") as checkpoint:
        with monkeypatch.context() as patch:
            patch.setattr("os.fsync", full)
            with pytest.raises(FieldmapError) as caught:
                checkpoint.put("fourth", {"field": np.ones(100)})
        assert caught.value.exit_code == 1
        assert caught.value.problems[0].received == os.strerror(errno.ENOSPC)
        check(checkpoint, PIECES)
        checkpoint.put("third", about={"again": 1})
    with Checkpoint(filled, "one") as checkpoint:
        assert tuple(checkpoint) == tuple(PIECES)


def put_many(checkpoint):
    for number in range(100):
        checkpoint.put(str(number), {"values": np.arange(100.0) + number})


def test_a_full_disk_costs_only_the_piece_of_which_it_took_a_part(path):
    resource = pytest.importorskip("resource")  # a limit on the size of files acts like a full disk
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Checkpoint(path, "one") as checkpoint:
        # A buffer would hold small pieces back until the file is closed.
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
            with pytest.raises(FieldmapError):
                put_many(checkpoint)
            written = len(checkpoint)
            assert 10 < written < 30
            np.testing.assert_array_equal(checkpoint.get("3").arrays["values"], np.arange(100.0) + 3)
            checkpoint.close()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with Checkpoint(path, "one") as checkpoint:
        assert len(checkpoint) == written
        checkpoint.put("another", about={"one": 1})
    with Checkpoint(path, "one") as checkpoint:
        assert len(checkpoint) == written + 1
        assert "another" in checkpoint


def test_a_file_deleted_before_it_was_locked_is_made_again(path, monkeypatch):
    real, deleted = os.fstat, []

    def fstat(handle):
        if not deleted:
            deleted.append(path.unlink())
        return real(handle)

    with monkeypatch.context() as patch:
        patch.setattr("os.fstat", fstat)
        checkpoint = Checkpoint(path, "one")
    with checkpoint:
        checkpoint.put("third", about={})
    with Checkpoint(path, "one") as checkpoint:
        assert tuple(checkpoint) == ("third",)
