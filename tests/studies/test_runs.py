"""Runs that are killed, variants that fail, and checks of the output path."""

import re
import signal
import subprocess
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

from fieldmap.errors import FieldmapError, InputError, Problem
from fieldmap.store import Checkpoint, checkpoint_path
from fieldmap.studies import Uncertain, analyse_tolerances, read_study, run_study
from fieldmap.studies.run import finished_variants
from fieldmap.studies.variant_result import reason

RUN = """
import os, signal, sys
from fieldmap.studies import run_study

study, target, moment = sys.argv[1:]

def tell(text, share):
    print(text, flush=True)
    if moment and moment in text:
        os.kill(os.getpid(), signal.SIGKILL)

run_study(study, target, progress=tell)
"""


def run(study, target, moment=""):
    command = [sys.executable, "-c", RUN, str(study), str(target), moment]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def all_numbers(path):
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        return {name: data[name].values.tobytes() for name in data.variables if data[name].dtype != "O"}


@pytest.fixture(scope="module")
def whole(grid, tmp_path_factory):
    """An uninterrupted run; its kernels are cached, as in the runs that are killed."""
    target = tmp_path_factory.mktemp("whole") / "grid.nc"
    done = run(grid, target)
    assert done.returncode == 0, done.stderr
    return target


def test_resumed_after_a_kill(grid, whole, tmp_path):
    target = tmp_path / "grid.nc"
    killed = run(grid, target, "2 of 4 variants")
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not target.exists()
    # A record cut short by the kill.
    with checkpoint_path(target, stays=True).open("ab") as stream:
        stream.write(checkpoint_path(whole, stays=True).read_bytes()[-200:-30])
    resumed = run(grid, target)
    assert resumed.returncode == 0, resumed.stderr
    said = resumed.stdout.splitlines()
    assert "2 of 4" in said[0]
    assert [text[:6] for text in said[1:]] == ["3 of 4", "4 of 4", "comple"]
    assert target.with_suffix(".csv").read_bytes() == whole.with_suffix(".csv").read_bytes()
    assert all_numbers(target) == all_numbers(whole)


def test_another_study_is_not_resumed(grid, whole, tmp_path):
    """Neither after a change of its values, nor after a change of the device file of the same name."""
    study, device = grid.read_text(), (grid.parent / "sphere.toml").read_text()
    radii = study.replace("[8.0, 10.0]", "[9.0]")
    for texts, there in (
        ((study, device), 4),
        ((study, device.replace("4.0", "5.0")), 0),
        ((radii, device), 0),
    ):
        for name, text in zip(("grid.toml", "sphere.toml"), texts, strict=True):
            (tmp_path / name).write_text(text)
        number = read_study(tmp_path / "grid.toml").fingerprint
        assert (number == read_study(grid).fingerprint) == (there > 0)
        checkpoint_path(tmp_path / "copy.nc", stays=True).write_bytes(
            checkpoint_path(whole, stays=True).read_bytes()
        )
        with Checkpoint(checkpoint_path(tmp_path / "copy.nc", stays=True), number) as checkpoint:
            assert len(finished_variants(checkpoint)) == there


def test_workers_give_the_same_data(grid, whole, tmp_path):
    pytest.importorskip("distributed")
    run_study(grid, tmp_path / "grid.nc", workers=2)
    assert (tmp_path / "grid.csv").read_bytes() == whole.with_suffix(".csv").read_bytes()
    assert all_numbers(tmp_path / "grid.nc") == all_numbers(whole)


FAILING = """
format = 1
title = "The second sphere reaches into the workspace"
device = "sphere.toml"
vary = [{ name = "radius", key = "body.sphere.radius_mm", values = [10.0, 13.0] }]
currents = [{ name = "one", amperes_A = 1.0 }, { name = "two", amperes_A = 2.0 }]
record = { quantities = ["field"], points_mm = [[0, 0, -20]] }
"""


def test_a_failed_variant_is_recorded_and_the_rest_goes_on(devices, tmp_path):
    study = devices.study("failing.toml", FAILING)
    done = run_study(study, tmp_path / "failing.nc")
    assert list(done.failed) == ["radius = 13"]
    assert np.isfinite(done.data.flux_density.sel(radius=10.0)).all()
    assert np.isnan(done.data.flux_density.sel(radius=13.0)).all()
    with xarray.open_dataset(done.path, engine="h5netcdf") as data:
        reason = data.problem.sel(radius=13.0, currents="two").item()
        assert "GeometryError" in reason
        assert "workspace" in reason
        assert (data.problem.sel(radius=10.0) == "").all()
    assert "GeometryError" in done.table.read_text().splitlines()[3]


