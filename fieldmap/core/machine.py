"""A body with magnets, its coils and their field, as the C core moves them (fieldmap/core/machine.h)."""

from typing import Any, NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

POSITION: int = LIBRARY.POSITION
VELOCITY: int = LIBRARY.VELOCITY
TURN: int = LIBRARY.TURN
ANGULAR_VELOCITY: int = LIBRARY.ANGULAR_VELOCITY
STATE: int = LIBRARY.STATE
"""Where things begin in a state: position and velocity of the centre of mass, frame of the map; quaternion (w, x, y, z)
from the body to the map; angular velocity, frame of the body. And how long it is."""
INSIDE: int = LIBRARY.OK
"""Status of a map for a point at which its field is known."""


class BodyNumbers(NamedTuple):
    """A rigid body and its surroundings, with the names and units of fieldmap_rigid_body (rigid_body.h, losses.h,
    contact.h). drag (5, 3); plate (8,): conductivity, thickness, face (3), normal (3); seen_by_plate (6,): point and
    moment; walls (9,): stiffness, damping, friction, slip, floor, ceiling, radius, axis (2); skin (k, 3); magnetic: of
    a `CoreBody`."""

    mass: float
    inertia: Array
    gravity: Array
    force: Array
    torque: Array
    drag: Array
    plate: Array
    seen_by_plate: Array
    walls: Array
    skin: Array
    magnetic: Any


class CoupledCoils(NamedTuple):
    """Coils that linkages couple, with names and units of fieldmap_coil and fieldmap_electrical (electrical.h): coils
    (n, 15), inductance (n, n), constant (n,), largest."""

    coils: Array
    inductance: Array
    constant: Array
    largest: float


class CoilState(NamedTuple):
    """Of coupled coils, (n,) each: linkage, Wb; integral of the controller, V; what is asked for, A or V; mean voltage
    of the last step, V; heat of the winding and energy taken, J; temperature, degC; what limits, 0 for nothing.
    tangents, steps: how many inductances were made anew, and Newton steps."""

    linkage: Array
    integral: Array
    asked: Array
    voltage: Array
    heat: Array
    input: Array
    temperature: Array
    source: Array
    tangents: int
    steps: int


class Plant(NamedTuple):
    """What a `CoreMachine` is made of. map: of a `CoreMap`; seen_at (3,): the sensed point in the body. How the fields'
    weights follow the currents, times scale: iron, of a `CoreIron.state`, solved to `tolerance`, or table, of a
    `CoreTable`; without both a field a coil, and one more of weight 1. on_path: 1 where the currents are those of a
    path, which iron with hysteresis remembers, 0 for trials. windings (n, 4), drives (n, 7): as fieldmap_winding and
    fieldmap_drive (currents.h, instruments.h). coupled: coils in the place of the windings."""

    map: Any
    body: BodyNumbers
    seen_at: Array
    scale: float
    iron: Any
    tolerance: float
    table: Any
    windings: Array
    drives: Array
    on_path: int = 1
    coupled: CoupledCoils | None = None


class Allocation(NamedTuple):
    """Outputs to voltages. division: 1 for a lift and two directions, with this exponent; 0 for matrix (n, m) @ outputs
    + constant (n,)."""

    division: int
    exponent: float
    matrix: Array
    constant: Array


class InverseMap(NamedTuple):
    """machine: of a `CoreMachine` of its own; rounds: how many a search is given; limits (2, 3) of the outputs; signals
    (3,): those of the last search, where the next begins; believed (13,): the state whose turn is taken for the body's,
    its position filled in."""

    machine: Any
    rounds: int
    limits: Array
    signals: Array
    believed: Array


class Solves(NamedTuple):
    """Of the iron's model: solves, their Newton steps, those that did not converge, those beyond the domain."""

    solves: int
    newton_steps: int
    unsolved: int
    outside: int


class CoreMachine:
    """A machine, for one thread at a time: it remembers the field of the last currents. Arrays are float64 and in C
    order; others raise TypeError. Statuses are those of a map: `INSIDE` where its field is known."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.machine = LIBRARY.machine(plant)

    def follow(self, currents: Array) -> bool:
        """The field becomes that of currents (n,); whether they lie in the table, or the domain of the model, by which
        it follows them."""
        return bool(LIBRARY.machine_follow(self.machine, currents))

    @property
    def weights(self) -> Array:
        """Of the fields of the map, as they are (f,): a copy."""
        return LIBRARY.machine_weights(self.machine)

    @property
    def solves(self) -> Solves:
        """What was solved so far."""
        return Solves(*LIBRARY.machine_solves(self.machine))

    @property
    def coil_state(self) -> CoilState | None:
        """State of coupled coils; None without."""
        found = LIBRARY.machine_electrical(self.machine)
        return None if found is None else CoilState(*found[0], *found[1:])

    def load(self, state: Array, load: Array) -> tuple[int, int]:
        """Fill load (6,) at a state (13,): force, frame of the map, and torque, frame of the body, of all but losses.
        The status, and the sum of what is touched."""
        status, touched = LIBRARY.machine_load(self.machine, state, load)
        return status, touched

    def energy(self, state: Array) -> float | None:
        """Of the magnets and the soft iron in the field, J; None where that is not known."""
        return LIBRARY.machine_energy(self.machine, state)

    def rates(self, state: Array, out: Array) -> int:
        """Fill the time derivative out (13,) of a state; the status."""
        return int(LIBRARY.machine_rates(self.machine, state, out))

    def losses(self, state: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Force (3), frame of the map, and torque (3), frame of the body, of drag and eddy currents at a state."""
        force, torque = LIBRARY.machine_losses(self.machine, state)
        return force, torque

    def move(self, state: Array, step: float, every: int, order: int, states: Array) -> tuple[int, int, int]:
        """Advance a state in the field as it is, by steps of second or fourth order: fill states (rows, 13), the first
        after no step, each after `every` more. Rows filled, status, and what was touched."""
        filled, status, touched = LIBRARY.machine_move(self.machine, state, step, every, order, states)
        return filled, status, touched

    def advance(
        self, step: float, steps: int, commands: Array, state: Array, currents: Array, load: Array
    ) -> int:
        """Advance state (13,), currents (n,) and load (6,) by so many steps at commands (n,); the status."""
        return int(LIBRARY.machine_advance(self.machine, step, steps, commands, state, currents, load))


def rotation(state: Array) -> Array:
    """The matrix (3, 3) that takes vectors from the body of a state (13,) to the map."""
    return LIBRARY.rotation(state[TURN : TURN + 4])


def sensed_point(state: Array, seen_at: Array) -> Array:
    """Where a point (3,) of the body of a state (13,) lies in the map, m."""
    return state[POSITION : POSITION + 3] + rotation(state) @ seen_at


def inverse_along(
    inverse: InverseMap, allocation: Allocation, positions: Array, forces: Array, found: Array, left: Array
) -> None:
    """Fill found (p, 3): the outputs at which the magnets of a body at positions (p, 3) feel forces (p, 3), N, each
    search beginning where the last ended; and left (p,): what is missing, N, NaN outside the map."""
    LIBRARY.inverse_along(inverse, allocation, positions, forces, found, left)


def plate_force(
    plate: Array, place: Array, moment: Array, velocity: Array, rate: Array
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Force (3), and turning (3), so that the torque is moment x turning, of eddy currents in a plate (8,) on a dipole
    at a place, of this moment, velocity and rate of change of the moment, (3,) each, frame of the map."""
    force, turning = LIBRARY.plate_force(plate, place, moment, velocity, rate)
    return force, turning
