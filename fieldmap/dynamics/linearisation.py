"""The motion of a machine, linearised about an operating point, docs/theory/closed_loop.md (7)..(9): poles, modes,
controllability, observability, coupling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_signal
from fieldmap.control import StateSpace
from fieldmap.core.machine import ANGULAR_VELOCITY, INSIDE, STATE, TURN, VELOCITY, CoreMachine, rotation
from fieldmap.dynamics.field_of_currents import EXACT
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.errors import OutsideMapError
from fieldmap.lookup.current_model import with_secants
from fieldmap.lookup.flux_linkage import payload_linkage
from fieldmap.records import Record
from fieldmap.typing import Array

if TYPE_CHECKING:
    import control as python_control

# Steps of the differences: m, rad, m/s, rad/s; A. They are large against the steps of a map between cells (1e-7 of
# the field), and small enough for the truncation error, which is of fourth order.
_STEPS, _CURRENT_STEP = (2e-4, 2e-3, 1e-4, 1e-3), 5e-3
# Central differences of fourth order: positions in units of the step, and weights.
_STENCIL = ((-2.0, 1.0 / 12.0), (-1.0, -8.0 / 12.0), (1.0, 8.0 / 12.0), (2.0, -1.0 / 12.0))
# Units in which typical deviations are of order one: 1 mm, 0.1 rad, 10 mm/s, 1 rad/s, 1 V of an integral, 0.1 A.
_UNITS = {"turn": 0.1, "angular_velocity": 1.0, "velocity": 1e-2, "integral": 1.0, "i": 0.1}
_MILLI = 1e-3
# Position or angle of each velocity.
_AXIS_OF = {f"velocity_{k}": k for k in "xyz"} | {f"angular_velocity_{k}": f"turn_{k}" for k in "xyz"}
VELOCITIES = ("velocity_x", "velocity_y", "velocity_z")
MOTION = (
    *("x", "y", "z", "turn_x", "turn_y", "turn_z"),
    *VELOCITIES,
    *("angular_velocity_x", "angular_velocity_y", "angular_velocity_z"),
)
"""Names of the states of a body that may turn, in order; other bodies have only positions and velocities."""
ABOUT_Z = ("turn_z", "angular_velocity_z")
"""The states of the rotation about the magnet's axis."""


