"""The rows of the linked loop on a map made up: that they run, and what must hold on any such machine."""

import numpy as np
import pytest

from fieldmap.dynamics import Plate, simulate
from fieldmap.lookup import open_map
from fieldmap.thesis import linked_loop


@pytest.fixture(scope="module")
def inputs(six_coils):
    numbers = {
        "push_mm": 0.05,
        "small_gain": 0.1,
        "radii_mm": [0.5],
        "rates_rad_per_s": [0.16],
        "settled_s": 12.0,
    }
    return {"map": open_map(six_coils), **numbers}


def test_the_vertical_row(inputs):
    numbers = {name: ours.value for name, ours in linked_loop.vertical(inputs).items()}
    assert 0.0 < numbers["rise_time"] < numbers["peak_time"] < numbers["settling_time"] < 3.0
    # What is seen at rest is the sensor's noise and what the loop makes of it.
    assert 0.0104 * 0.95 < numbers["rms_at_rest"] < 2 * 0.0104


def test_the_horizontal_row_is_the_noise_of_crossed_sensors_at_rest(inputs):
    rms = linked_loop.horizontal(inputs)["rms_at_rest"].value
    assert rms == pytest.approx([0.00706, 0.00706], rel=0.2)


def test_the_rows_of_spikes_and_circles_run(inputs):
    answers = linked_loop.spikes(inputs)
    assert set(answers.numbers) == {"spike", "with_compensator"}
    assert answers.numbers["spike"].value > 0
    assert "gain 0.1" in answers.explanations[""]
    assert linked_loop.circles(inputs)["vertical_rms"].value[0] > 0.009


def test_the_block_damps_the_sway_as_its_formula_says(inputs):
    """The decay of an open-loop swing without and with the block: (drag + block) / 2 m against the peaks."""
    mass, place = 0.01119, np.array([0.0, 0.0, -0.102])
    block = Plate(3.5e7, 0.05, (0.0, 0.0, -0.109)).damping(tuple(place), (0.0, 0.0, 0.8126))[0, 0]
    for name, loss in (("horizontal_open_loop", 0.005), ("horizontal_open_loop_plate", 0.005 + block)):
        changes = {
            "start.shift_mm": [0.5, 0.0, 0.0],
            "signal.0.by": 0.0,
            "noise.off": True,
            "duration_s": 3.0,
        }
        run = simulate(name, changes, field_map=inputs["map"])
        x = run.sensed[:, 0]
        spring = 0.01119 * _square_of_rate(simulate("horizontal_open_loop", changes, field_map=inputs["map"]))
        share = _decay(x, run.time)
        rate, damping = np.sqrt(spring / mass), loss / (2 * mass)
        wanted = damping if damping < rate else damping - np.sqrt(damping**2 - rate**2)
        assert share == pytest.approx(wanted, rel=0.1)


def _square_of_rate(run):
    """Of a swing that hardly decays, from its zeros."""
    zeros = run.time[np.flatnonzero(np.diff(np.sign(run.sensed[:, 0])))]
    return (np.pi / np.diff(zeros).mean()) ** 2


def _decay(x, time):
    """1/s, of the envelope: from the peaks of a swing, or of the slow end where there are none."""
    size = np.abs(x)
    peaks = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
    if len(peaks) < 3:
        peaks = np.arange(len(x) // 4, len(x) // 2)
    return -np.polyfit(time[peaks], np.log(size[peaks]), 1)[0]
