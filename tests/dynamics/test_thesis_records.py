"""The records of chapters 5 and 6 on a made-up map: identified models against the linear machine and its statics."""

import numpy as np
import pytest

from fieldmap.control import StateSpace, kalmd, zero_order_hold
from fieldmap.dynamics import linear_points, prepare, read_scenario
from fieldmap.thesis import horizontal as horizontal_records
from fieldmap.thesis import vertical_records
from fieldmap.thesis.coupled_loop import filtered_states
from fieldmap.thesis.printed import figure_numbers, read_part
from fieldmap.thesis.vertical_records import changes_of


@pytest.fixture
def records(six, legible):
    def compute(module, part):
        printed = read_part(part)
        found = module.records(printed.inputs | {"map": six})
        legible(found.curves)
        assert {number for curves in found.curves for number in figure_numbers(curves.title)} == set(
            printed.figures
        )
        assert all(np.isfinite(line.y).all() for curves in found.curves for line in curves.series)
        return printed.inputs, {name: np.asarray(one.value) for name, one in found.numbers.items()}

    return compute


def test_identified_poles_are_those_of_the_linear_machine(six, records):
    inputs, numbers = records(vertical_records, "S16_records")
    pairs = numbers["pair_real"] + 1j * numbers["pair_imaginary"]
    compared = 0
    for Kc, pair in zip(inputs["gains"], pairs, strict=True):
        changes = {**changes_of((Kc, inputs["Ti"], inputs["Td"])), "start.depth_mm": 8.0}
        (point,) = linear_points(prepare(read_scenario("vertical_step", changes), six))
        vertical = point.loop.poles[np.abs(point.loop.poles) < 0.999]
        # Real poles are overdamped. A record does not distinguish them from the magnet's undamped sideways motion.
        if np.abs(vertical.imag).max() > 1e-6:
            compared += 1
            assert np.abs(vertical - pair).min() < 2e-3
    assert compared == 2
    # The PID's derivative acts on measurement or error, but its integrator's zero stays: 1 - Ts/Ti and slower poles.
    # At the largest gain the record contains too little of the slow decay.
    np.testing.assert_allclose(numbers["zero"][1:], 1 - 2e-3 / 0.42, atol=2e-3)


def test_integral_times_scale_as_the_gains_at_rest(six, records):
    """In slow loops Kc/Ti times the static gain, 15.6 mm per unit for (6-8), sets the integral time."""
    inputs, numbers = records(horizontal_records, "S17_records")
    changes = {"start.depth_mm": 10.0, "control.y.output": 0.0}
    places = [
        prepare(
            read_scenario("horizontal_open_loop", {**changes, "control.x.output": u}), six
        ).operating_point.sensed[0]
        for u in (0.005, -0.005)
    ]
    machine = 1e3 * (places[0] - places[1]) / 0.01
    model = inputs["x_first_order"][0] / (1.0 + inputs["x_first_order"][2])
    expected = 60.0 * inputs["controls"][:, 1] * model / machine
    np.testing.assert_allclose(numbers["model_Ti"][0], expected[0], rtol=0.25)
    assert numbers["model_Ti"][2] > numbers["model_Ti"][1]


def test_estimated_states_are_the_states():
    """Without disturbances and from rest, the estimator has no error."""
    model = StateSpace(
        np.array([[-44.94, 248.3], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[-15.63, -50.97]]), None
    )
    A, B = zero_order_hold(model.A, model.B, 2e-3)
    u, x = np.sin(np.arange(300.0)), np.zeros((301, 2))
    for n in range(300):
        x[n + 1] = A @ x[n] + B[:, 0] * u[n]
    estimator = kalmd(model.A, model.B, model.C, 4e-4, 4e-4, 2e-3)
    found = filtered_states(estimator, u, x[:-1] @ model.C[0])
    np.testing.assert_allclose(found, x[:-1], atol=1e-12)
