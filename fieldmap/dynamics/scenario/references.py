"""Signals of a scenario, one row per control period: references, outputs in open loop, and disturbances."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.arguments import raise_all
from fieldmap.control import compensated_reference
from fieldmap.control.identification import pseudo_random_binary
from fieldmap.control.identification.log import TIME
from fieldmap.errors import InputError, ScenarioError
from fieldmap.inputs.columns import columns_of_roles, read_columns, si_values
from fieldmap.inputs.declared import Key, choice_of, kinds_of, table_of
from fieldmap.inputs.tables import NotNegative, Positive, Text, Vector, broken
from fieldmap.records import Record
from fieldmap.typing import Array

AXES = ("x", "y", "depth")
OUTPUTS = ("lift_V", "x", "y")
_COLUMNS = {"time": TIME, **{axis: (axis,) for axis in AXES}}
MOST_PERIODS = 5_000_000
"""Most control periods of a run. Such a run takes about 2.5 GB of memory."""

Axis = Annotated[Literal["x", "y", "depth"], Key(..., "axis of the reference")]
Begins = Annotated[NotNegative, Key(..., "when it begins", "s")]
Amplitude = Annotated[float, Key(..., "amplitude", "mm")]


class Reference(Record):
    """A change of the references. Each derived class is one kind."""

    kind: ClassVar[str]

    @abstractmethod
    def changed(self, wanted: Array, time: Array, key: str) -> Array:
        """Apply the change to the references.

        Parameters
        ----------
        wanted
            (p, 3), references x, y and depth, m.
        time
            (p,), s.
        key
            Key of this change in the file, for messages.

        Returns
        -------
        Array
            The changed references (p, 3), m.
        """

    def moves(self, axis: str) -> bool:
        """Whether it changes the reference of this axis."""
        return getattr(self, "axis", axis) == axis


@dataclass(frozen=True, repr=False)
class _AlongAxis(Reference):
    """A change along one axis."""

    axis: Axis

    def changed(self, wanted: Array, time: Array, key: str) -> Array:
        """See `Reference`."""
        added = np.zeros_like(wanted)
        added[:, AXES.index(self.axis)] = self.added(time)
        return wanted + added

    @abstractmethod
    def added(self, time: Array) -> Array:
        """Change (p,) of the reference along the axis, m, at times (p,), s."""


@dataclass(frozen=True, repr=False)
class Step(_AlongAxis):
    """A step, or equal steps one after the other."""

    kind: ClassVar[str] = "step"

    at: Annotated[NotNegative, Key(..., "time of the first step", "s")]
    by: Annotated[float, Key(..., "size of a step", "mm")]
    times: Annotated[Annotated[int, Field(ge=1, le=MOST_PERIODS)], Key(..., "number of steps")] = 1
    every: Annotated[Positive, Key(..., "time from one step to the next", "s")] = 1.0

    def added(self, time: Array) -> Array:
        """See `_AlongAxis`."""
        made = np.floor(_since(time, self.at) / self.every + 1e-9) + 1.0
        return self.by * np.clip(made, 0.0, self.times)


@dataclass(frozen=True, repr=False)
class Ramp(_AlongAxis):
    """A ramp."""

    kind: ClassVar[str] = "ramp"

    at: Begins
    by: Annotated[float, Key(..., "change in all", "mm")]
    rate: Annotated[Positive, Key(..., "speed", "mm_per_s")]

    def added(self, time: Array) -> Array:
        """See `_AlongAxis`."""
        gone = np.clip(_since(time, self.at), 0.0, None) * self.rate
        return np.sign(self.by) * np.minimum(gone, abs(self.by))


@dataclass(frozen=True, repr=False)
class Sine(_AlongAxis):
    """A sine."""

    kind: ClassVar[str] = "sine"

    amplitude: Amplitude
    frequency: Annotated[Positive, Key(..., "frequency", "Hz")]
    at: Begins = 0.0

    def added(self, time: Array) -> Array:
        """See `_AlongAxis`."""
        since = _since(time, self.at)
        return np.where(since >= 0.0, self.amplitude * np.sin(2.0 * np.pi * self.frequency * since), 0.0)


@dataclass(frozen=True, repr=False)
class BinarySequence(_AlongAxis):
    """A pseudo-random binary sequence of 0 and the amplitude."""

    kind: ClassVar[str] = "prbs"

    amplitude: Amplitude
    bit: Annotated[Positive, Key(..., "length of a bit", "ms")]
    at: Begins = 0.0
    order: Annotated[Annotated[int, Field(ge=3, le=16)], Key(..., "order of the shift register")] = 8

    def added(self, time: Array) -> Array:
        """See `_AlongAxis`."""
        since, bits = _since(time, self.at), pseudo_random_binary(self.order)
        index = np.floor(np.clip(since, 0.0, None) / self.bit).astype(int) % len(bits)
        return np.where(since >= 0.0, self.amplitude * (bits[index] > 0), 0.0)


@dataclass(frozen=True, repr=False)
class Circle(Reference):
    """A circle in x and y about the starting reference."""

    kind: ClassVar[str] = "circle"

    radius: Annotated[Positive, Key(..., "radius", "mm")]
    rate: Annotated[float, Key(..., "angular velocity", "rad_per_s")]
    at: Annotated[
        NotNegative, Key(..., "when it begins; the reference is at x = radius from there on", "s")
    ] = 0.0
    out_at: Annotated[
        NotNegative | None, Key(..., "when it leaves for x = radius; in one step at at_s unless given", "s")
    ] = None
    out: Annotated[Positive, Key(..., "speed on the way there", "mm_per_s")] = 1e-3

    def changed(self, wanted: Array, time: Array, key: str) -> Array:
        """See `Reference`. The path goes along x to the radius, then round with the angular velocity `rate`."""
        since = _since(time, self.at)
        angle, on = self.rate * np.clip(since - 1e-9, 0.0, None), since >= 0.0
        circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(time)])
        path = self.radius * on[:, None] * circle
        if self.out_at is not None:
            gone = self.out * np.clip(time - self.out_at, 0.0, None)
            path[:, 0] += np.where(on, 0.0, np.minimum(gone, self.radius))
        return wanted + path


@dataclass(frozen=True, repr=False)
class TableOfReferences(Reference):
    """A reference from a CSV file with columns time, x, y and depth, in s and mm unless their names say other units."""

    kind: ClassVar[str] = "csv"

    file: Annotated[Path, Key(Text, "path, relative to the scenario")]

    def changed(self, wanted: Array, time: Array, key: str) -> Array:
        """See `Reference`. The file replaces the changes before it."""
        try:
            table = read_columns(Path(self.file))
            found, problems = columns_of_roles(
                table, _COLUMNS, tuple(_COLUMNS), {}, {"names": "a heading"}, True
            )
            units = {role: "s" if role == "time" else "m" for role in _COLUMNS}
            values, wrong = si_values(table, found, units, units | dict.fromkeys(AXES, "mm"))
            raise_all(problems + wrong)
        except InputError as error:
            raise ScenarioError(*error.problems) from None
        falls = np.flatnonzero(np.diff(values["time"]) <= 0)
        if falls.size:
            where, received = (
                f"{self.file}:{table.rows[falls[0] + 1][0]}",
                f"{values['time'][falls[0] + 1]:g} s",
            )
            raise ScenarioError.of(where, "time must rise", received, "correct the file")
        return np.column_stack([np.interp(time, values["time"], values[axis]) for axis in AXES])


@dataclass(frozen=True, repr=False)
class Compensator(Record):
    """A push of the vertical reference when the horizontal one moves."""

    push: Annotated[float, Key(..., "how far the reference is pushed", "mm")]
    duration: Annotated[Positive, Key(..., "how long the push lasts", "ms")]
    axis: Annotated[Literal["x", "y"], Key(..., "axis whose reference sets it off")] = "x"


@dataclass(frozen=True, repr=False)
class Signal(Record):
    """A step of an output that no controller sets: an axis in open loop."""

    output: Annotated[Literal["lift_V", "x", "y"], Key(..., "output that is changed")]
    at: Annotated[NotNegative, Key(..., "time of the step", "s")]
    by: Annotated[float, Key(..., "size of the step")]


def _later(until: float, info: ValidationInfo) -> None:
    begin = info.data.get("from_s", -1.0)
    if until <= begin:
        received = f"from_s = {begin:g}, until_s = {until:g}"
        raise broken("until_s must be later than from_s", received, "swap or correct them")


@dataclass(frozen=True, eq=False, repr=False)
class Disturbance(Record):
    """A force on the body."""

    force: Annotated[Array, Key(Vector, "force along x, y, z", "mN")]
    begin: Annotated[NotNegative, Key(..., "when it begins", "s", name="from")]
    end: Annotated[NotNegative, Key(..., "when it ends", "s", name="until", check=_later)]


ReferenceKeys = choice_of([table_of(kind, "kind") for kind in kinds_of(Reference).values()], "kind")


def control_times(duration: float, period: float) -> Array:
    """Times (p,) of the control task, s."""
    return period * np.arange(max(1, round(duration / period)), dtype=np.float64)


def _since(time: Array, at: float) -> Array:
    """Time since `at`, negative before it. A nanosecond is added because of rounding: a sample at `at` counts."""
    return time - at + 1e-9


def references(
    changes: Sequence[Reference], compensator: Compensator | None, start: Array, time: Array, period: float
) -> Array:
    """References of a run.

    Parameters
    ----------
    changes
        Changes, applied one after the other.
    compensator
        Push of the depth when x or y moves.
    start
        (3,), reference x, y and depth at the start, m.
    time
        (p,), s.
    period
        Control period, s.

    Returns
    -------
    Array
        (p, 3): x, y and depth of the sensed point, m.
    """
    wanted: Array = np.tile(np.asarray(start, float), (len(time), 1))
    for number, change in enumerate(changes):
        wanted = change.changed(wanted, time, f"reference.{number}")
    if compensator is not None:
        aside = wanted[:, AXES.index(compensator.axis)]
        push, duration = compensator.push, compensator.duration
        wanted[:, 2] = compensated_reference(wanted[:, 2], aside, period, push, duration)
    return wanted


def open_loop_signals(signals: Sequence[Signal], time: Array) -> Array | None:
    """Steps (p, 3) that are added to the outputs at times (p,); None if there are none."""
    if not signals:
        return None
    added = np.zeros((len(time), 3))
    for one in signals:
        added[:, OUTPUTS.index(one.output)] += np.where(_since(time, one.at) >= 0.0, one.by, 0.0)
    return added


def disturbances(forces: Sequence[Disturbance], time: Array) -> Array | None:
    """Force, N, and torque, N m, (p, 6), at times (p,); None if there are none."""
    if not forces:
        return None
    loads = np.zeros((len(time), 6))
    for one in forces:
        loads[(_since(time, one.begin) >= 0.0) & (_since(time, one.end) < 0.0), :3] += one.force
    return loads
