"""The unit led out and back with iron that remembers, on a coarse mesh; measured: Table 6-4."""

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import InputError
from fieldmap.iron import HysteresisSolver, Pinning
from fieldmap.store import Checkpoint
from fieldmap.thesis.hysteresis import Protocol, cached_shift, prepared, walk, x_remanence
from fieldmap.thesis.printed import read_part

SIGNALS = np.array([0.0, 0.1, 0.2, 0.1])


@pytest.fixture(scope="module")
def unit():
    return HysteresisSolver(read_device("drive_unit"), Pinning(0.0, 1), refinement=0.4)


def led(unit, pinning, protocol):
    solver = unit.with_pinning(pinning)
    return walk(solver, prepared(solver, "demagnetised", protocol, 0.2), SIGNALS, protocol)


def test_without_pinning_the_way_back_is_the_way_out(unit):
    found = led(unit, Pinning(0.0, 1), Protocol(rule="constant"))
    shift = 1e3 * found.shift("x")
    assert shift[3] == pytest.approx(shift[1], abs=1e-3)
    assert 1.0 < shift[1] < shift[2]


def test_remanent_loops_lead_and_the_lift_is_held(unit):
    """On the way back the magnet lies nearer to the origin, as measured: a lag would have the other sign."""
    found = led(unit, Pinning(400.0, 3), Protocol())
    shift = 1e3 * found.shift("x")
    inputs = read_part("S14_x_remanence").inputs
    measured = (inputs["back_mm"] - inputs["outward_mm"])[inputs["signals"] == 0.1]
    assert 0.5 < (shift[3] - shift[1]) / measured[0] < 1.5
    assert found.lifts == pytest.approx(np.full(4, found.lifts[0]), rel=2e-3)


def test_a_run_begins_at_nought():
    with pytest.raises(InputError) as error:
        walk(None, None, [0.1], Protocol())
    assert error.value.problems[0].received == "0.1"


def test_rows_hold_what_was_measured(monkeypatch):
    """The row sets our widths in order beside the measured ones: fed the measured branches, both must agree."""
    inputs = dict(read_part("S14_x_remanence").inputs)
    way = np.concatenate([inputs["outward_mm"], inputs["back_mm"][-2::-1]])
    monkeypatch.setattr(
        "fieldmap.thesis.hysteresis.cached_shift", lambda *_: 1e-3 * (way - inputs["outward_mm"][0])
    )
    monkeypatch.setattr("fieldmap.thesis.hysteresis.static_places", lambda *_: inputs["outward_mm"])
    width = x_remanence(inputs).numbers["width"]
    printed = [float(n.text) for n in read_part("S14_x_remanence").numbers["width"]]
    assert width.ravel() == pytest.approx(printed, abs=1e-9)


def test_the_file_is_free_while_a_run_computes(monkeypatch, tmp_path):
    computed = []

    def compute(*_):
        (file,) = tmp_path.iterdir()
        with Checkpoint(file, "of another run", resume=False):
            pass  # raises where the file is locked
        computed.append(1)
        return np.arange(3.0)

    monkeypatch.setattr("fieldmap.thesis.hysteresis._shift", compute)
    for _ in range(2):
        found = cached_shift(Pinning(0.0, 1), Protocol(), SIGNALS, tmp_path)
        assert found.tolist() == [0.0, 1.0, 2.0]
    assert len(computed) == 1