@dataclass(frozen=True, eq=False, repr=False)
class LinearMachine(Record):
    """dx/dt = A x + B u + G w, y = C x + D u, all as deviations from an operating point.

    x: position of the centre of mass (3), m; turn (3), rad, about the body's own axes, of a body that may turn;
    velocity (3), m/s; angular velocity (3), rad/s, of a body that may turn; currents, A, of amplifiers with a time
    constant and of coils with voltages; integrals, V, of current controllers. states: their names, "x", "turn_x",
    "velocity_x", "angular_velocity_x" and so on (`MOTION`), "i1" for a current, "integral1". u: the controller's
    outputs, such as lift (V), x and y. w: force (3), N, and torque (3), N m, frame of the map. y: the sensed point
    (3), m. at_rest (n,): the states at the operating point, where turns are 0.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    G: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    at_rest: Array
    operating_point: OperatingPoint
    assumptions: tuple[str, ...]

    @property
    def model(self) -> StateSpace:
        """(A, B, C, D) for fieldmap.control and scipy.signal."""
        return StateSpace(self.A, self.B, self.C, self.D)

    def to_control(self) -> python_control.StateSpace:
        """A state space of python-control with the names of states, inputs and outputs: u to y, without the loads w.

        Raises FieldmapError if python-control is not installed.
        """
        return self.model.to_control(None, self.states, self.inputs, self.outputs)

    def only(self, names: tuple[str, ...]) -> LinearMachine:
        """The machine with only some of its states; the other states are held.

        Parameters
        ----------
        names
            Names of the states.

        Returns
        -------
        LinearMachine
            The machine.

        Raises
        ------
        InputError
            For a name that is not a state.
        """
        must = f"must be among {', '.join(self.states)}"
        for name in names:
            check(name in self.states, "LinearMachine.only(names)", must, name, "choose among them")
        chosen = [self.states.index(name) for name in names]
        A, B, C, G = self.A[np.ix_(chosen, chosen)], self.B[chosen], self.C[:, chosen], self.G[chosen]
        return replace(self, A=A, B=B, C=C, G=G, states=names, at_rest=self.at_rest[chosen])

    @property
    def forces(self) -> tuple[Array, Array]:
        """Derivatives of the force on the body at rest with respect to its position (3, 3), N/m, and to the inputs
        (3, m), N, with the steady currents of the inputs."""
        moves = [self.states.index(name) for name in VELOCITIES]
        coils = [k for k, name in enumerate(self.states) if name not in MOTION]
        mass = 1.0 / self.G[moves[0], 0]
        reached = np.linalg.solve(self.A[np.ix_(coils, coils)], self.B[coils])
        return mass * self.A[moves, :3], mass * (self.B[moves] - self.A[np.ix_(moves, coils)] @ reached)


def linearise(machine: Machine, operating_point: OperatingPoint) -> LinearMachine:
    """Linearise a machine about an operating point.

    Derivatives are central differences of fourth order of the right-hand side that the compiled loop integrates:
    magnet, eddy currents and drag, without walls, limits, converters and noise. At a corner of a table of saturating
    iron they are the mean of both sides. With ideal drives the currents follow the commands (2), because R and L of a
    winding limit only large changes. With all other drives the currents are states, with the inductances at the
    operating point and the voltages that the moving body induces, (26).

    Iron with hysteresis has the slopes of loops about the operating point, docs/theory/hysteresis.md (6). The
    currents go straight from the memory to the operating point. Then each output swings so that the current with the
    largest change swings by `FieldOfCurrents.loop`, by default 5 mA, to either side. If a loop is given for other
    iron, its slopes are central differences over the loop.

    Parameters
    ----------
    machine
        The machine.
    operating_point
        Result of `find_operating_point`.

    Returns
    -------
    LinearMachine
        The matrices with the names of states, inputs and outputs.

    Raises
    ------
    OutsideMapError
        For a point at the edge of the map.
    InputError
        If the drive needs flux linkages, and the map has none.
    """
    body, state, coils = machine.body, operating_point.state, machine.drive.coils
    core, out = replace(machine, walls=None).core(1.0, search=True), np.empty(STATE)

    def rates(deviation: Array, core: CoreMachine = core) -> Array:
        """Rates of position, turn (as 0), velocity, angular velocity (12,) near the operating point."""
        moved = _moved(state, deviation[:12])
        core.follow(operating_point.currents + deviation[12:])
        where, there = "linearise(operating_point)", f"{moved[:3].tolist()} m"
        if core.rates(moved, out) != INSIDE:
            must = "must lie inside the map, 0.4 mm from its edge"
            raise OutsideMapError.of(where, must, there, "begin elsewhere, or make a larger map")
        remedy = "begin higher, lower the plate's face, or leave the plate out"
        check(bool(np.isfinite(out).all()), where, "must lie in front of the plate's face", there, remedy)
        return np.concatenate(
            [out[:3], np.zeros(3), out[VELOCITY : VELOCITY + 3], out[ANGULAR_VELOCITY:STATE]]
        )

    rows = [0, 1, 2, 6, 7, 8] if body.upright else list(range(12))
    steps = np.concatenate([np.repeat(np.array(_STEPS), 3), np.full(coils, _CURRENT_STEP)])
    slopes = np.zeros((12, 12 + coils))
    for k in (*rows, *range(12, 12 + coils)):
        direction = np.eye(len(steps))[k] * steps[k]
        slopes[:, k] = np.sum([share * rates(at * direction) for at, share in _STENCIL], axis=0) / steps[k]
    commanded = machine.drive.drives[:, 3, None] * machine.allocation.derivative(operating_point.outputs)
    loop: tuple[str, ...] = ()
    if machine.magnetic.loop is not None or machine.magnetic.remembered.size:
        slopes[:, 12:] = _of_loops(machine, rates, slopes[:, 12:], commanded)
        loop = (f"slopes by the currents of loops of {machine.magnetic.loop or _CURRENT_STEP:g} A",)
    # The rate of the turn is the angular velocity, which is 0 at the operating point: exact to first order.
    slopes[3:6, 9:12], slopes[:6, 12:] = np.eye(3), 0.0
    A, by_current = slopes[np.ix_(rows, rows)], slopes[rows, 12:]
    R, zeros = rotation(state), np.zeros((3, 3))
    # d(R a) = R (turn x a).
    C = np.hstack([np.eye(3), R @ np.cross(np.eye(3), body.seen_at).T, np.zeros((3, 6))])[:, rows]
    pushed = np.block([[np.eye(3) / body.mass, zeros], [zeros, R.T / body.inertia[:, None]]])
    G = np.vstack([np.zeros((6, 6)), pushed])[rows]
    names = tuple(MOTION[row] for row in rows)
    # Mass times the derivative of acceleration by current is also the derivative of the voltage by velocity.
    masses = np.concatenate([np.zeros(6), np.full(3, body.mass), body.inertia])[rows]
    of_coils = _coil_states(machine, operating_point, masses[:, None] * by_current, commanded)
    more = len(of_coils.names)
    B = np.vstack(
        [np.zeros((len(rows), commanded.shape[1])) if more else by_current @ commanded, of_coils.by_output]
    )
    felt = np.hstack([by_current, np.zeros((len(rows), max(more - coils, 0)))])[:, :more]
    A = np.block([[A, felt], [of_coils.by_motion, of_coils.by_itself]])
    C, G = np.hstack([C, np.zeros((3, more))]), np.vstack([G, np.zeros((more, 6))])
    assumptions = (
        *machine.assumptions,
        *loop,
        "small deviations from the operating point: no limits, no walls, no converters' steps",
        of_coils.note,
    )
    at_rest = np.concatenate([state[:3], np.zeros(len(rows) - 3), of_coils.at_rest])
    inputs, axes, none = machine.allocation.output_names, ("x", "y", "z"), np.zeros((3, B.shape[1]))
    states = (*names, *of_coils.names)
    return LinearMachine(A, B, C, none, G, states, inputs, axes, at_rest, operating_point, assumptions)


class _CoilStates(NamedTuple):
    """States (c,) of the coils, currents first. Derivatives with respect to the motion (c, rows), these states (c, c)
    and the outputs (c, m); names, values at rest (c,), and an assumption."""

    by_motion: Array
    by_itself: Array
    by_output: Array
    names: tuple[str, ...]
    at_rest: Array
    note: str


def _coil_states(
    machine: Machine, operating_point: OperatingPoint, pulls: Array, commanded: Array
) -> _CoilStates:
    """Dynamics from commands to currents. commanded (n, m): derivatives of the commands by the outputs; pulls (rows,
    n): derivatives of forces and torques by the currents."""
    drive, currents = machine.drive, operating_point.currents
    n, still = drive.coils, np.zeros_like(pulls.T)
    names = tuple(f"i{k + 1}" for k in range(n))
    if not drive.coupled:
        tau, note = drive.time_constant, "currents follow their commands"
        if not tau:
            note += " at once; supply and inductance only bound large changes"
            return _CoilStates(still[:0], np.zeros((0, 0)), commanded[:0], (), currents[:0], note)
        note += f" with a time constant of {1e3 * tau:g} ms"
        return _CoilStates(still, -np.eye(n) / tau, commanded / tau, names, currents, note)
    per_volt = np.linalg.inv(_inductance(machine, operating_point))
    _, _, _, proportional, integral, *_ = drive.coil_numbers(machine.magnetic.inductance()).T
    falls, note = drive.slope_of_fall(currents), f"inductances at {', '.join(f'{i:.3g}' for i in currents)} A"
    asked = proportional[:, None] * commanded if proportional.any() else commanded
    found = _CoilStates(
        -per_volt @ pulls.T, -per_volt * (falls + proportional), per_volt @ asked, names, currents, note
    )
    if not integral.any():
        return found
    return _CoilStates(
        np.vstack([found.by_motion, still]),
        np.block([[found.by_itself, per_volt], [-np.diag(integral), np.zeros((n, n))]]),
        np.vstack([found.by_output, integral[:, None] * commanded]),
        (*names, *(f"integral{k + 1}" for k in range(n))),
        np.concatenate([currents, falls * currents]),
        note,
    )


def _inductance(machine: Machine, operating_point: OperatingPoint) -> Array:
    """Derivatives of all flux linkages with respect to the currents (n, n), H. The payload contributes, because its
    soft iron, and its field in saturating iron, depend on the currents."""
    of, body, currents = machine.magnetic, machine.body, operating_point.currents
    state = operating_point.state
    own, R = of.field_map.inductance(currents), rotation(state)
    if of.iron != "model" and not body.magnet.soft:
        return own
    place, steps = state[:3] + R @ body.magnet_at, _CURRENT_STEP * np.eye(len(currents))

    def linked(amperes: Array) -> Array:
        return of.scale * payload_linkage(of.field_map, place, amperes, body.magnet, R)

    by_payload = [
        np.sum([share * linked(currents + at * step) for at, share in _STENCIL], axis=0) / _CURRENT_STEP
        for step in steps
    ]
    return np.asarray(own + np.transpose(by_payload))


def _of_loops(
    machine: Machine, rates: Callable[[Array, CoreMachine], Array], slopes: Array, commanded: Array
) -> Array:
    """Slopes (12, n) of `rates` by the currents: slopes of loops along each output, commanded (n, outputs), and the
    given slopes in other directions."""
    most, size = np.abs(commanded).max(axis=0), machine.magnetic.loop or _CURRENT_STEP
    swings = commanded * np.divide(size, most, out=np.zeros_like(most), where=most > 0.0)
    on_path = replace(machine, walls=None, magnetic=replace(machine.magnetic, tolerance=EXACT))
    secants = []
    for swing in swings.T:
        core, still = on_path.core(1.0), np.zeros(12)
        # Go to the operating point, then twice round the loop.
        *_, plus, minus = [
            rates(np.append(still, turn * swing), core) for turn in (0.0, 1.0, -1.0, 1.0, -1.0)
        ]
        secants.append(0.5 * (plus - minus))
    return with_secants(slopes, np.transpose(secants), swings)


def _moved(state: Array, deviation: ArrayLike) -> Array:
    """A state (13,) after a deviation (12,): position, turn about the body's axes, velocity, angular velocity."""
    d = check_signal("linearise", deviation)
    angle = float(np.linalg.norm(d[3:6]))
    half = 0.5 * np.sinc(0.5 * angle / np.pi) * d[3:6]
    w, u, c = state[TURN], state[TURN + 1 : TURN + 4], np.cos(0.5 * angle)
    turned = np.concatenate([[w * c - u @ half], w * half + c * u + np.cross(u, half)])
    return state_of(
        state[:3] + d[:3],
        state[VELOCITY : VELOCITY + 3] + d[6:9],
        turned,
        state[ANGULAR_VELOCITY:STATE] + d[9:],
    )


