"""Measurements on a machine against the lines that the thesis prints: section 3.3.1 and (7-18)."""

import pytest

from fieldmap.device.measured import measured_machine, measured_on


def test_the_drive_unit_as_printed():
    machine = measured_machine("drive_unit")
    # 10 mm of reading is 87 mm below the pole disk; (7-18): i = 0.0343 d + 1.215.
    assert machine.height(10.0) == pytest.approx(-0.087)
    assert machine.height(10.0, magnet_offset=0.015) == pytest.approx(-0.102)
    assert [machine.lift_current(d) for d in (0.0, 10.0, 40.0)] == pytest.approx([1.215, 1.558, 2.587])
    assert machine.lift_source == "(7-18)"


def test_shifts_count_from_what_was_read_at_signal_0():
    """Table 6-2; the shift at signal 0 is -0.088 mm (Table 6-4), a row that the table of n = 1.5 lacks."""
    first, second = measured_machine("drive_unit").shifts
    assert (first.n, second.n) == (1.25, 1.5)
    assert (first.reading_mm, second.reading_mm) == (10.0, 10.0)
    assert (first.zero_mm, second.zero_mm) == (-0.088, -0.088)
    assert (first.x_signals[0], first.x_mm[0], first.x_mm[-1]) == (0.05, 0.844, 9.329)
    assert (second.x_signals[-1], second.x_mm[-1]) == (0.39, 10.67)
    assert len(first.x_mm) == len(first.x_signals) == 8


@pytest.mark.parametrize("reading", [0.0, 12.5, 40.0])
@pytest.mark.parametrize("offset", [0.0, 0.015])
def test_reading_and_height_are_inverse(reading, offset):
    machine = measured_machine("drive_unit")
    assert machine.reading_mm(machine.height(reading, offset), offset) == pytest.approx(reading, abs=1e-12)
    # The reading counts downward: 1 mm more reading is 1 mm less height.
    assert machine.height(reading + 1.0, offset) - machine.height(reading, offset) == pytest.approx(-1e-3)


@pytest.mark.parametrize(
    ("name", "coils", "machine"),
    [
        ("drive_unit", 6, "drive_unit"),
        ("drive_unit_no_centre_core", 6, "drive_unit"),
        ("drive_unit", 5, None),
        ("old_drive_unit", 6, None),
        ("", 6, None),
    ],
)
def test_a_device_describes_a_machine_by_name_and_number_of_coils(name, coils, machine):
    found = measured_on(name, coils)
    assert (found and found.device) == machine


def test_a_machine_without_measurements():
    with pytest.raises(KeyError):
        measured_machine("loop_and_sphere")