def test_failed_variants_are_solved_again_only_when_asked_to(devices, tmp_path):
    """Also in the run after one that was killed."""
    study, target, said = devices.study("failing.toml", FAILING), tmp_path / "failing.nc", []
    numbers = partial(re.findall, r"\d+")
    tell = {"progress": lambda text, _: said.append([int(one) for one in numbers(text.split(", ")[0])])}
    run_study(study, target)
    run_study(study, target, **tell)
    run_study(study, target, retry=True, **tell)

    def kill(text, _):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, target, retry=True, progress=kill)
    run_study(study, target, **tell)
    again = [[1, 2], [2, 2, 13], []]
    assert said == [[2, 2], [], *again, *again]


def test_what_cannot_be_found_is_the_only_thing_missing(devices, tmp_path):
    text = """
    format = 1
    title = "Too little current for an equilibrium"
    device = "thin_loop.toml"
    vary = [{ name = "turns", key = "coil.loop.turns", values = [1000] }]
    currents = [{ name = "faint", amperes_A = 0.001 }]
    record = { points_mm = [[0, 0, -90]] }
    """
    # The data set holds files of any length, although an attribute of HDF5 holds 64 kB at most.
    text += 2000 * "    # a remark of some fifty characters, again and again\n"
    done = run_study(devices.study("faint.toml", text), tmp_path / "faint.nc")
    at = done.data.isel(turns=0, currents=0)
    assert np.isfinite(at.flux_density).all()
    assert np.isnan(at.stiffness_z)
    reasons = at.problem.item().split(" || ")
    assert [reason.split(":")[0] for reason in reasons] == ["equilibrium", "equilibrium_area"]
    assert "NoEquilibrium" in reasons[0]


def test_the_place_of_the_output(grid, tmp_path):
    (tmp_path / "folder.nc").mkdir()
    (tmp_path / "file").write_text("")
    for name, words in (
        ("grid.csv", "must end in .nc"),
        ("folder.nc", "a folder"),
        ("file/grid.nc", f"{tmp_path}/file"),
    ):
        with pytest.raises(InputError, match=re.escape(words)):
            run_study(grid, tmp_path / name)


def test_missing_libraries_are_named_with_their_extra(grid, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    with pytest.raises(FieldmapError, match=r"\[studies\]"):
        run_study(grid, tmp_path / "grid.nc")
    assert not list(tmp_path.iterdir())


def test_progress_is_told_in_words_and_shares(devices, tmp_path):
    told, study = [], devices.study("failing.toml", FAILING)
    run_study(study, tmp_path / "failing.nc", progress=lambda *of: told.append(of))
    assert [text.split(", ")[0] for text, _ in told] == [
        "solving 2 variants",
        "1 of 2 variants: radius = 10",
        "2 of 2 variants: radius = 13",
        "complete",
    ]
    assert all(re.search(r", [\d.]+ (variants/s|s a variant)$", text) for text, _ in told[1:3])
    assert [share for _, share in told] == [0.0, pytest.approx(0.5), 1.0, 1.0]
    told.clear()
    run_study(study, tmp_path / "failing.nc", retry=True, progress=lambda *of: told.append(of))
    assert [(text.split(", ")[0], share) for text, share in told] == [
        ("resumed with 1 of 2 variants", 0.0),
        ("2 of 2 variants: radius = 13", 1.0),
        ("complete", 1.0),
    ]


class Dead:
    """Worker processes of which every second task fails."""

    def __init__(self, *_):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def processes(self):
        return 2

    def map(self, function, things, common):
        for k, thing in enumerate(things):
            value = None if k % 2 else function(common.here(), thing)
            yield SimpleNamespace(index=k, value=value, reason="the process died")


def test_a_variant_or_design_whose_process_dies_is_recorded(devices, tmp_path, monkeypatch):
    monkeypatch.setattr("fieldmap.studies.run.Workers", Dead)
    study = devices.study("failing.toml", FAILING.replace("13.0", "9.0"))
    done = run_study(study, tmp_path / "dead.nc")
    assert done.failed == {"radius = 9": ("variant: the process died",)}
    assert np.isnan(done.data.flux_density.sel(radius=9.0)).all()
    assert np.isfinite(done.data.flux_density.sel(radius=10.0)).all()
    monkeypatch.setattr("fieldmap.studies.search.Workers", Dead)
    found = analyse_tolerances(devices.loop, [Uncertain("coil.loop.turns", 1.0)], ["power"], samples=8)
    assert (list(found.failed.values()), found.numbers[0].sampled.count) == (["the process died"] * 4, 4)


def test_what_is_recorded_of_a_failure():
    """What was computed, the kind of error, and each of its problems, in one line."""
    problems = [Problem(f"at {k}", "must hold", f"{k}", "mend it") for k in (1, 2)]
    exact = "area: InputError: at 1: must hold; received 1; mend it | at 2: must hold; received 2; mend it"
    assert reason("area", InputError(*problems)) == exact
    assert reason("variant", ValueError("no number")) == "variant: ValueError: no number"
