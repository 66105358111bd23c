"""Controllers of a scenario.

A controller of one axis turns depth in mm into lift in V, or x or y in mm into the signal of that axis. A coupled
controller acts on all axes. Feed-forward can be added to either.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap import control
from fieldmap.control.pid import USUAL_INTEGRATION
from fieldmap.dynamics import coupled
from fieldmap.dynamics.allocation import ParametrisedAllocation
from fieldmap.dynamics.closed_loop import Schedule
from fieldmap.dynamics.coupled import Lengths, LqgWeights
from fieldmap.dynamics.linearisation import linearise
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.dynamics.rigid_body import Three
from fieldmap.errors import Infeasible
from fieldmap.inputs.declared import Key, choice_of, table_of
from fieldmap.inputs.document import AtKey
from fieldmap.inputs.tables import NotNegative, Positive, Vector, broken
from fieldmap.records import Record
from fieldmap.typing import Array

_Matrix = list[list[float]]
_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
_LIMITS = (
    "0 to 10 V, -0.4 to 0.4 for lift and directions; else 0 to what the amplifiers give, or from minus that where "
    "something that no current drives lifts as well, -1 to 1, unless given"
)
_EQUILIBRIUM = "[V, V/mm]: lift that carries the body; that of the equilibrium at the start unless given"
PointsAt = Callable[[Sequence[float]], list[OperatingPoint]]
"""Function from heights of the sensed point, m, to the operating points there."""


def _rises(upper: Any, info: ValidationInfo) -> None:
    lower = info.data.get("lower")
    if upper is not None and lower is not None and not np.all(np.less(lower, upper)):
        raise broken("lower must be below upper", f"{lower} and {upper}", "swap them")


Lower = Annotated[float | None, Key(..., "limit of the output")]
Upper = Annotated[float | None, Key(..., "limit of the output", check=_rises)]
LowerLimits = Annotated[Array | None, Key(Vector | None, f"lowest lift in V, x and y signals; {_LIMITS}")]
UpperLimits = Annotated[
    Array | None, Key(Vector | None, f"highest lift in V, x and y signals; {_LIMITS}", check=_rises)
]


class AxisController(Record):
    """A controller of one axis."""

    kind: ClassVar[str]

    @abstractmethod
    def block(
        self, reading: control.AxisReading, period: float, output: float, at: Array
    ) -> control.ControllerBlock:
        """The controller as a linear block.

        Parameters
        ----------
        reading
            Reading of the axis.
        period
            Control period, s.
        output
            Output of the controller in equilibrium.
        at
            Signals (7,) of a block in equilibrium: reference and position, m, and 1.
        """


@dataclass(frozen=True, repr=False)
class Pid(AxisController):
    """A sampled PID controller; without Ti_s a PD controller."""

    kind: ClassVar[str] = "pid"

    Kc: Annotated[float, Key(..., "gain, output per mm")]
    Ti: Annotated[Positive | None, Key(..., "integral time in seconds; none: no integral", "s")] = None
    Td: Annotated[NotNegative, Key(..., "derivative time in seconds", "s")] = 0.0
    lower: Lower = None
    upper: Upper = None
    integration: Annotated[Literal["rectangular", "trapezoidal"], Key(..., "rule of the integral")] = (
        USUAL_INTEGRATION
    )
    anti_windup: Annotated[
        Literal["none", "clamping", "back_calculation"], Key(..., "behaviour of the integral at a limit")
    ] = "none"
    tracking_time: Annotated[
        Positive | None, Key(..., "time of back_calculation; unless given sqrt(Ti Td), or Ti without Td", "s")
    ] = None
    Tf: Annotated[NotNegative, Key(..., "time constant of the filter of the derivative, Td / N", "s")] = 0.0
    b: Annotated[float, Key(..., "weight of the reference in the proportional part")] = 1.0
    c: Annotated[float, Key(..., "weight of the reference in the derivative; 0: of the measurement")] = 1.0

    def block(
        self, reading: control.AxisReading, period: float, output: float, at: Array
    ) -> control.ControllerBlock:
        """See `AxisController`. The controller of the depth acts on minus the error: more lift reduces the depth."""
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        limits = dict(zip(("lower", "upper"), _limits_of(self), strict=True))
        given |= {"Ti": np.inf if self.Ti is None else self.Ti, **limits}
        pid = control.PID(Ts=period, acts_on_minus_error=reading.axis == "z", **given)
        return control.pid_block(pid, reading, output, at)


@dataclass(frozen=True, repr=False)
class Constant(AxisController):
    """Open loop: a constant output."""

    kind: ClassVar[str] = "constant"

    output: Annotated[float | None, Key(..., "value; that of the equilibrium at the start unless given")] = (
        None
    )

    def block(
        self, reading: control.AxisReading, period: float, output: float, at: Array
    ) -> control.ControllerBlock:
        """See `AxisController`. The output is the given one, or that of the equilibrium."""
        return control.constant_block(output if self.output is None else self.output)


def _fits(Q: list[Any], info: ValidationInfo) -> None:
    A, B, C = (info.data.get(name) for name in "ABC")
    if A is None or B is None or C is None:
        return
    n = len(A)
    square = all(len(row) == n for row in A)
    weights = all(len(row) == n + 1 for row in Q if isinstance(row, list)) and len(Q) == n + 1
    if not (square and len(B) == n == len(C) and weights):
        must = "A must be square, B and C as long as it, Q one longer (the integral)"
        received = f"A with {n} rows, B {len(B)}, C {len(C)}, Q {len(Q)}"
        raise broken(must, received, "correct the matrices")


@dataclass(frozen=True, eq=False, repr=False)
class AxisRegulator(AxisController):
    """Optimal state feedback (LQR) with a Kalman estimator and an integrator, on one axis."""

    kind: ClassVar[str] = "regulator"

    A: Annotated[Array, Key(_Matrix, "continuous model of the axis, mm and V: states by states")]
    B: Annotated[Array, Key(list[float], "input of that model")]
    C: Annotated[Array, Key(list[float], "output of that model, mm")]
    Q: Annotated[
        Array,
        Key(
            list[float] | _Matrix,
            "weights of the states and of the integral of the deviation: their diagonal, or the matrix",
            check=_fits,
        ),
    ]
    R: Annotated[Positive, Key(..., "weight of the input")]
    process_noise: Annotated[Positive, Key(..., "variance of the input's disturbance")]
    measurement_noise: Annotated[Positive, Key(..., "variance of the measurement, mm^2")]
    equilibrium: Annotated[tuple[float, float] | None, Key(_Pair | None, _EQUILIBRIUM)] = None
    equilibrium_at: Annotated[Literal["reference", "measured"], Key(..., "position of that equilibrium")] = (
        "reference"
    )
    estimate: Annotated[
        Literal["predicted", "filtered", "delayed"], Key(..., "estimate that is fed back")
    ] = "filtered"
    divisor: Annotated[Positive, Key(..., "number that divides the feedback")] = 1.0
    lower: Lower = None
    upper: Upper = None

    def block(
        self, reading: control.AxisReading, period: float, output: float, at: Array
    ) -> control.ControllerBlock:
        """See `AxisController`. The controller is designed for its own model and equilibrium."""
        A, B, C = np.array(self.A), np.array(self.B)[:, None], np.array(self.C)[None]
        wide = control.with_output_integral(A, B, C)
        weights = np.diag(self.Q) if self.Q.ndim == 1 else self.Q
        k = control.lqrd(wide[0], wide[1], weights, [[self.R]], period)
        estimator = control.kalmd(A, B, C, self.process_noise, self.measurement_noise, period)
        carried = (output, 0.0) if self.equilibrium is None else self.equilibrium
        regulator = control.Regulator(
            k, estimator, period, carried, self.equilibrium_at, self.estimate, self.divisor, *_limits_of(self)
        )
        return control.regulator_block(regulator, reading)


def _limits_of(controller: Pid | AxisRegulator) -> tuple[float, float]:
    lower, upper = controller.lower, controller.upper
    return -np.inf if lower is None else lower, np.inf if upper is None else upper


@dataclass(frozen=True, eq=False, repr=False)
class CoupledController(LqgWeights):
    """A controller of all axes.

    It is designed for the machine, with weights from deviations that count alike, and with noise. The noise is that of
    the machine's sensors unless `sensor` gives another one.
    """

    kind: ClassVar[str]

    lower: LowerLimits = None
    upper: UpperLimits = None

    def prepared(self, machine: Machine, start: OperatingPoint) -> tuple[LqgWeights, tuple[Array, Array]]:
        """The weights with the noise of the sensors, and the limits of the outputs.

        Raises Infeasible if the outputs at the operating point lie outside the limits.
        """
        limits = limits_of(machine, self.lower, self.upper)
        lower, upper = limits
        if not ((lower <= start.outputs) & (start.outputs <= upper)).all():
            lift, x, y = start.outputs
            within = f"{lower.tolist()} to {upper.tolist()}"
            must = f"lift, x and y at the operating point must lie within the limits, {within}"
            received, remedy = f"{lift:.3g} V, {x:.3g}, {y:.3g}", "widen lower and upper, or begin elsewhere"
            raise Infeasible(AtKey("control.coupled", must, received, remedy))
        return (self if self.sensor is not None else replace(self, sensor=_noise(machine))), limits

    @abstractmethod
    def controller(
        self, machine: Machine, start: OperatingPoint, points_at: PointsAt, period: float, delay: float
    ) -> control.Controller:
        """The controller, in equilibrium at the start.

        Parameters
        ----------
        machine
            The machine.
        start
            Operating point at the start of the run.
        points_at
            Gives operating points at other heights.
        period
            Control period, s.
        delay
            Delay from sample to command, s.

        Raises
        ------
        Infeasible
            For an operating point with outputs outside the limits.
        """


def _depths_rise(depths: list[float] | None, info: ValidationInfo) -> None:
    if depths is not None and depths[0] >= depths[1]:
        raise broken("the first of depths_mm must be less", f"{depths}", "swap them")


@dataclass(frozen=True, eq=False, repr=False)
class Lqg(CoupledController):
    """LQR of all axes with a Kalman filter on position, velocity and unknown force.

    It is designed on the linearised machine and scheduled over the depth.
    """

    kind: ClassVar[str] = "lqg"

    output: Annotated[
        tuple[float, ...], Key(Lengths, "lift in V, x and y that count as much", name="allowed_outputs")
    ] = (1.0, 0.1, 0.1)
    depths: Annotated[
        tuple[float, float] | None,
        Key(
            _Pair | None,
            "range of depths of the designs; the depth at the start alone unless given",
            "mm",
            check=_depths_rise,
        ),
    ] = None
    designs: Annotated[
        Annotated[int, Field(ge=2, le=100)], Key(..., "number of designs, evenly over these depths")
    ] = 11

    def controller(
        self, machine: Machine, start: OperatingPoint, points_at: PointsAt, period: float, delay: float
    ) -> control.Controller:
        """See `CoupledController`."""
        weights, limits = self.prepared(machine, start)
        about = weights, period, delay, limits, coupled.lag_in_model(machine.sensors, period)
        at_start = coupled.lqg_block(linearise(machine, start), *about)
        if self.depths is None:
            return at_start
        # `ScheduledController` wants rising heights, so the deepest comes first.
        depths = np.linspace(self.depths[1], self.depths[0], self.designs)
        points = points_at((-(depths + machine.sensors.zero_depth)).tolist())
        blocks = [coupled.lqg_block(linearise(machine, there), *about) for there in points]
        heights = [there.sensed[2] for there in points]
        first = replace(blocks[0], memory=at_start.memory)
        return coupled.ScheduledController((first, *blocks[1:]), heights[0], heights[1] - heights[0])


@dataclass(frozen=True, eq=False, repr=False)
class FeedbackLinearisation(CoupledController):
    """Feedback linearisation: a regulator of a free mass, with forces by the inverse map at every sample."""

    kind: ClassVar[str] = "feedback_linearisation"

    output: Annotated[tuple[float, ...], Key(Lengths, "forces that count as much", "mN", name="allowed")] = (
        5e-3,
        5e-3,
        20e-3,
    )
    rounds: Annotated[
        Annotated[int, Field(ge=1, le=20)], Key(..., "steps of Newton's method at a sample")
    ] = 2

    def controller(
        self, machine: Machine, start: OperatingPoint, points_at: PointsAt, period: float, delay: float
    ) -> control.Controller:
        """See `CoupledController`."""
        weights, limits = self.prepared(machine, start)
        return coupled.force_controller(machine, start, weights, period, *limits, delay, self.rounds)


@dataclass(frozen=True, repr=False)
class Own(Record):
    """A controller function that the caller gives.

    `fieldmap.simulate(..., controller=function)`, or `fieldmap simulate --controller FILE.py:NAME`.
    """

    kind: ClassVar[str] = "own"

    def controller(self, *machine: Any) -> None:
        """See `CoupledController`. There is none: the caller gives it."""


@dataclass(frozen=True, eq=False, repr=False)
class Feedforward(Record):
    """Outputs along the reference by the inverse map, added to those of the controller."""

    field_error: Annotated[
        Annotated[float, Field(gt=-0.9, lt=9.0)],
        Key(..., "share by which the inverse map's field is larger than the machine's, as in a wrong model"),
    ] = 0.0
    fastest: Annotated[
        Positive, Key(..., "largest speed of the reference; a faster change is a step", "mm_per_s")
    ] = 50e-3
    largest: Annotated[Positive, Key(..., "largest acceleration that is fed forward", "m_per_s2")] = 3.0
    lower: LowerLimits = None
    upper: UpperLimits = None

    def added(
        self, machine: Machine, controller: control.Controller, start: OperatingPoint, schedule: Schedule
    ) -> Schedule:
        """Add the outputs along the references to the feed-forward of a schedule."""
        field = machine.magnetic
        believed = replace(machine, magnetic=replace(field, scale=field.scale * (1.0 + self.field_error)))
        limits = limits_of(machine, self.lower, self.upper)
        path = coupled.trajectory(believed, start, schedule, *limits, self.fastest, self.largest)
        added, given = coupled.feedforward(controller, schedule, path), schedule.feedforward
        return replace(schedule, feedforward=added if given is None else given + added)


AxisKeys = choice_of([table_of(kind, "kind") for kind in (Pid, Constant, AxisRegulator)], "kind")
CoupledKeys = choice_of([table_of(kind, "kind") for kind in (Lqg, FeedbackLinearisation, Own)], "kind")


def limits_of(machine: Machine, lower: Array | None, upper: Array | None) -> tuple[Array, Array]:
    """Lowest and highest lift, V, and x and y signals, (3,) each, as given; by default of the amplifiers, and 1."""
    divided, drive = isinstance(machine.allocation, ParametrisedAllocation), machine.drive
    lift = drive.amplifier.largest_current / drive.amplifier.gain
    if drive.gives_voltage:
        lift = float(drive.drives[:, 2].max())
    # If something that no current drives lifts too, the coils may have to pull down.
    least = -lift if machine.magnetic.constant and not divided else 0.0
    low = np.array([least, -1.0, -1.0]) if lower is None else lower
    return low, np.array([lift, 1.0, 1.0]) if upper is None else upper


def _noise(machine: Machine) -> Three:
    """Standard deviations of the sensors along x, y and z, m; at least 1 um. Noise of sensors at an angle to the axes
    is turned into the frame of the map."""
    a, b, depth = machine.sensors.deviations
    if machine.sensors.frame is not None:
        c, s = np.cos(machine.sensors.frame.angle), np.sin(machine.sensors.frame.angle)
        a, b = float(np.hypot(c * a, s * b)), float(np.hypot(s * a, c * b))
    return max(a, 1e-6), max(b, 1e-6), max(depth, 1e-6)
