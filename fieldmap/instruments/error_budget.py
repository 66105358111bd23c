"""Worst-case readings of a position through sensor and converter."""

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import check_choice, check_not_negative, check_numbers, check_positive
from fieldmap.instruments.converter import Converter, absolute_accuracy
from fieldmap.instruments.micrometer import Micrometer
from fieldmap.records import Record
from fieldmap.typing import Array

ROUNDING = ("up", "nearest")
# A number that lies on a step but for rounding in the last bits counts as lying on it.
_SLACK = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class ErrorBudget(Record):
    """The steps of the budget. In SI units; the first axis has what may be actual (high, low), the last four entries
    are high + accuracy, high - accuracy, low - accuracy, low + accuracy.

    actual (2,), shown (2,) by the sensor, m; voltages (2,); codes (2,) before and steps (2,) after rounding by the
    converter; inputs (2,): voltages it takes for them; accuracies (2,), V; measured_voltages (4,); measured (4,), m;
    errors (4,) = nominal - measured, m.
    """

    actual: Array
    shown: Array
    voltages: Array
    codes: Array
    steps: Array
    inputs: Array
    accuracies: Array
    measured_voltages: Array
    measured: Array
    errors: Array


def error_budget(
    position: float,
    sensor_accuracy: float,
    micrometer: Micrometer,
    converter: Converter,
    *,
    converter_step: float | None = None,
    rounding: str = "up",
) -> ErrorBudget:
    """Worst-case readings of a nominal position (m) by a sensor that is right to +- sensor_accuracy (m).

    The sensor rounds to its resolution, the converter to its step (its resolution unless given, V) and errs by its
    absolute accuracy either way. rounding: of the converter, "up" (16393.44 becomes 16394) or "nearest". Raises
    InputError for numbers that are not finite.

    >>> sensor = Micrometer(zero=0.020, scale=2e-3, voltage_step=5e-3)
    >>> card = Converter(range=10, bits=16)
    >>> (1e3 * error_budget(0.030001, 4e-6, sensor, card).shown).round(2).tolist()
    [30.01, 30.0]
    """
    check_numbers("error_budget", position=position)
    check_not_negative("error_budget", sensor_accuracy=sensor_accuracy)
    check_choice("error_budget(rounding)", rounding, ROUNDING)
    step = converter.resolution if converter_step is None else converter_step
    check_positive("error_budget", converter_step=step)
    actual = position + sensor_accuracy * np.array([1.0, -1.0])
    shown = actual
    if micrometer.resolution:
        shown = micrometer.resolution * np.floor(actual / micrometer.resolution + 0.5 + _SLACK)
    voltages = micrometer.voltage(shown)
    codes = voltages / step
    steps = np.ceil(codes - _SLACK) if rounding == "up" else np.floor(codes + 0.5 + _SLACK)
    inputs = steps * step
    accuracies = absolute_accuracy(converter, inputs).total
    signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
    measured_voltages = (inputs[:, None] + signs * accuracies[:, None]).ravel()
    measured = micrometer.position(measured_voltages)
    return ErrorBudget(
        actual,
        shown,
        voltages,
        codes,
        steps,
        inputs,
        accuracies,
        measured_voltages,
        measured,
        position - measured,
    )
