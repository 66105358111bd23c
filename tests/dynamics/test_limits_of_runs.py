"""Every limit at which a run ends: a case just inside, and one just beyond."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.control import PID
from fieldmap.dynamics import (
    AxisReading,
    CoilDrive,
    Schedule,
    Walls,
    pid_block,
    simulate_closed_loop,
    state_of,
)
from fieldmap.errors import InputError
from fieldmap.instruments import Amplifier, Converter
from tests.dynamics.machines import GAIN, PERIOD, one_coil
from tests.refusals import refused

REST = np.array([0, 0, 5e-3, 0, 0, 5e-3, 1.0])
NEAR = 2e-5


@pytest.fixture
def machine(axial):
    """2 A carry the body at the origin; its surface is 6 mm below, 7 mm above and 5 mm to the side."""
    return one_coil(axial, skin=[[0, 0, -6e-3], [0, 0, 7e-3], [5e-3, 0, 0]])


def run(machine, samples, feedforward=(), start=None, step=1e-4, **limits):
    """A run at 5 V, which give 2 A, plus the feed-forward."""
    pid = PID(Kc=0.0, Ti=0.4, Td=0.06, Ts=PERIOD, **limits)
    ahead = np.zeros((samples, 1))
    ahead[: len(feedforward), 0] = feedforward
    schedule = Schedule(np.tile([0.0, 0.0, 5e-3], (samples, 1)), PERIOD, step=step, feedforward=ahead)
    block = pid_block(pid, AxisReading("z", 1e3), 2.0 / GAIN, REST)
    return simulate_closed_loop(
        machine, block, schedule, state_of([0, 0, 0]) if start is None else start, [2.0]
    )


LIMITS = {
    "output": ({}, {"upper": 5.5}),
    "input of the amplifier": ({"amplifier": Amplifier(GAIN, -10.0, 5.5)}, {}),
    "current of the amplifier": ({"amplifier": Amplifier(GAIN, current_upper=2.2)}, {}),
    "converter": ({"amplifier": Amplifier(GAIN), "converter": Converter(5.5, 24)}, {}),
    "supply": (
        {"amplifier": Amplifier(GAIN), "resistance": 4.0, "inductance": 1e-6, "supply": (-90.0, 8.8)},
        {},
    ),
}


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize(("beyond", "held"), [(-0.002, False), (0.002, True)])
def test_a_limit_holds_from_its_value_on(machine, name, beyond, held):
    """The limits are 5.5 V at the output, or the resulting 2.2 A and 8.8 V."""
    drive, limits = LIMITS[name]
    driven = machine if not drive else replace(machine, drive=CoilDrive(coils=1, **drive))
    found = run(replace(driven, longest_saturation=5 * PERIOD), 7, np.full(7, 0.5 + beyond), **limits)
    assert (found.event is not None) == held
    if held:
        assert found.event.name == "current saturates"
        assert found.event.time == pytest.approx(5 * PERIOD)
        assert found.event.currents[0] == pytest.approx(2.2, abs=1e-5)


@pytest.mark.parametrize(
    ("longest", "periods"),
    [(0.02, 10), (0.0201, 11), (0.0199, 10), (0.0029, 2), (0.005, 3), (0.001, 1), (0.006, 3), (1e-12, 1)],
)
def test_a_limit_ends_a_run_after_whole_periods_that_are_no_shorter(machine, longest, periods):
    """Periods of 2 ms. One period less does not end the run, nor does it after a period below the limit."""
    held = replace(machine, longest_saturation=longest)
    less = [1.0] * (periods - 1) + [0.0] + [1.0] * (periods - 1) + [0.0]
    assert run(held, len(less) + 2, less, upper=5.5).event is None
    found = run(held, len(less) + periods + 2, less + [1.0] * periods, upper=5.5).event
    assert found.name == "current saturates"
    assert found.time == pytest.approx((len(less) + periods) * PERIOD)


def test_no_longest_saturation_is_never(machine):
    assert run(machine, 12, np.ones(12), upper=5.5).event is None


@pytest.mark.parametrize("longest", [-1e-3, np.nan, np.inf])
def test_a_longest_saturation_is_no_negative_number(machine, longest):
    with refused(InputError, where="Machine(longest_saturation)", received=f"{longest}"):
        replace(machine, longest_saturation=longest)


@pytest.mark.parametrize(
    ("walls", "event", "touched"),
    [
        (lambda off: Walls(floor=-6e-3 - off), "hit the floor", "floor"),
        (lambda off: Walls(ceiling=7e-3 + off), "hit the pole", "ceiling"),
        (lambda off: Walls(radius=5e-3 + off), "hit the tube", "tube"),
        (lambda off: Walls(radius=4e-3 + off, axis=(1e-3, 0.0)), "hit the tube", "tube"),
    ],
)
@pytest.mark.parametrize("ends", [True, False])
def test_a_wall_is_met_where_it_stands(machine, walls, event, touched, ends):
    ending = {"ending": (touched,) if ends else ()}
    inside = run(replace(machine, walls=walls(NEAR), **ending), 3)
    assert (inside.event, inside.touched) == (None, ())
    beyond = run(replace(machine, walls=walls(-NEAR), **ending), 3)
    assert (beyond.event.name if beyond.event else None) == (event if ends else None)
    assert beyond.touched == (touched,)


@pytest.mark.parametrize(
    ("axis", "side", "event"),
    [
        *((axis, side, "left the map") for axis in (0, 1) for side in (-1, 1)),
        (2, -1, "fell out"),
        (2, 1, "hit the pole"),
    ],
)
def test_a_run_ends_at_the_faces_of_the_map(machine, axis, side, event):
    """The faces are at 20 mm; one step of 2 ms, in which forces move the body by less than 10 um."""
    outward = side * np.eye(3)[axis]
    for moves, ends in ((8e-5, False), (12e-5, True)):
        start = state_of(19.9e-3 * outward, moves / PERIOD * outward)
        found = run(machine, 1, start=start, step=PERIOD).event
        assert (found.name if found else None) == (event if ends else None)
