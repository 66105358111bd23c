"""Runs that are killed, and runs that must not be resumed."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fieldmap.errors import FieldmapError
from fieldmap.store import FieldError, checkpoint_path, open_writer, read_map, write_map
from tests.store.conftest import numbers_in

# Writes the map of conftest.py (9 chunks) and kills itself before or after the n-th sync to the disk: 1 the beginning,
# 2 the solution, 3 to 11 the chunks, 12 the seal of the finished file.
KILLED_RUN = """
import os, signal, sys
from importlib.util import module_from_spec, spec_from_file_location
from fieldmap.store import open_writer

spec = spec_from_file_location("conftest", sys.argv[1])
conftest = module_from_spec(spec)
spec.loader.exec_module(conftest)
count, late = int(sys.argv[3]), sys.argv[4] == "after"
real, seen = os.fsync, [0]

def dying(file):
    seen[0] += 1
    if seen[0] == count and not late:
        os.kill(os.getpid(), signal.SIGKILL)
    real(file)
    if seen[0] == count:
        os.kill(os.getpid(), signal.SIGKILL)

os.fsync = dying
data = conftest.make_map(shape=(9, 20, 30))
with open_writer(sys.argv[2], data) as writer:
    writer.checkpoint.put("solution", {"charge": data.gradient[0, 0, 0]}, {"iterations": 3})
    for chunk in writer.missing:
        planes = slice(chunk.first, chunk.last)
        writer.write(chunk, data.flux_density[:, planes], data.gradient[:, planes])
    writer.finish({"iterations": 7})
"""


@pytest.mark.parametrize(
    ("count", "late"),
    [
        (1, "before"),
        (1, "after"),
        (3, "before"),
        (4, "after"),
        (5, "before"),
        (11, "after"),
        (12, "before"),
        (12, "after"),
    ],
)
def test_a_killed_run_is_resumed_to_the_same_bytes(large, whole, tmp_path, count, late):
    target = tmp_path / "map.h5"
    conftest = Path(__file__).with_name("conftest.py")
    command = [sys.executable, "-c", KILLED_RUN, str(conftest), str(target), str(count), late]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert not target.exists()
    data = large
    with open_writer(target, data) as writer:
        survived = count if late == "after" else count - 1
        if survived >= 1:
            assert writer.note == ""
            assert writer.resumed >= min(9, max(0, survived - 2))
        if survived >= 2:
            arrays, about = writer.checkpoint.get("solution")
            np.testing.assert_array_equal(arrays["charge"], data.gradient[0, 0, 0])
            assert about == {"iterations": 3}
        write(writer, data, writer.missing)
        writer.finish({"iterations": 7})
    assert numbers_in(target) == whole
    assert read_map(target).provenance.solver_report == {"iterations": 7}
    assert not checkpoint_path(target).exists()


@pytest.fixture(scope="module")
def whole(make_map, tmp_path_factory):
    """The numbers of the map written in one go."""
    return numbers_in(write_map(tmp_path_factory.mktemp("whole") / "map.h5", make_map(shape=(9, 20, 30))))


def write(writer, data, chunks):
    for chunk in chunks:
        planes = slice(chunk.first, chunk.last)
        writer.write(chunk, data.flux_density[:, planes], data.gradient[:, planes])


def half_written(target, data):
    with open_writer(target, data) as writer:
        write(writer, data, writer.chunks[:4])


@pytest.fixture
def large(make_map):
    return make_map(shape=(9, 20, 30))


def test_found_again(large, tmp_path):
    half_written(tmp_path / "map.h5", large)
    with open_writer(tmp_path / "map.h5", large) as writer:
        assert writer.resumed == 4
        assert [chunk.number for chunk in writer.missing] == [4, 5, 6, 7, 8]
        flux, gradient = writer.read(writer.chunks[2])
        np.testing.assert_array_equal(flux, large.flux_density[:, 2:3])
        np.testing.assert_array_equal(gradient, large.gradient[:, 2:3])
        with pytest.raises(ValueError, match="5 of 9"):
            writer.finish({})


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"fingerprint": "xyz"}, "fingerprint"),
        ({"recipe_text": "spacing_mm = 5\n"}, "recipe"),
        ({"device_text": "title = 1"}, "device file"),
        ({"versions": {"fieldmap": "0.2.0"}}, "versions"),
        ({"coil_names": ("1", "2")}, "coil names"),
        ({"reference_current": 2.0}, "reference current"),
        ({"shape": (9, 20, 31)}, "shape"),
    ],
)
def test_another_map_is_not_resumed_and_says_why(large, make_map, tmp_path, changed, named):
    half_written(tmp_path / "map.h5", large)
    with open_writer(tmp_path / "map.h5", make_map(**({"shape": (9, 20, 30)} | changed))) as writer:
        assert writer.resumed == 0
        assert named in writer.note


def test_a_later_date_is_no_reason_to_begin_anew(large, make_map, tmp_path):
    half_written(tmp_path / "map.h5", large)
    later = make_map(shape=(9, 20, 30), created="2027-01-01 00:00:00 +0000")
    with open_writer(tmp_path / "map.h5", later) as writer:
        assert writer.resumed == 4


def test_begun_anew_on_request(large, tmp_path):
    half_written(tmp_path / "map.h5", large)
    with open_writer(tmp_path / "map.h5", large, resume=False) as writer:
        assert writer.resumed == 0
        assert writer.note


def test_a_map_in_memory_is_written_as_it_is(large, tmp_path):
    """The parts are not read; the run's own statements are kept."""
    bounds = {"harmonic": FieldError(3e-9, 5e-7)}
    with open_writer(tmp_path / "map.h5", large) as writer:
        path = writer.finish({"iterations": 7}, ("linear",), FieldError(1e-9, 2e-7), bounds, data=large)
    found = read_map(path)
    np.testing.assert_array_equal(found.flux_density, large.flux_density)
    assert (found.provenance.solver_report, found.provenance.assumptions) == ({"iterations": 7}, ("linear",))
    assert (found.interpolation_error, found.error_bounds) == (FieldError(1e-9, 2e-7), bounds)
    assert os.listdir(tmp_path) == ["map.h5"]