def moved_state(linear: LinearMachine, deviation: ArrayLike) -> Array:
    """The state (13,) of the machine at a deviation (states,) of the linear model."""
    given = check_signal("moved_state(deviation)", deviation)
    twelve = np.zeros(12)
    for name, value in zip(linear.states, given, strict=True):
        if name in MOTION:
            twelve[MOTION.index(name)] = value
    return _moved(linear.operating_point.state, twelve)


@dataclass(frozen=True, eq=False, repr=False)
class Mode(Record):
    """A pole, 1/s, with the shares (states,) of the states in it (sum 1), and its coupling to inputs and outputs.

    input_gains (inputs,), output_gains (outputs,): absolute values of the left eigenvector times B and of C times the
    right eigenvector, for vectors of length 1 in units of 1 mm, 0.1 rad, 10 mm/s, 1 rad/s, 0.1 A. A zero means that
    the input cannot excite the mode, or the output does not show it.
    """

    pole: complex
    shares: Array
    input_gains: Array
    output_gains: Array

    @property
    def frequency(self) -> float:
        """Frequency of the oscillation, Hz."""
        return float(abs(self.pole.imag) / (2.0 * np.pi))

    @property
    def damping(self) -> float:
        """Damping ratio: 1 does not oscillate, negative is unstable; NaN for an integrator, whose pole is zero."""
        return float(-self.pole.real / abs(self.pole)) if self.pole else float("nan")

    def named_shares(self, linear: LinearMachine, least: float = 0.05) -> dict[str, float]:
        """Shares above `least` by x, y, z and turn_x..: a position includes its velocity."""
        found: dict[str, float] = {}
        for name, share in zip(linear.states, self.shares, strict=True):
            key = _AXIS_OF.get(name, name)
            found[key] = found.get(key, 0.0) + float(share)
        return {name: share for name, share in found.items() if share >= least}


