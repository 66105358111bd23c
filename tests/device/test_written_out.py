"""The shipped devices in short form against the tables that they stand for (written_out.toml)."""

import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.device.toml_text import toml_text
from fieldmap.iron.symmetry import find_symmetry
from fieldmap.shipped import shipped_file

WRITTEN_OUT = tomllib.loads((Path(__file__).parent / "written_out.toml").read_text())
PARTS = (
    "coils",
    "bodies",
    "materials",
    "payload",
    "driver",
    "workspace",
    "references",
    "sections",
)
LONGEST = {"disk_six_cores": 80, "drive_unit": 150, "drive_unit_a3": 125, "eight_coils": 100}


def largest_difference(one, other, path=""):
    """The largest difference of two numbers, all the way down, and where; all else must be equal."""
    if isinstance(one, np.ndarray | float | int) and not isinstance(one, bool):
        assert np.shape(one) == np.shape(other), path
        return max(float(np.max(np.abs(np.subtract(one, other)), initial=0.0)), 0.0), path
    if is_dataclass(one):
        assert type(one) is type(other), path
        pairs = [(getattr(one, f.name), getattr(other, f.name), f"{path}.{f.name}") for f in fields(one)]
    elif isinstance(one, dict):
        assert list(one) == list(other), path
        pairs = [(one[key], other[key], f"{path}.{key}") for key in one]
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), path
        pairs = [(a, b, f"{path}.{k}") for k, (a, b) in enumerate(zip(one, other, strict=True))]
    else:
        assert one == other, path
        return 0.0, path
    return max((largest_difference(*pair) for pair in pairs), default=(0.0, path))


def written_out(name):
    head = {"format": 1, "name": name, "title": "Written out"}
    return read_device(toml_text(head | WRITTEN_OUT[name]))


@pytest.mark.parametrize("name", WRITTEN_OUT)
def test_short_devices_are_those_that_were_written_out(name):
    """To 1e-12 m, body by body in the same order, and with the same symmetry."""
    short, before = read_device(name), written_out(name)
    for part in PARTS:
        assert largest_difference(getattr(short, part), getattr(before, part), part)[0] <= 1e-12
    assert str(find_symmetry(short)) == str(find_symmetry(before))


@pytest.mark.parametrize("name", WRITTEN_OUT)
def test_shipped_devices_are_short(name):
    assert len(shipped_file("geometry", name).read_text().splitlines()) < LONGEST.get(name, 75)