def test_a_part_that_is_missing_cannot_be_read(large, tmp_path):
    half_written(tmp_path / "map.h5", large)
    with open_writer(tmp_path / "map.h5", large) as writer, pytest.raises(KeyError):
        writer.read(writer.chunks[5])


def test_numbers_that_are_not_finite_are_not_written(large, tmp_path):
    with open_writer(tmp_path / "map.h5", large) as writer:
        flux = large.flux_density[:, :1].copy()
        flux[0, 0, 3, 4, 1] = np.inf
        with pytest.raises(FieldmapError) as caught:
            writer.write(writer.chunks[0], flux, large.gradient[:, :1])
        assert caught.value.problems[0].where.startswith("map.h5")
        assert caught.value.problems[0].where.endswith(" 0 to 0")
        assert len(writer.missing) == 9


def test_a_full_disk_at_the_end_is_told_and_can_be_resumed(large, tmp_path, monkeypatch):
    from fieldmap.store import map_writer

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    half_written(tmp_path / "map.h5", large)
    with open_writer(tmp_path / "map.h5", large) as writer:
        write(writer, large, writer.missing)
        with monkeypatch.context() as patch:
            patch.setattr(map_writer, "seal_map", full)
            with pytest.raises(FieldmapError) as caught:
                writer.finish({})
        assert caught.value.exit_code == 1
        assert caught.value.problems[0].received == os.strerror(errno.ENOSPC)
    assert os.listdir(tmp_path) == ["map.h5.partial"]
    with open_writer(tmp_path / "map.h5", large) as writer:
        assert writer.missing == ()
        writer.finish({})
    assert os.listdir(tmp_path) == ["map.h5"]
