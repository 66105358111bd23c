"""The base class of closed-loop runs, and the loop of a sampled linear plant, for one run or thousands.

The loop of a magnet on a map is `fieldmap.dynamics.simulate_closed_loop`. Both take the same controllers and
instruments, and both return a `LoopRun`. Their compiled loops differ: this one advances a state by one matrix product
per sample, for many runs at once; the other one integrates a rigid body in an interpolated field between the samples
and ends at events. Every controller runs as a block, PID controllers and regulators too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.control.blocks import ALONE, Controller
from fieldmap.control.linear_models import StateSpace, check_model, controller_form
from fieldmap.control.pid import PID, pid_block
from fieldmap.control.regulator import Regulator, regulator_block
from fieldmap.core.controller import CoreController
from fieldmap.core.sampled_loop import LoopInstruments, Plant, Signals, simulate
from fieldmap.errors import InputError
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class LoopRun(Record, ABC):
    """A closed-loop run of any plant: time (samples,), s, of the records; references: set points at these times."""

    time: Array
    references: Array

    @property
    @abstractmethod
    def response(self) -> Array:
        """The controlled quantities, to compare with `references`."""

    @property
    @abstractmethod
    def outputs(self) -> Array:
        """Outputs of the controller."""

    @property
    def error(self) -> Array:
        """Response minus references."""
        return self.response - self.references


@dataclass(frozen=True, eq=False, repr=False)
class LinearLoopRun(LoopRun):
    """Closed-loop runs of a linear plant, as deviations from the operating point.

    time (samples,), s; references (samples,); y (runs, samples): the true output of the plant; u (runs, samples): the
    controller's output.
    """

    y: Array
    u: Array

    @property
    def response(self) -> Array:
        """y (runs, samples)."""
        return self.y

    @property
    def outputs(self) -> Array:
        """u (runs, samples)."""
        return self.u


def simulate_loop(
    plant: tuple,
    controller: PID | Regulator | Controller,
    reference: ArrayLike,
    *,
    Ts: float | None = None,
    runs: int = 1,
    position_noise: ArrayLike = 0.0,
    voltage_noise: ArrayLike = 0.0,
    current_noise: ArrayLike = 0.0,
    disturbance: ArrayLike = 0.0,
    instruments: LoopInstruments | None = None,
) -> LinearLoopRun:
    """Closed-loop runs of a sampled plant from rest, one controller step per sample.

    Limits of the controller and the drive saturate the signals.

    Parameters
    ----------
    plant
        (numerator, denominator) in q or (A, B, C, D), sampled at the controller's Ts; one input, one output,
        strictly proper.
    controller
        A PID, a regulator, or a block of one output, which reads this plant on all axes.
    reference
        (samples,), in the unit of the plant's output.
    Ts
        Sampling time, s; only for a block, which does not store it.
    runs
        Number of runs.
    position_noise, voltage_noise, current_noise, disturbance
        Numbers, (samples,) or (runs, samples), for example of a seeded generator. Position noise is in the
        unit of the plant's output, voltage noise acts at the converter, current noise is in the unit of the
        drive; the disturbance adds to the plant's input.
    instruments
        Converters and drive; ideal unless given.

    Returns
    -------
    LinearLoopRun
        The runs: time (samples,), y and u (runs, samples).

    Raises
    ------
    InputError
        For signals that are not finite or do not fit, and for a plant that is not strictly proper.

    Examples
    --------
    >>> plant = ([-0.03, 0.0298], [1, -1.915, 0.91405])
    >>> run = simulate_loop(plant, PID(0.334, 0.007, 0.001, 2e-3, acts_on_minus_error=True), np.ones(1500))
    >>> print(round(run.y[0, -1], 3))
    1.0
    """
    model, (period, block) = strictly_proper(plant, "simulate_loop"), _block(controller, Ts)
    where, must = "simulate_loop(reference)", "must be a signal (samples,), one sample or more"
    target = np.atleast_1d(arguments.check_signal(where, reference))
    fits = target.ndim == 1 and target.size > 0
    arguments.check(fits, where, must, f"shape {target.shape}", "give one value per sample")
    arguments.check_count("simulate_loop", runs=runs)
    shape = (runs, target.size)
    given = {
        "position_noise": position_noise,
        "voltage_noise": voltage_noise,
        "current_noise": current_noise,
        "disturbance": disturbance,
    }
    signals = {name: _fitting(name, values, shape) for name, values in given.items()}
    y, u = np.empty(shape), np.empty(shape)
    core, memory = CoreController(block.arrays), np.array(block.memory, float)
    simulate(model, core, instruments or LoopInstruments(), Signals(target[None], **signals), memory, y, u)
    return LinearLoopRun(period * np.arange(target.size, dtype=np.float64), target, y, u)


def _block(controller: PID | Regulator | Controller, given: float | None) -> tuple[float, Controller]:
    """Sampling time, and the controller as a block of one output. Raises InputError."""
    where = "simulate_loop(Ts)"
    if isinstance(controller, PID | Regulator):
        must = f"must be the controller's, {controller.Ts:g} s"
        arguments.check(given in (None, controller.Ts), where, must, f"{given!r}", "leave it out")
        if isinstance(controller, PID):
            return controller.Ts, pid_block(controller, ALONE)
        return controller.Ts, regulator_block(controller, ALONE)
    count, remedy = controller.outputs, "give the block of one axis"
    arguments.check(count == 1, "simulate_loop(controller)", "must have one output", count, remedy)
    if given is None:
        must, remedy = "must be given: a block does not know it", "give the plant's sampling time, s"
        raise InputError.of(where, must, "None", remedy)
    arguments.check_positive("simulate_loop", Ts=given)
    return given, controller


def strictly_proper(plant: tuple, caller: str) -> Plant:
    """A plant of one input and one output without direct gain. Raises InputError for any other."""
    where, must = f"{caller}(plant)", "must be (numerator, denominator) or (A, B, C, D)"
    remedy = "see fieldmap.control.transfer_function and StateSpace"
    arguments.check(len(plant) in (2, 4), where, must, f"{len(plant)} parts", remedy)
    model = StateSpace(*plant) if len(plant) == 4 else controller_form(*plant)
    A, B, C, D = check_model(caller, model, inputs=1, outputs=1)
    remedy = "a sampled plant answers one sample later; take the numerator's degree below the denominator's"
    arguments.check(D[0, 0] == 0.0, where, "must be strictly proper", f"direct gain {D[0, 0]:.4g}", remedy)
    return Plant(*(np.array(part, order="C") for part in (A, B[:, 0], C[0])))


def _fitting(name: str, values: ArrayLike, shape: tuple[int, int]) -> Array:
    """A signal (runs or 1, samples or 1)."""
    where, signal = f"simulate_loop({name})", arguments.check_signal(f"simulate_loop({name})", values)
    sizes = zip(signal.shape[::-1], shape[::-1], strict=False)
    fits = signal.ndim <= 2 and all(given in (1, wanted) for given, wanted in sizes)
    must = f"must be a number, ({shape[1]},) or {shape}"
    remedy = "give one value per sample of the reference, and one row per run"
    arguments.check(fits, where, must, f"shape {signal.shape}", remedy)
    return np.atleast_2d(np.require(signal, requirements=["C", "A"]))


def compensated_reference(
    height: ArrayLike, horizontal: ArrayLike, Ts: float, push: float, duration: float
) -> Array:
    """The vertical reference, minus a push for some time after each change of a horizontal reference.

    The push has the sign of the change: the vertical reference is smaller after a rise of the horizontal one, and
    larger after a fall. A change during a push begins a new one.

    Parameters
    ----------
    height
        Vertical reference in the downward frame of the sensor, (n,) or one number, m.
    horizontal
        Reference of the moving axis (n,).
    Ts
        Sampling time, s.
    push
        Size of the push, m.
    duration
        Duration of the push, s.

    Returns
    -------
    Array
        The vertical reference (n,), m.

    Examples
    --------
    >>> reference = compensated_reference(0.010, [0, 0, 1e-4, 1e-4, 1e-4, 1e-4], 5e-3, push=5e-5, duration=0.010)
    >>> (1e3 * reference).round(3).tolist()
    [10.0, 10.0, 9.95, 9.95, 10.0, 10.0]
    """
    arguments.check_positive("compensated_reference", Ts=Ts)
    arguments.check_numbers("compensated_reference", push=push)
    arguments.check_not_negative("compensated_reference", duration=duration)
    sideways = np.atleast_1d(arguments.check_signal("compensated_reference(horizontal)", horizontal))
    target = np.broadcast_to(arguments.check_signal("compensated_reference(height)", height), sideways.shape)
    steps = np.sign(np.diff(sideways, prepend=sideways[0]))
    index = np.arange(steps.size)
    last = np.maximum.accumulate(np.where(steps != 0.0, index, -1))
    length = round(duration / Ts)
    active = (last >= 0) & (index - last < length)
    return target - push * np.where(active, steps[last], 0.0)
