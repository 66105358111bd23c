"""Run files that were damaged or forged are refused, and no other file is read for them."""

import os

import h5py
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device import reader, recorded_device
from fieldmap.errors import InputError
from fieldmap.plot.gather import shown_run
from fieldmap.store import RunRecord, read_runs, seal_map, write_runs
from fieldmap.store.seal import SEAL_LENGTH
from tests.conftest import DEVICES

TIME = np.linspace(0.0, 1.0, 40)
SOUND = (DEVICES / "ball_bead_and_coil.toml").read_text()
ELSEWHERE = SOUND.replace("materials/steel_a3.toml", "secret.toml")


@pytest.fixture
def path(tmp_path):
    return write(tmp_path / "run.h5")


def write(path, device=SOUND, **texts):
    place = np.column_stack([TIME, 0 * TIME, TIME - 1])
    arrays = dict.fromkeys(("position", "sensed", "reference"), (place, "m", "x, y, z"))
    arrays |= {"time": (TIME, "s", "time"), "currents": (TIME[:, None], "A", "c")}
    arrays["quaternion"] = (np.tile([1.0, 0, 0, 0], (40, 1)), "1", "w, x, y, z")
    about = {"title": "A run", "scenario": "[body]\nradius_mm = 3\nheight_mm = 4\n", "device": device}
    return write_runs(path, [RunRecord(arrays, {"event": "fell"})], about | texts)


def test_a_sound_file(path):
    run = shown_run(path).run
    assert run.body == pytest.approx((3e-3, 4e-3))
    assert (run.event, run.device.coil_names) == ("fell", ("c",))
    np.testing.assert_array_equal(run.currents[:, 0], TIME)


def test_every_changed_byte_is_seen(path):
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(good) - SEAL_LENGTH, 60):
        raw = bytearray(good)
        raw[place] ^= int(rng.integers(1, 256))
        path.write_bytes(raw)
        with pytest.raises(InputError):
            read_runs(path)


def test_a_file_of_before_has_no_seal(path):
    with h5py.File(path, "r+") as file:
        file.attrs["title"] = "Changed, which cuts the seal off"
    assert read_runs(path)[1]["title"].startswith("Changed")


def virtual(good):
    layout = h5py.VirtualLayout((40,), "f8")
    layout[...] = h5py.VirtualSource(good, "/run_0000/time", shape=(40,))
    return layout


# In place of the run's times: name -> how it is made, given another valid file.
MADE = {
    "link": lambda run, good: run.__setitem__("time", h5py.ExternalLink(good, "/run_0000/time")),
    "virtual": lambda run, good: run.create_virtual_dataset("time", virtual(good)),
    "raw": lambda run, good: run.create_dataset("time", (40,), "f8", external=[(good, 0, 320)]),
    "giant": lambda run, good: run.create_dataset("time", (10**12,), "f8", chunks=(100,)),
    "packed": lambda run, good: run.create_dataset("time", data=np.zeros(10**5), compression="gzip"),
    "group": lambda run, good: run.create_group("time"),
    "short": lambda run, good: run.create_dataset("time", data=TIME[:7]),
}


@pytest.mark.parametrize("change", [*MADE, "[1]", "null"])
def test_what_is_no_run(path, tmp_path, change):
    good = str(write(tmp_path / "other.h5"))
    with h5py.File(path, "r+") as file:
        run = file["run_0000"]
        if change in MADE:
            del run["time"]
            MADE[change](run, good)
        else:
            run.attrs["about"] = change
        for data in run.values() if change in ("giant", "packed", "short") else ():
            data.attrs["unit"] = data.attrs["columns"] = "s"
    seal_map(path)
    with pytest.raises(InputError):
        shown_run(path)


@pytest.mark.parametrize(
    "texts",
    [
        {"scenario": "a = [[["},
        {"scenario": "a = " + "[" * 5000},
        {"device": "no device"},
        {"device": 'include = "secret.toml"\n' + SOUND},
    ],
)
def test_texts_that_are_none(tmp_path, monkeypatch, texts):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret.toml").write_text("[driver]\ngain_A_per_V = 1\ncurrent_limit_A = 3\n")
    with pytest.raises(InputError):
        shown_run(write(tmp_path / "run.h5", **texts))


def test_a_recorded_device_reads_no_file_but_shipped_ones(tmp_path, monkeypatch):
    """A curve file in the working folder that has the name recorded in a map or a run is not used."""
    monkeypatch.chdir(tmp_path)
    curve = 'format = 1\nname = "x"\ntitle = "x"\nH_A_per_m = [1e3, 2e3]\nB_T = [1.0, 1.1]\n'
    (tmp_path / "secret.toml").write_text(curve)
    assert fm.read_device(ELSEWHERE).materials["steel"].b.tolist() == [1.0, 1.1]
    opened = []
    read = reader._material_file
    monkeypatch.setattr(reader, "_material_file", lambda path: (opened.append(path), read(path))[1])
    recorded_device(ELSEWHERE)
    assert not opened
    recorded_device(SOUND)
    assert [os.path.basename(one) for one in opened] == ["steel_a3.toml"]
