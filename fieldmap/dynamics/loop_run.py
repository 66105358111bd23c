"""A recorded closed-loop run, how it ended, and its signals as named arrays for files and tables."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import asdict, dataclass, field

import numpy as np

from fieldmap.control.loop import LoopRun
from fieldmap.core.closed_loop import GOES_ON
from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import ANGULAR_VELOCITY, POSITION, STATE, TURN, VELOCITY
from fieldmap.dynamics.motion import turned
from fieldmap.plain import plain_items
from fieldmap.records import Record
from fieldmap.store import RunRecord
from fieldmap.typing import Array

EVENTS = {
    LIBRARY.FELL_OUT: ("fell out", "the magnet fell through the bottom of the map"),
    LIBRARY.LEFT_ABOVE: ("hit the pole", "the magnet left the map upward, to the pole"),
    LIBRARY.LEFT_SIDEWAYS: ("left the map", "the magnet left the map sideways"),
    LIBRARY.NOT_A_NUMBER: ("not finite", "the state is not finite"),
    LIBRARY.HIT_FLOOR: ("hit the floor", "the body touched the floor"),
    LIBRARY.HIT_POLE: ("hit the pole", "the body touched the ceiling below the pole"),
    LIBRARY.HIT_TUBE: ("hit the tube", "the body touched the wall of the tube"),
    LIBRARY.SATURATED: ("current saturates", "a limit of outputs, amplifiers or supply held without a break"),
    LIBRARY.BEYOND_CURRENTS: ("beyond the map's currents", "the currents left the domain of the map"),
    LIBRARY.CONTROLLER_FAILED: ("controller failed", "the function that is the controller failed"),
    LIBRARY.OUTPUTS_NOT_FINITE: ("controller failed", "outputs of the controller were not finite"),
}


@dataclass(frozen=True, repr=False)
class IronUse(Record):
    """The model of the iron in a run. model: "linear", "linearised" (saturating iron, about currents), "table" (over
    a current parametrisation) or "model" (of the map, solved whenever currents change).

    The counts are for "model" only. solves, newton_steps: numbers of solves and of all their Newton steps; unsolved:
    solves that did not converge and left the iron unchanged; outside: solves at currents outside the map's domain,
    where the error of the model is unknown.
    """

    model: str = "linear"
    solves: int = 0
    newton_steps: int = 0
    unsolved: int = 0
    outside: int = 0


@dataclass(frozen=True, eq=False, repr=False)
class WindingUse(Record):
    """Windings of coupled coils in a run, (n,) each: heat, and energy from the drive, J; time of the first recorded
    sample at which the winding was hotter than its limit, s, NaN for none."""

    heat: Array
    energy: Array
    too_hot: Array


@dataclass(frozen=True, eq=False, repr=False)
class Event(Record):
    """The event that ended a run early. name: short; about: a sentence; time, s; state (13,), currents (n,)."""

    name: str
    about: str
    time: float
    state: Array
    currents: Array

    def __str__(self) -> str:
        return f"{self.name} after {self.time:.4g} s: {self.about}"


class PartsOfState:
    """Names for parts of `state` (..., 13)."""

    @property
    @abstractmethod
    def state(self) -> Array:
        """Position, velocity, quaternion, angular velocity (..., 13)."""

    @property
    def position(self) -> Array:
        """Centre of mass (..., 3), m."""
        return self._part(POSITION, 3)

    @property
    def velocity(self) -> Array:
        """Velocity of the centre of mass (..., 3), m/s."""
        return self._part(VELOCITY, 3)

    @property
    def quaternion(self) -> Array:
        """Quaternion from the body to the map (..., 4), w first."""
        return self._part(TURN, 4)

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity (..., 3), rad/s, frame of the body."""
        return self._part(ANGULAR_VELOCITY, 3)

    def _part(self, first: int, count: int) -> Array:
        return np.asarray(self.state[..., first : first + count])


