"""Files of runs that somebody damaged or made: refused, and no other file is read for them."""

import os

import h5py
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device import recorded_device
from fieldmap.errors import InputError
from fieldmap.plot.gather import shown_run
from fieldmap.store import RunRecord, read_runs, seal_map, write_runs
from fieldmap.store.seal import SEAL_LENGTH

TIME = np.linspace(0.0, 1.0, 40)
DEVICE = """format = 1
name = "a"
title = "a"
[material.steel]
kind = "bh_table"
file = "{file}"
below = "straight line to the origin"
above = "slope mu0"
[[body]]
name = "b"
material = "steel"
shape = "sphere"
radius_mm = 5
mesh_size_mm = 2
[payload]
mass_g = 1
[[payload.piece]]
shape = "soft_sphere"
diameter_mm = 2
material = "steel"
[[coil]]
name = "c"
kind = "circular"
inner_radius_mm = 10
outer_radius_mm = 12
height_mm = 5
turns = 10
"""
SOUND = DEVICE.format(file="materials/steel_a3.toml")


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


def elsewhere(file, good):
    return h5py.ExternalLink(str(good), "/run_0000/time")


def virtual(file, good):
    layout = h5py.VirtualLayout((40,), "f8")
    layout[...] = h5py.VirtualSource(str(good), "/run_0000/time", shape=(40,))
    return layout


@pytest.mark.parametrize(
    "change", ["link", "virtual", "raw", "giant", "packed", "group", "list", "null", "short"]
)
def test_what_is_no_run(path, tmp_path, change):
    good = write(tmp_path / "other.h5")
    with h5py.File(path, "r+") as file:
        run = file["run_0000"]
        if change in ("list", "null"):
            run.attrs["about"] = {"list": "[1]", "null": "null"}[change]
        else:
            del run["time"]
        if change == "link":
            run["time"] = elsewhere(file, good)
        elif change == "virtual":
            run.create_virtual_dataset("time", virtual(file, good))
        elif change == "raw":
            run.create_dataset("time", (40,), "f8", external=[(str(good), 0, 320)])
        elif change == "giant":
            run.create_dataset("time", (10**12,), "f8", chunks=(100,))
        elif change == "packed":
            run.create_dataset("time", data=np.zeros(10**5), compression="gzip")
        elif change == "group":
            run.create_group("time")
        elif change == "short":
            run.create_dataset("time", data=TIME[:7])
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
    """A curve in the working folder, of the name that a map or a run recorded, is somebody else's."""
    monkeypatch.chdir(tmp_path)
    curve = 'format = 1\nname = "x"\ntitle = "x"\nH_A_per_m = [1e3, 2e3]\nB_T = [1.0, 1.1]\n'
    (tmp_path / "secret.toml").write_text(curve)
    text = DEVICE.format(file="secret.toml")
    assert fm.read_device(text).materials["steel"].b.tolist() == [1.0, 1.1]
    opened = []
    monkeypatch.setattr("fieldmap.device.reader.MATERIAL", _Seen(opened))
    recorded_device(text)
    assert not opened
    recorded_device(DEVICE.format(file="materials/steel_a3.toml"))
    assert [os.path.basename(one) for one in opened] == ["steel_a3.toml"]


class _Seen:
    def __init__(self, opened):
        from fieldmap.device.schema import MATERIAL

        self.load = lambda path: (opened.append(path), MATERIAL.load(path))[1]
