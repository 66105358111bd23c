"""A body with magnets, its coils and their field, as the C core simulates them (fieldmap/core/machine.h)."""

from typing import Any, NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

POSITION: int = LIBRARY.POSITION
VELOCITY: int = LIBRARY.VELOCITY
TURN: int = LIBRARY.TURN
ANGULAR_VELOCITY: int = LIBRARY.ANGULAR_VELOCITY
STATE: int = LIBRARY.STATE
"""First indices in a state: position and velocity of the centre of mass, frame of the map; quaternion (w, x, y, z)
from the body to the map; angular velocity, frame of the body. STATE: length of a state."""
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
    """Coils that flux linkages couple, with the names and units of fieldmap_coil and fieldmap_electrical
    (electrical.h): coils (n, 15), inductance (n, n), constant (n,), largest."""

    coils: Array
    inductance: Array
    constant: Array
    largest: float


class CoilState(NamedTuple):
    """State of coupled coils, (n,) each: linkage, Wb; integral of the controller, V; demand, A or V; mean voltage of
    the last step, V; heat of the winding and input energy, J; temperature, degC; active limit, 0 for none. tangents,
    steps: numbers of updates of the inductances, and of Newton steps."""

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
    """Parts of a `CoreMachine`. map: of a `CoreMap`; seen_at (3,): the sensed point in the body. The fields' weights,
    times scale, follow from the currents by iron, of a `CoreIron.state`, solved to `tolerance`, or by table, of a
    `CoreTable`. Without both there is a field for each coil, and possibly one more of weight 1. on_path: 1 if iron
    with hysteresis remembers the currents, 0 for trial currents. windings (n, 4), drives (n, 7): as fieldmap_winding
    and fieldmap_drive (currents.h, instruments.h). coupled: coupled coils, which replace the windings."""

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
    """Voltages from outputs. division: 1 for a lift and two directions; 0 for matrix (n, m) @ outputs + constant
    (n,)."""

    division: int
    exponent: float
    matrix: Array
    constant: Array


class InverseMap(NamedTuple):
    """machine: of a separate `CoreMachine`; rounds: largest number of Newton steps of a search; limits (2, 3) of the
    outputs; signals (3,): result of the last search, from which the next one begins; believed (13,): state of the
    body, with a fixed rotation and the position of the sample."""

    machine: Any
    rounds: int
    limits: Array
    signals: Array
    believed: Array


class Solves(NamedTuple):
    """Counters of the iron's model: solves, Newton steps, solves without convergence, solves outside the domain."""

    solves: int
    newton_steps: int
    unsolved: int
    outside: int


class CoreMachine:
    """A machine, for one thread at a time: it stores the field of the last currents. Arrays are float64 and in C
    order; any other array raises TypeError. A status is the status of the map: `INSIDE` where its field is known."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.machine = LIBRARY.machine(plant)

    def follow(self, currents: Array) -> bool:
        """Set the field to that of currents (n,). Returns whether they lie in the table or the domain of the iron."""
        return bool(LIBRARY.machine_follow(self.machine, currents))

    @property
    def weights(self) -> Array:
        """Present weights of the fields of the map (f,), a copy."""
        return LIBRARY.machine_weights(self.machine)

    @property
    def solves(self) -> Solves:
        """Counters of solves so far."""
        return Solves(*LIBRARY.machine_solves(self.machine))

    @property
    def coil_state(self) -> CoilState | None:
        """State of coupled coils; None without coupled coils."""
        found = LIBRARY.machine_electrical(self.machine)
        return None if found is None else CoilState(*found[0], *found[1:])

    def load(self, state: Array, load: Array) -> tuple[int, int]:
        """Fill load (6,) at a state (13,): force, frame of the map, and torque, frame of the body, without losses.
        Returns the status, and the sum of the contact flags."""
        status, touched = LIBRARY.machine_load(self.machine, state, load)
        return status, touched

    def energy(self, state: Array) -> float | None:
        """Energy of the magnets and the soft iron in the field, J; None where the field is unknown."""
        return LIBRARY.machine_energy(self.machine, state)

    def rates(self, state: Array, out: Array) -> int:
        """Fill the time derivative out (13,) of a state. Returns the status."""
        return int(LIBRARY.machine_rates(self.machine, state, out))

    def losses(self, state: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return force (3), frame of the map, and torque (3), frame of the body, of drag and eddy currents."""
        force, torque = LIBRARY.machine_losses(self.machine, state)
        return force, torque

    def move(self, state: Array, step: float, every: int, order: int, states: Array) -> tuple[int, int, int]:
        """Advance a state in the present field, by steps of second or fourth order. Fill states (rows, 13): the first
        is the start, and each later one follows after `every` steps. Returns the number of rows filled, the status,
        and the contact flags."""
        filled, status, touched = LIBRARY.machine_move(self.machine, state, step, every, order, states)
        return filled, status, touched

    def advance(
        self, step: float, steps: int, commands: Array, state: Array, currents: Array, load: Array
    ) -> int:
        """Advance state (13,), currents (n,) and load (6,) by steps at commands (n,). Returns the status."""
        return int(LIBRARY.machine_advance(self.machine, step, steps, commands, state, currents, load))


def rotation(state: Array) -> Array:
    """Return the matrix (3, 3) that rotates vectors from the body of a state (13,) to the map."""
    return LIBRARY.rotation(state[TURN : TURN + 4])


def sensed_point(state: Array, seen_at: Array) -> Array:
    """Return the position in the map, m, of a point (3,) of the body at a state (13,)."""
    return state[POSITION : POSITION + 3] + rotation(state) @ seen_at


def inverse_along(
    inverse: InverseMap, allocation: Allocation, positions: Array, forces: Array, found: Array, left: Array
) -> None:
    """Fill found (p, 3), the outputs at which forces (p, 3), N, act on the magnets of a body at positions (p, 3).
    Each search begins at the last result. Fill left (p,), the largest missing component, N; NaN outside the map."""
    LIBRARY.inverse_along(inverse, allocation, positions, forces, found, left)


def plate_force(
    plate: Array, place: Array, moment: Array, velocity: Array, rate: Array
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return force (3) and turning (3) of eddy currents in a plate (8,) on a dipole; the torque is moment x turning.
    Place, moment, velocity and rate of change of the moment are (3,) each, frame of the map."""
    force, turning = LIBRARY.plate_force(plate, place, moment, velocity, rate)
    return force, turning