@dataclass(frozen=True, eq=False, repr=False)
class LevitationRun(PartsOfState, LoopRun):
    """A closed-loop run of a magnet on a map; one row per recorded control period, taken at its beginning.

    time (r,), s. rows (r, 13 + 2 n + 3 + m): state, currents, commanded currents, measured position, outputs.
    references (r, 3), m. event: the event that ended the run early, or None. touched: walls that the body touched,
    and "currents" if they left the table of saturating iron or the domain of its model. seen_at (3,): the sensed
    point in the body. forces: whether the outputs are forces, N, for an inverse map. output_names (m,): of other
    outputs. iron: the model of the iron, and its solves. windings: of coupled coils, which add voltages and
    temperatures (2 n) to the rows; None for ideal drives.
    """

    rows: Array
    coils: int
    seen_at: Array
    event: Event | None
    touched: tuple[str, ...]
    assumptions: tuple[str, ...]
    forces: bool
    output_names: tuple[str, ...] = field(default=(), kw_only=True)
    iron: IronUse = field(default=IronUse(), kw_only=True)
    windings: WindingUse | None = field(default=None, kw_only=True)

    @property
    def state(self) -> Array:
        """Position, velocity, quaternion, angular velocity (r, 13)."""
        return self.rows[:, :STATE]

    @property
    def currents(self) -> Array:
        """(r, n), A."""
        return self.rows[:, STATE : STATE + self.coils]

    @property
    def commanded(self) -> Array:
        """Commanded currents at the time of the sample (r, n), A."""
        return self.rows[:, STATE + self.coils : STATE + 2 * self.coils]

    @property
    def seen(self) -> Array:
        """Measured position of the sensed point (r, 3), m."""
        first = STATE + 2 * self.coils
        return self.rows[:, first : first + 3]

    @property
    def outputs(self) -> Array:
        """Outputs of the controller (r, m)."""
        return self.rows[:, STATE + 2 * self.coils + 3 : self._coupled.start]

    @property
    def _coupled(self) -> slice:
        """Columns of a row for voltages and temperatures of coupled coils."""
        return slice(self.rows.shape[1] - (0 if self.windings is None else 2 * self.coils), None)

    @property
    def voltages(self) -> Array:
        """Voltages of coupled coils (r, n), V, means over the last mechanical step; (r, 0) for ideal drives."""
        return self.rows[:, self._coupled][:, : self.coils]

    @property
    def temperatures(self) -> Array:
        """Temperatures of the windings of coupled coils (r, n), degC; (r, 0) for ideal drives."""
        return self.rows[:, self._coupled][:, self.coils :]

    @property
    def sensed(self) -> Array:
        """True position of the sensed point (r, 3), m."""
        return self.position + turned(self.quaternion, self.seen_at)

    @property
    def response(self) -> Array:
        """The signal that follows the references (r, 3), m: `sensed`."""
        return self.sensed

    @property
    def tilt(self) -> Array:
        """Angle (r,) of the body's axis against the vertical, rad."""
        return tilt_of(self.quaternion)


def tilt_of(quaternion: Array) -> Array:
    """Angle (...,) of the axis of a body against the vertical, rad, from its quaternions (..., 4), w first."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.hypot(quaternion[..., 1], quaternion[..., 2]), 0.0, 1.0)))


def event_of(number: int, time: float, state: Array, currents: Array) -> Event | None:
    """The event of a number of the core; None for a run that reached its end."""
    if number == GOES_ON:
        return None
    name, about = EVENTS[number]
    return Event(name, about, time, state, currents)


def recorded(
    run: LevitationRun, coil_names: tuple[str, ...], about: dict[str, object] | None = None
) -> RunRecord:
    """All signals of a run with units and columns, its end with the state at that time, and its assumptions."""
    coils = ", ".join(coil_names)
    arrays = {
        "time": (run.time, "s", "time"),
        "position": (run.position, "m", "x, y, z of the centre of mass"),
        "velocity": (run.velocity, "m/s", "x, y, z"),
        "quaternion": (run.quaternion, "1", "w, x, y, z, body to map"),
        "spin": (run.angular_velocity, "rad/s", "about the body's axes"),
        "sensed": (run.sensed, "m", "x, y, z of the sensed point, as it is"),
        "seen": (run.seen, "m", "x, y, z of the sensed point, as the controller sees it"),
        "reference": (run.references, "m", "x, y, z of the sensed point"),
        "currents": (run.currents, "A", coils),
        "commanded": (run.commanded, "A", coils),
        "outputs": _outputs(run, coil_names),
    }
    if run.windings is not None:
        arrays["voltages"] = (run.voltages, "V", coils)
        arrays["temperatures"] = (run.temperatures, "degC", coils)
    event = run.event
    ended: dict[str, object] = {"event": "", "end_s": float(run.time.max(initial=0.0))}
    if event is not None:
        at = plain_items(state=event.state, currents=event.currents)
        ended = {"event": event.name, "about_event": event.about, "end_s": event.time, **at}
    notes = {"touched": list(run.touched), "iron": asdict(run.iron), "assumptions": list(run.assumptions)}
    if run.windings is not None:
        of = run.windings
        notes["windings"] = plain_items(heat_J=of.heat, energy_J=of.energy, too_hot_s=of.too_hot)
    return RunRecord(arrays, {**ended, **notes, **(about or {})})


def _outputs(run: LevitationRun, coil_names: tuple[str, ...]) -> tuple[Array, str, str]:
    """Outputs, their unit, and the names of their columns."""
    if run.forces:
        return run.outputs, "N", "x, y, z of the force that is asked for"
    for unit in "AV":
        if run.output_names and all(name.endswith(f"_{unit}") for name in run.output_names):
            return run.outputs, unit, ", ".join(coil_names)
    return run.outputs, "V, 1, 1", "lift, x signal, y signal"


def as_csv(record: RunRecord) -> str:
    """The signals of a run as CSV text: one row per sample, names with units in the first line."""
    names, columns = [], []
    for name, (values, unit, about) in record.arrays.items():
        wide = values.reshape(len(values), -1)
        parts = [part.strip() for part in about.split(",")]
        units = [part.strip() for part in unit.split(",")]
        for k in range(wide.shape[1]):
            part = parts[k].split(" ")[0] if k < len(parts) else k
            label = name if wide.shape[1] == 1 else f"{name} {part}"
            names.append(f"{label} ({units[min(k, len(units) - 1)]})")
            columns.append(wide[:, k])
    rows = np.column_stack(columns)
    lines = [",".join(names), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"
