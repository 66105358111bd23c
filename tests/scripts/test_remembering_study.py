"""The study of hysteresis: its error bars, and the position of the block."""

from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture
def bars(program):
    return program("remembering.bars", "studies")


def test_bars_of_a_linear_figure_are_those_of_its_slopes(bars):
    """A figure of 2 joint - 3 h, with known deviations and correlation."""
    matrix = np.array([[0.04, 0.0, -0.06], [0.0, 9.0, 0.0], [-0.06, 0.0, 0.25]])
    numbers = {"as fitted": np.array(1.0)}
    for name, slope in zip(bars.FITTED, (2.0, 0.0, -3.0), strict=True):
        before, after = bars.FITTED[name]
        numbers[name] = numbers["as fitted"] + slope * (after - before)
    found = bars.Covariance(matrix, 0.5)
    assert bars.bar(found, numbers) == pytest.approx(np.sqrt(4 * 0.04 + 9 * 0.25 + 2 * 2 * 3 * 0.06))
    assert found.deviations == pytest.approx([0.2, 3.0, 0.5])
    assert found.correlation[0, 2] == pytest.approx(-0.6)


def test_values_that_are_changed_are_those_of_the_device(bars, program):
    unit = program("remembering.unit", "studies")
    device = unit.read_device(unit.DEVICE)
    assert bars.FITTED["coercive field, A/m"][0] == device.materials["steel"].coercive_field
    assert bars.FITTED["h, mm"][0] == pytest.approx(1e3 * device.payload.magnet_offset)


def test_the_block_is_as_far_below_the_body_as_in_the_file(program, monkeypatch):
    """The magnet is 9.87 mm below the sensed point in the joint study, and 15 mm in the scenarios."""
    module = program("remembering.unit", "studies")
    monkeypatch.setattr(module.Unit, "scale", 2.0)
    monkeypatch.setattr(module, "simulate", lambda name, given, **_: SimpleNamespace(name=name, given=given))
    unit = module.Unit(None, module.read_device(module.DEVICE), "error", 0.5)
    given = unit.simulate("spikes", {"plate.face_mm": [0.0, 0.0, -109.0]}, field_map=None).given
    assert given["plate.face_mm"][2] == pytest.approx(-109.0 + 15.0 - 9.87)
    assert given["sensors.deviation_mm"] == pytest.approx([0.00271, 0.00419, 0.0052])
    assert (given["control.x.c"], given["control.z.c"]) == (1.0, 1.0)
    assert "control.y.c" not in given
