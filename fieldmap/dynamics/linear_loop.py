"""A linear machine with its sampled controller: docs/theory/closed_loop.md (10)..(13)."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from fieldmap.arguments import check, check_positive
from fieldmap.control import StateSpace, zero_order_hold
from fieldmap.control.blocks import ControllerBlock
from fieldmap.control.margins import Margins, margins_of_curves
from fieldmap.dynamics.closed_loop import Schedule
from fieldmap.dynamics.linearisation import LinearMachine
from fieldmap.dynamics.machine import Sensors
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record, tuple_line
from fieldmap.typing import Array

if TYPE_CHECKING:
    import control as python_control

Complex = NDArray[Any]
_FELT = 0.01
"""Sum over all outputs of the unstable modes in their sensitivities. Below it no output counts as unstable."""


class SampledMachine(NamedTuple):
    """x[n+1] = A x[n] + B u[n] + before u[n-1]; y = C x: outputs reach the coils with a delay of at most a period."""

    A: Array
    B: Array
    before: Array
    C: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """Return the arrays by name, as plain Python."""
        return plain_items(**self._asdict())

    def to_control(self, period: float) -> "python_control.StateSpace":
        """A sampled state space of python-control; its last states are the outputs u[n-1].

        period: s. Raises FieldmapError if python-control is not installed.
        """
        order, inputs = self.B.shape
        A = np.block([[self.A, self.before], [np.zeros((inputs, order + inputs))]])
        C = np.hstack([self.C, np.zeros((len(self.C), inputs))])
        B = np.vstack([self.B, np.eye(inputs)])
        return StateSpace(A, B, C, np.zeros((len(C), inputs))).to_control(period)


def sampled_machine(linear: LinearMachine, period: float, delay: float = 0.0) -> SampledMachine:
    """The exact discretisation of a linear machine whose inputs change at a delay after each sample.

    Parameters
    ----------
    linear
        The machine.
    period
        Sampling period, s.
    delay
        From a sample to the change of the inputs, s.

    Returns
    -------
    SampledMachine
        The sampled machine.

    Raises
    ------
    InputError
        For a delay that is negative or longer than the period.
    """
    check_positive("sampled_machine", period=period)
    within, must = 0.0 <= delay <= period, "must be from 0 to the period"
    check(within, "sampled_machine(delay)", must, f"{delay:g} s", "shorten it")
    A, B = zero_order_hold(linear.A, linear.B, period)
    if delay == 0.0:
        return SampledMachine(A, B, np.zeros_like(B), linear.C)
    late = zero_order_hold(linear.A, linear.B, delay)[1]
    if delay == period:
        return SampledMachine(A, np.zeros_like(late), late, linear.C)
    onward, now = zero_order_hold(linear.A, linear.B, period - delay)
    return SampledMachine(A, now, onward @ late, linear.C)


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop(Record):
    """A machine and its controller as one sampled system, z[n+1] = A z[n] + B r[n]; period: s.

    z: states of the machine, outputs of the last period, memory of the controller, and, if the sensors average, the
    positions at the last samples. C z: the sensed point, r: its reference, as deviations. machine, controller: parts.
    """

    A: Array
    B: Array
    C: Array
    period: float
    machine: SampledMachine
    controller: ControllerBlock

    @property
    def poles(self) -> Complex:
        """Poles in the z-plane; stable inside the unit circle."""
        return scipy.linalg.eigvals(self.A)

    @property
    def stable(self) -> bool:
        """Whether all poles lie inside the unit circle."""
        return bool(np.abs(self.poles).max() < 1.0)

    def to_control(self) -> "python_control.StateSpace":
        """A sampled state space of python-control, from references to sensed positions "x", "y", "z" (deviations).

        Raises FieldmapError if python-control is not installed.
        """
        model = StateSpace(self.A, self.B, self.C, np.zeros((len(self.C), self.B.shape[1])))
        axes = ("x", "y", "z")
        return model.to_control(self.period, None, [f"reference_{axis}" for axis in axes], axes)


def close_loop(
    linear: LinearMachine, controller: ControllerBlock, schedule: Schedule, sensors: Sensors | None = None
) -> ClosedLoop:
    """Close the loop of a linear machine and a controller.

    Parameters
    ----------
    linear
        The machine.
    controller
        The block of the controller.
    schedule
        Schedule with the period and the delay.
    sensors
        Sensors with their scans, averages and latency; by default the sensors are ideal.

    Returns
    -------
    ClosedLoop
        The loop as one sampled system.
    """
    machine = sampled_machine(linear, schedule.period, schedule.delay)
    k = _without_constants(controller)
    shown = np.eye(3)[None] if sensors is None else shares_of_the_past(sensors, schedule.period)
    now, past = shown[0] @ machine.C, np.hstack([*shown[1:], np.zeros((3, 0))])
    listen, wanted = k.D[:, 3:6], k.D[:, :3]
    m, size, n, late = k.outputs, len(k.A), len(machine.A), past.shape[1]
    applied = k.B + k.E @ k.D
    older = np.eye(late, late, -3)
    latest = np.vstack([machine.C, np.zeros((max(late - 3, 0), n))])[:late]
    # Outputs of the controller at this sample, from states, last outputs, memory, and the past.
    said = np.hstack([listen @ now, np.zeros((m, m)), k.C, listen @ past])
    moved = np.hstack([machine.A, machine.before, np.zeros((n, size + late))]) + machine.B @ said
    kept = np.hstack([np.zeros((size, n + m)), k.A + k.E @ k.C, np.zeros((size, late))])
    kept += applied[:, 3:6] @ np.hstack([now, np.zeros((3, m + size)), past])
    A = np.vstack([moved, said, kept, np.hstack([latest, np.zeros((late, m + size)), older])])
    B = np.vstack([machine.B @ wanted, wanted, applied[:, :3], np.zeros((late, 3))])
    C = np.hstack([machine.C, np.zeros((3, m + size + late))])
    return ClosedLoop(A, B, C, schedule.period, machine, k)


def _without_constants(block: ControllerBlock) -> ControllerBlock:
    """A block without constant numbers in its memory, such as the integral of a PD controller, a pole at 1."""
    changes = (np.eye(len(block.A)) != block.A).any(axis=1) | block.B.any(axis=1) | block.E.any(axis=1)
    return replace(
        block,
        A=block.A[np.ix_(changes, changes)],
        B=block.B[changes],
        C=block.C[:, changes],
        E=block.E[changes],
        F=None if block.F is None else block.F[changes],
        hold=block.hold[changes],
        memory=block.memory[changes],
    )


def shares_of_the_past(sensors: Sensors, period: float) -> Array:
    """Shares (k, 3, 3) of past positions in a reading: the reading is the sum over k of the shares times the position
    k samples ago. A lag of the scans and of the hold between averages is split between the samples on both sides."""
    if not sensors.scan_rate:
        return np.eye(3)[None]
    scan = 1.0 / sensors.scan_rate
    into, back = sensors.numbers.into, sensors.numbers.back
    count = int(np.ceil((2 * max(sensors.means) + sensors.latency) * scan / period)) + 2
    shares = np.zeros((count, 3))
    for axis, n in enumerate(sensors.means):
        held = (np.arange(8 * n) + 0.5) / 8.0
        lags = (np.arange(n)[:, None] + held + sensors.latency).ravel() * scan / period
        below = lags.astype(int)
        np.add.at(shares[:, axis], below, (1.0 - lags + below) / lags.size)
        np.add.at(shares[:, axis], below + 1, (lags - below) / lags.size)
    return np.stack([back @ np.diag(share) @ into for share in shares])


def margins(
    loop: ClosedLoop, names: tuple[str, ...], sensors: Sensors | None = None, points: int = 4000
) -> list[Margins]:
    """Margins at each output of a controller, also of an unstable loop (`Margins.unstable`).

    The clocks of scans and controller are independent, so the response of the sensors is a mean over their phase.

    Parameters
    ----------
    loop
        The closed loop.
    names
        Names of the outputs.
    sensors
        Sensors whose scans, averages and latency add phase lag; by default the sensors are ideal.
    points
        Number of frequencies, from 1 mHz to half the sampling rate.

    Returns
    -------
    list[Margins]
        Margins of these outputs, in the same order.
    """
    frequencies = np.geomspace(1e-3, 0.5 / loop.period, points)
    rates = 2.0 * np.pi * frequencies
    curves = _opened(loop, rates, sensors)
    found = margins_of_curves(frequencies, curves.T).T.tolist()
    sizes = np.abs(_unstable_sensitivity(loop, rates)).max(axis=0)
    shares = sizes / sizes.sum() if sizes.sum() > _FELT else np.zeros_like(sizes)
    return [
        Margins(name, up, down, phase, crossover, modulus, float(share))
        for name, (up, down, phase, crossover, modulus), share in zip(names, found, shares, strict=True)
    ]


def sensor_answer(sensors: Sensors, rate: float) -> Complex:
    """Frequency response (3, 3) of scanning sensors from position to reading at an angular frequency, 1/s; (12) for
    each sensor along its own axis."""
    if not sensors.scan_rate:
        return np.eye(3)
    into, back = sensors.numbers.into, sensors.numbers.back
    return np.asarray(back @ np.diag([_mean_of_scans(sensors, n, rate) for n in sensors.means]) @ into)


def _mean_of_scans(sensors: Sensors, n: int, rate: float) -> complex:
    scan = 1.0 / sensors.scan_rate
    mean = np.exp(-1j * rate * scan * np.arange(n)).mean()
    # Each average is held for n scans, and sampled at any time of the hold.
    half = 0.5 * rate * n * scan
    return complex(mean * np.exp(-1j * (rate * sensors.latency * scan + half)) * np.sinc(half / np.pi))


def _opened(loop: ClosedLoop, rates: Array, sensors: Sensors | None) -> Complex:
    """(n, m): the loop opened at one output, with the other loops closed; 1 + l is 0 at the border of stability."""
    q = np.exp(1j * rates * loop.period)[:, None, None]
    machine, k = loop.machine, loop.controller
    plant = machine.C @ np.linalg.solve(
        q * np.eye(len(machine.A)) - machine.A, machine.B + machine.before / q
    )
    inner = k.A + k.E @ k.C
    control = k.D[:, 3:6] + k.C @ np.linalg.solve(q * np.eye(len(inner)) - inner, (k.B + k.E @ k.D)[:, 3:6])
    shown = np.eye(3) if sensors is None else np.array([sensor_answer(sensors, rate) for rate in rates])
    sensitivity = np.linalg.inv(np.eye(k.outputs) - control @ shown @ plant)
    return 1.0 / np.diagonal(sensitivity, axis1=1, axis2=2) - 1.0


def _unstable_sensitivity(loop: ClosedLoop, rates: Array) -> Complex:
    """(n, m): the part of the unstable modes in the sensitivity S_jj(q) = 1 + c_j (q - A)^-1 b_j, the response of the
    machine's input at one output of the controller to a change there."""
    order, outputs = loop.machine.B.shape
    T, Z, count = scipy.linalg.schur(loop.A, output="complex", sort=lambda pole: abs(pole) >= 1.0)
    if not count:
        return np.zeros((len(rates), outputs), dtype=complex)
    first, rest = slice(count), slice(count, None)
    # Rows of the inverse of a basis that separates the unstable modes.
    apart = scipy.linalg.solve_sylvester(T[first, first], -T[rest, rest], -T[first, rest])
    rows = Z[:, first].conj().T - apart @ Z[:, rest].conj().T
    said = loop.A[order : order + outputs] @ Z[:, first]
    reached = rows[:, :order] @ loop.machine.B + rows[:, order : order + outputs]
    q = np.exp(1j * rates * loop.period)[:, None, None]
    modes = np.linalg.inv(q * np.eye(count) - T[first, first])
    return np.einsum("jk,nkl,lj->nj", said, modes, reached)
