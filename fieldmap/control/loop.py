"""Closed loops: what every run of one has, and the loop of a sampled linear plant, one run or thousands.

The loop of a magnet on a map is `fieldmap.dynamics.simulate_closed_loop`. Both take the same controllers and
instruments, and both return a `LoopRun`. Their compiled loops stay apart: this one advances a state by one matrix
product a sample, for many runs at once; the other one integrates a rigid body in an interpolated field between the
samples and ends at events. Every controller is a block there, PID controllers and regulators too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_positive, check_signal
from fieldmap.control.blocks import Controller, pid_block, regulator_block
from fieldmap.control.linear_models import StateSpace, check_model, controller_form
from fieldmap.control.pid import PID
from fieldmap.control.regulator import Regulator
from fieldmap.control.running import ALONE
from fieldmap.core.controller import CoreController
from fieldmap.core.sampled_loop import LoopInstruments, Plant, Signals, simulate
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class LoopRun(Record, ABC):
    """A closed-loop run of any plant: time (samples,), s, of the records; references: what was asked for."""

    time: Array
    references: Array

    @property
    @abstractmethod
    def response(self) -> Array:
        """What the references are for, as it was."""

    @property
    @abstractmethod
    def outputs(self) -> Array:
        """Of the controller."""

    @property
    def error(self) -> Array:
        """Response less references."""
        return self.response - self.references


@dataclass(frozen=True, eq=False, repr=False)
class LinearLoopRun(LoopRun):
    """Closed-loop runs of a linear plant, deviations from the operating point.

    time (samples,), s; references (samples,); y (runs, samples): the true output of the plant; u (runs, samples): the
    controller's output.
    """

    y: Array
    u: Array

    @property
    def reference(self) -> Array:
        """The one reference (samples,)."""
        return self.references

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

    plant: (numerator, denominator) in q or (A, B, C, D), sampled at controller.Ts, one input, one output, strictly
    proper. controller: a PID, a regulator, or a block of one output, whose signals of all axes are this one; a block
    does not know its sampling time, so give Ts, s. reference (samples,). Noise and disturbance (of the plant's input):
    numbers, (samples,) or (runs, samples), for example of a seeded generator; position noise is in the plant's output
    unit, voltage noise at the converter, current noise in the drive's unit. A limit of the controller or the drive
    saturates as it would.

    Raises InputError for signals that are not finite or do not fit, and for a plant that is not strictly proper.

    >>> plant = ([-0.03, 0.0298], [1, -1.915, 0.91405])
    >>> run = simulate_loop(plant, PID(0.334, 0.007, 0.001, 2e-3, acts_on_minus_error=True), np.ones(1500))
    >>> print(round(run.y[0, -1], 3))
    1.0
    """
    model = _strictly_proper(plant)
    target = np.atleast_1d(check_signal("simulate_loop(reference)", reference)).astype(float)
    if target.ndim != 1 or not target.size:
        must = "must be a signal (samples,), one sample or more"
        raise InputError(
            Problem("simulate_loop(reference)", must, f"shape {target.shape}", "give one value per sample")
        )
    check_count("simulate_loop", runs=runs)
    shape = (runs, target.size)
    noises = (position_noise, voltage_noise, current_noise, disturbance)
    names = ("position_noise", "voltage_noise", "current_noise", "disturbance")
    signals = [_fitting(name, noise, shape) for name, noise in zip(names, noises, strict=True)]
    numbers = instruments or LoopInstruments()
    y, u = np.empty(shape), np.empty(shape)
    period, block = _sampling_time(controller, Ts), _as_block(controller)
    memory = np.array(block.memory, float)
    simulate(model, CoreController(block.arrays), numbers, Signals(target[None], *signals), memory, y, u)
    return LinearLoopRun(period * np.arange(target.size, dtype=np.float64), target, y, u)


def _as_block(controller: PID | Regulator | Controller) -> Controller:
    if isinstance(controller, PID):
        return pid_block(controller, ALONE)
    return regulator_block(controller, ALONE) if isinstance(controller, Regulator) else controller


def _sampling_time(controller: PID | Regulator | Controller, given: float | None) -> float:
    """The controller's own, or the given one for a block of one output. Raises InputError."""
    if isinstance(controller, PID | Regulator):
        if given not in (None, controller.Ts):
            must = f"must be the controller's, {controller.Ts:g} s"
            raise InputError(Problem("simulate_loop(Ts)", must, f"{given!r}", "leave it out"))
        return controller.Ts
    if controller.outputs != 1:
        must, received = "must have one output", f"{controller.outputs}"
        raise InputError(Problem("simulate_loop(controller)", must, received, "give the block of one axis"))
    if given is None:
        must, remedy = "must be given: a block does not know it", "give the plant's sampling time, s"
        raise InputError(Problem("simulate_loop(Ts)", must, "None", remedy))
    check_positive("simulate_loop", Ts=given)
    return given


def _strictly_proper(plant: tuple) -> Plant:
    """Of one input and one output, whose output does not wait for its input."""
    if len(plant) not in (2, 4):
        raise InputError(
            Problem(
                "simulate_loop(plant)",
                "must be (numerator, denominator) or (A, B, C, D)",
                f"{len(plant)} parts",
                "see fieldmap.control.transfer_function and StateSpace",
            )
        )
    model = StateSpace(*plant) if len(plant) == 4 else controller_form(*plant)
    A, B, C, D = check_model("simulate_loop", model, inputs=1, outputs=1)
    if D[0, 0] != 0.0:
        raise InputError(
            Problem(
                "simulate_loop(plant)",
                "must be strictly proper",
                f"direct gain {D[0, 0]:.4g}",
                "a sampled plant answers one sample later; take the numerator's degree below the denominator's",
            )
        )
    return Plant(*(np.array(part, order="C") for part in (A, B[:, 0], C[0])))


def _fitting(name: str, values: ArrayLike, shape: tuple[int, int]) -> Array:
    """A signal (runs or 1, samples or 1)."""
    signal = check_signal(f"simulate_loop({name})", values)
    fits = signal.ndim <= 2 and all(
        given in (1, wanted) for given, wanted in zip(signal.shape[::-1], shape[::-1], strict=False)
    )
    if not fits:
        raise InputError(
            Problem(
                f"simulate_loop({name})",
                f"must be a number, ({shape[1]},) or {shape}",
                f"shape {signal.shape}",
                "give one value per sample of the reference, and one row per run",
            )
        )
    return np.atleast_2d(np.require(signal, requirements=["C", "A"]))
