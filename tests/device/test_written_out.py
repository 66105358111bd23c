"""The shipped devices in short form against their tables in full (written_out.toml)."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from fieldmap.device import read_device
from fieldmap.device.toml_text import toml_text
from fieldmap.iron.symmetry import find_symmetry
from fieldmap.shipped import shipped_file

WRITTEN_OUT = tomllib.loads((Path(__file__).parent / "written_out.toml").read_text())
LONGEST = {"disk_six_cores": 80, "drive_unit": 150, "drive_unit_a3": 125, "eight_coils": 100}


def leaves(data, path=()):
    """Every number and text of a device's file, by its place."""
    if not isinstance(data, dict | list):
        return {path: data}
    entries = data.items() if isinstance(data, dict) else enumerate(data)
    return {place: leaf for key, one in entries for place, leaf in leaves(one, (*path, key)).items()}


def numbers_and_texts(device):
    alone = replace(device, title="Written out", provenance={}, text="")
    found = leaves(tomllib.loads(alone.to_toml()))
    texts = {place: leaf for place, leaf in found.items() if isinstance(leaf, str)}
    return {place: leaf for place, leaf in found.items() if place not in texts}, texts


@pytest.mark.parametrize("name", WRITTEN_OUT)
def test_short_devices_are_those_that_were_written_out(name):
    """To 1e-12 m, body by body in the same order, and with the same symmetry."""
    head = {"format": 1, "name": name, "title": "Written out"}
    short, before = read_device(name), read_device(toml_text(head | WRITTEN_OUT[name]))
    (numbers, texts), (their_numbers, their_texts) = map(numbers_and_texts, (short, before))
    assert texts == their_texts
    assert numbers == pytest.approx(their_numbers, rel=0.0, abs=1e-9)
    assert str(find_symmetry(short)) == str(find_symmetry(before))
    assert len(shipped_file("geometry", name).read_text().splitlines()) < LONGEST.get(name, 75)
