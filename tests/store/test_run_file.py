"""Recorded runs return what was written, and other files are recognised."""

import json

import h5py
import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.store import RunRecord, is_run_file, read_runs, write_runs
from tests.refusals import refused

RUNS = [
    RunRecord({"time": (np.array([0.0, 0.5]), "s", "time"), "x": (np.zeros((0, 2)), "m", "x,y")}, {"event": "fell"}),
    RunRecord({"state": (np.array([[1.0]]), "A", "left")}, {"steps": 3}),
]  # fmt: skip


@pytest.fixture
def path(tmp_path):
    return write_runs(tmp_path / "runs.h5", RUNS, {"title": "two", "scenario": "step"})


def test_runs_and_the_texts_about_them(path):
    assert is_run_file(path)
    found, about = read_runs(path)
    assert about == {"title": "two", "scenario": "step"}
    assert [run.about for run in found] == [{"event": "fell"}, {"steps": 3}]
    for run, given in zip(found, RUNS, strict=True):
        assert run.arrays.keys() == given.arrays.keys()
        for name, (values, *told) in given.arrays.items():
            np.testing.assert_array_equal(run.arrays[name][0], values)
            assert list(run.arrays[name][1:]) == told


def test_the_file_is_laid_out_as_its_description_says(path):
    with h5py.File(path) as file:
        assert (file.attrs["format"], file.attrs["title"]) == ("fieldmap run 1", "two")
        assert list(file) == ["run_0000", "run_0001"]
        state = file["run_0001/state"]
        assert (state.fletcher32, state.attrs["unit"], state.attrs["columns"]) == (True, "A", "left")
        assert json.loads(file["run_0001"].attrs["about"]) == {"steps": 3}


def test_a_number_that_json_does_not_know_is_not_written(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_runs(tmp_path / "runs.h5", [RunRecord({}, {"rms": float("nan")})], {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["fieldmap run 0", "fieldmap run 2", "", None])
def test_another_format(path, name):
    with h5py.File(path, "r+") as file:
        del file.attrs["format"]
        if name is not None:
            file.attrs["format"] = name
    assert not is_run_file(path)
    with refused(InputError, where=str(path), received="another HDF5 file"):
        read_runs(path)


@pytest.mark.parametrize("content", [b"", b"time,x\n", None])
def test_what_is_no_hdf5(tmp_path, content):
    path = tmp_path / "runs.h5"
    if content is not None:
        path.write_bytes(content)
    assert is_run_file(path) is False
    with refused(InputError, where=str(path), must_hold="a file of runs") as caught:
        read_runs(path)
    assert ("No such file" if content is None else "file signature") in caught.value.problems[0].received


@pytest.mark.parametrize(
    ("raised", "told"), [(OSError("one\ntwo\nthree"), "one"), (MemoryError(), "no file of runs")]
)
def test_an_error_of_the_library_is_told_in_one_line(path, monkeypatch, raised, told):
    def fails(*_):
        raise raised

    monkeypatch.setattr("h5py.File", fails)
    with refused(InputError, where=str(path), received=told) as caught:
        read_runs(path)
    assert caught.value.problems[0].received == told


def test_a_seal_is_checked_where_there_is_one(path):
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    with refused(InputError, where=str(path), remedy="simulate again", received="not that of its seal"):
        read_runs(path)


@pytest.mark.parametrize(
    ("change", "must_hold"),
    [
        (lambda file: file.__setitem__("run_0002", np.zeros(3)), "run_0002: a run"),
        (
            lambda file: file["run_0001"].attrs.__setitem__("about", "[1]"),
            "run_0001, about: names and values",
        ),
        (lambda file: file.__setitem__("run_0002", h5py.SoftLink("/run_0001")), "run_0002 inside the file"),
        (lambda file: file["run_0001"].create_group("more"), "run_0001/more: numbers"),
    ],
)
def test_parts_that_are_no_runs(path, change, must_hold):
    with h5py.File(path, "r+") as file:
        change(file)
    with refused(InputError, where=str(path), must_hold=must_hold):
        read_runs(path)