def modes(linear: LinearMachine) -> list[Mode]:
    """The modes of a linear machine.

    Parameters
    ----------
    linear
        The machine.

    Returns
    -------
    list[Mode]
        The modes, most unstable first. A pole that is zero within rounding is set to zero.
    """
    A, B, C = _in_units(linear)
    poles, left, right = scipy.linalg.eig(A, left=True)
    # A double pole is accurate to half of the digits.
    poles[np.abs(poles) < np.sqrt(np.finfo(float).eps) * np.linalg.norm(A, 2)] = 0.0
    found = []
    for k in np.lexsort((-poles.imag, -poles.real.round(9))):
        shares = np.abs(left[:, k].conj() * right[:, k])
        shares /= shares.sum() or 1.0
        found.append(Mode(complex(poles[k]), shares, np.abs(left[:, k].conj() @ B), np.abs(C @ right[:, k])))
    return found


def _in_units(linear: LinearMachine) -> tuple[Array, Array, Array]:
    """A, B and C for states in the units of `Mode`."""
    units = np.array([_unit_of(name) for name in linear.states])
    return linear.A / units[:, None] * units, linear.B / units[:, None], linear.C * units / _MILLI


def _unit_of(state: str) -> float:
    return next((unit for start, unit in _UNITS.items() if state.startswith(start)), _MILLI)


