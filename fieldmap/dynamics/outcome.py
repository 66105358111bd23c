"""What comes out of a run, and how it ended."""

from dataclasses import dataclass

import numpy as np

from fieldmap.kernels.motion import events
from fieldmap.kernels.motion.layout import POSITION, SPIN, STATE, TURN, VELOCITY
from fieldmap.typing import Array

EVENTS = {
    events.FELL_OUT: ("fell out", "the magnet fell through the bottom of the map"),
    events.LEFT_ABOVE: ("hit the pole", "the magnet left the map upward, to the pole"),
    events.LEFT_SIDEWAYS: ("left the map", "the magnet left the map sideways"),
    events.NOT_A_NUMBER: ("not finite", "the state is no number any more"),
    events.HIT_FLOOR: ("hit the floor", "the body touched the floor"),
    events.HIT_POLE: ("hit the pole", "the body touched the ceiling below the pole"),
    events.HIT_TUBE: ("hit the tube", "the body touched the wall of the tube"),
    events.SATURATED: ("current saturates", "a limit of outputs, amplifiers or supply held without a break"),
    events.BEYOND_CURRENTS: ("beyond the map's currents", "the currents left the domain of the map"),
}


@dataclass(frozen=True, eq=False)
class Event:
    """Why a run ended early. name: short; about: a sentence; time, s; state (13,) and currents (n,) at that moment."""

    name: str
    about: str
    time: float
    state: Array
    currents: Array


@dataclass(frozen=True, eq=False)
class LoopRun:
    """A closed-loop run; one row per recorded control period, taken at its beginning.

    time (r,), s. rows (r, 13 + 2 n + 3 + m): state, currents, commanded currents, what the controller sees, its
    outputs. references (r, 3), m. event: why it ended early, or None. touched: walls that were met, and
    "currents" if they were ever beyond the table of saturating iron. seen_at (3,): the
    sensed point in the body. forces: whether the outputs are forces, N, that the inverse map makes.
    """

    time: Array
    rows: Array
    coils: int
    seen_at: Array
    references: Array
    event: Event | None
    touched: tuple[str, ...]
    assumptions: tuple[str, ...]
    forces: bool

    @property
    def position(self) -> Array:
        """Centre of mass (r, 3), m."""
        return self.rows[:, POSITION : POSITION + 3]

    @property
    def velocity(self) -> Array:
        """Of the centre of mass (r, 3), m/s."""
        return self.rows[:, VELOCITY : VELOCITY + 3]

    @property
    def quaternion(self) -> Array:
        """Body to map (r, 4), w first."""
        return self.rows[:, TURN : TURN + 4]

    @property
    def spin(self) -> Array:
        """Angular velocity (r, 3), rad/s, in the frame of the body."""
        return self.rows[:, SPIN : SPIN + 3]

    @property
    def currents(self) -> Array:
        """(r, n), A."""
        return self.rows[:, STATE : STATE + self.coils]

    @property
    def commanded(self) -> Array:
        """Currents that are asked for when the sample is taken, (r, n), A."""
        return self.rows[:, STATE + self.coils : STATE + 2 * self.coils]

    @property
    def seen(self) -> Array:
        """Position of the sensed point as the controller sees it (r, 3), m."""
        first = STATE + 2 * self.coils
        return self.rows[:, first : first + 3]

    @property
    def outputs(self) -> Array:
        """Of the controller (r, m)."""
        return self.rows[:, STATE + 2 * self.coils + 3 :]

    @property
    def sensed(self) -> Array:
        """True position of the sensed point (r, 3), m."""
        w, u = self.quaternion[:, :1], self.quaternion[:, 1:]
        twice = 2.0 * np.cross(u, self.seen_at)
        return self.position + self.seen_at + w * twice + np.cross(u, twice)

    @property
    def tilt(self) -> Array:
        """Angle (r,) of the body's axis against the vertical, rad."""
        x, y = self.quaternion[:, 1], self.quaternion[:, 2]
        return 2.0 * np.arcsin(np.clip(np.hypot(x, y), 0.0, 1.0))


def event_of(number: int, time: float, state: Array, currents: Array) -> Event | None:
    """The event behind a kernel's number; None for a run that went to its end."""
    if number == events.NOTHING:
        return None
    name, about = EVENTS[number]
    return Event(name, about, time, state, currents)
