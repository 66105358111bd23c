"""Slips of the unit: a warning for each value beyond any bench, the same in Python and in files."""

import warnings

import pytest

import fieldmap as fm
from fieldmap.errors import InputError, UnusualValueWarning
from tests.refusals import refused

# Millimetres for metres, grams for kilograms, milliteslas for teslas, milliamperes for amperes.
SLIPS = {
    "CircularCoil.outer_radius": lambda: fm.CircularCoil("1", 2.9, 7.0, 0.02, turns=500),
    "Payload.mass": lambda: fm.Payload(12.0, 0.8),
    "MagnetCylinder.remanence": lambda: fm.MagnetCylinder(0.01, 0.01, 1200.0),
    "Driver.current_limit": lambda: fm.Driver(0.4, 500.0),
    "WorkspaceBox.lower": lambda: fm.WorkspaceBox([-5.0, -1.0, 0.0], [1.0, 1.0, 1.0]),
    "currents": lambda: fm.find_equilibrium(fm.open_map("sample"), 500.0, fm.Payload(0.6, 0.8)),
}
FILE = """
format = 1
name = "slips"
title = "Values that the unit of the key makes large"
[[coil]]
name = "1"
kind = "circular"
inner_radius_mm = 10
outer_radius_mm = 7000
height_mm = 20
turns = 500
[payload]
mass_g = 12000
[payload.magnet]
shape = "cylinder"
diameter_mm = 10
height_mm = 10
remanence_T = 1.2
[driver]
gain_A_per_V = 0.4
current_limit_A = 500
"""


@pytest.mark.parametrize("argument", SLIPS)
def test_a_slip_of_the_unit_is_asked_about_where_it_is_made(argument):
    with pytest.warns(UnusualValueWarning) as told:
        SLIPS[argument]()
    assert [str(one.message).split(":")[0] for one in told] == [argument]
    assert told[0].filename == __file__


def test_a_file_is_asked_by_the_same_limits(tmp_path):
    path = tmp_path / "slips.toml"
    path.write_text(FILE)
    with pytest.warns(UnusualValueWarning) as told:
        fm.read_device(path)
    asked = {str(one.message).split(":")[0] for one in told}
    assert asked == {"CircularCoil.outer_radius", "Payload.mass", "Driver.current_limit"}


def test_what_is_meant_is_taken_without_a_word():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", UnusualValueWarning)
        assert SLIPS["Payload.mass"]().mass == 12.0
        fm.CircularCoil("1", 1.0, 1.1, 0.02, turns=500)
        fm.Payload("text", magnet=fm.MagnetCylinder("0.01", [[1], [1, 2]], None))


def test_a_remanence_that_no_material_has_is_refused(tmp_path):
    path = tmp_path / "slips.toml"
    path.write_text(FILE.replace("remanence_T = 1.2", "remanence_T = 1200"))
    with refused(InputError, where="payload.magnet.remanence_T", received="1200"):
        fm.read_device(path)
    coil = fm.CircularCoil("1", 0.01, 0.02, 0.02, turns=500)
    magnet = fm.PermanentMagnet("magnet", [0.0, 0.0, 4.0], 1.05)
    payload = fm.Payload(0.01, magnet=fm.MagnetSphere(0.01, 4.0))
    with pytest.raises(InputError) as caught:
        fm.Device("d", "t", (coil,), materials={"magnet": magnet}, payload=payload)
    places = sorted(problem.where.split(": ")[-1] for problem in caught.value.problems)
    assert places == ["materials['magnet'].remanence[2]", "payload.magnet.remanence"]