@dataclass(frozen=True, eq=False, repr=False)
class Controllability(Record):
    """Controllability and observability of the modes, by the test of Popov, Belevitch and Hautus.

    controllability, observability: smallest singular value of [A - s, B] and [A - s; C] over the modes with a real
    part above `above`, in the units of `Mode`: 0 means that a mode is not controllable, or not observable.
    worst_input, worst_output: the poles of these minima.
    """

    controllability: float
    observability: float
    worst_input: complex
    worst_output: complex


def controllability(linear: LinearMachine, above: float = -np.inf) -> Controllability:
    """Controllability and observability of the modes.

    Parameters
    ----------
    linear
        The machine.
    above
        Only modes with a real part above this bound, 1/s.

    Returns
    -------
    Controllability
        Controllability and observability of these modes.
    """
    A, B, C = _in_units(linear)
    poles = [complex(p) for p in scipy.linalg.eigvals(A) if p.real > above]
    if not poles:
        return Controllability(np.inf, np.inf, 0j, 0j)
    shifted = A - np.array(poles)[:, None, None] * np.eye(len(A))
    beside = np.concatenate([shifted, np.broadcast_to(B, (len(poles), *B.shape))], axis=2)
    below = np.concatenate([shifted, np.broadcast_to(C, (len(poles), *C.shape))], axis=1)
    by_input, by_output = (np.linalg.svd(each, compute_uv=False)[:, -1] for each in (beside, below))
    worst = int(by_input.argmin()), int(by_output.argmin())
    return Controllability(
        float(by_input[worst[0]]), float(by_output[worst[1]]), poles[worst[0]], poles[worst[1]]
    )


@dataclass(frozen=True, eq=False, repr=False)
class Coupling(Record):
    """Coupling of the axes at one frequency, Hz (0: constant inputs, as if the machine were stable).

    gain (outputs, inputs): absolute values, m per unit; relative (outputs, inputs): real parts of the relative gains.
    A relative gain is the response of an output to an input with the other inputs constant, divided by the response
    with the other outputs held. The identity means that the axes are decoupled (Bristol 1966).
    """

    frequency: float
    gain: Array
    relative: Array


def coupling(linear: LinearMachine, frequency: float = 0.0) -> Coupling:
    """Gains and relative gains of a machine with equal numbers of inputs and outputs.

    Parameters
    ----------
    linear
        The machine. The inputs lift, x and y are sorted in the order x, y, z.
    frequency
        Frequency of the gains, Hz.

    Returns
    -------
    Coupling
        The gains.
    """
    s = 2j * np.pi * frequency
    # The rotation of a magnet about its axis is a state with pole zero that no input drives, so the matrix is
    # singular at frequency 0. The least-squares solution of minimum norm leaves this state at 0.
    states = np.linalg.lstsq(s * np.eye(len(linear.A)) - linear.A, linear.B, rcond=None)[0]
    answer = linear.C @ states + linear.D
    if linear.inputs[:1] == ("lift_V",):
        answer = answer[:, [1, 2, 0]]
    # The pseudo-inverse ignores an input without effect (fewer coils than axes); otherwise it is the inverse.
    relative = answer * np.linalg.pinv(answer).T
    return Coupling(frequency, np.abs(answer) if frequency else answer.real, relative.real)
