"""Linear plants of a levitated body about its equilibrium: from a map's forces, or from the lumped model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.constants import GRAVITY
from fieldmap.control.linear_models import StateSpace
from fieldmap.device.model import Payload
from fieldmap.field import AnyField, require_bounds, resolve_currents
from fieldmap.levitation.balance import CURRENT_STEP, Balance
from fieldmap.levitation.equilibrium import assumptions
from fieldmap.levitation.places import check_position
from fieldmap.lookup.payload import check_payload
from fieldmap.records import Record
from fieldmap.typing import Array

if TYPE_CHECKING:
    import control as python_control


def levitated_plant(
    mass: float, stiffness: ArrayLike, force_per_ampere: ArrayLike, damping: ArrayLike = 0.0
) -> StateSpace:
    """m d2x/dt2 = -stiffness x - damping dx/dt + force_per_ampere i about an equilibrium, one axis or
    several.

    For one axis take the diagonal of `Equilibrium.stiffness` or `LiftCurrent.stiffness` and its entry of
    `LiftCurrent.force_per_ampere`; the whole matrix, with the force per ampere of every coil, is the linked
    model of all axes. The angle of a magnet that turns is not part of it.

    Parameters
    ----------
    mass
        kg.
    stiffness
        -dF/dx, N/m (negative: unstable), a number or (axes, axes).
    force_per_ampere
        N/A, a number or (axes, inputs).
    damping
        N s/m, a number or (axes, axes).

    Returns
    -------
    StateSpace
        The model. States: positions, then velocities; outputs: positions.

    Raises
    ------
    InputError
        For numbers that are not finite, matrices that do not fit, a mass that is not positive.

    Examples
    --------
    >>> levitated_plant(mass=0.01, stiffness=-4.0, force_per_ampere=0.1).A.tolist()
    [[0.0, 1.0], [400.0, -0.0]]
    """
    arguments.check_positive("levitated_plant", mass=mass)
    K = arguments.check_matrix("levitated_plant(stiffness)", stiffness, (None, None))
    axes = K.shape[0]
    K = arguments.check_matrix("levitated_plant(stiffness)", K, (axes, axes))
    force = arguments.check_matrix("levitated_plant(force_per_ampere)", force_per_ampere, (axes, None))
    loss = _damping("levitated_plant", damping, axes)
    still = np.zeros((axes, axes))
    A = np.block([[still, np.eye(axes)], [-K / mass, -loss / mass]])
    B = np.vstack([np.zeros_like(force), force / mass])
    return StateSpace(A, B, np.eye(axes, 2 * axes), np.zeros((axes, force.shape[1])))


def _damping(where: str, damping: ArrayLike, axes: int) -> Array:
    """Damping matrix (axes, axes), N s/m; a number holds for every axis."""
    given = np.asarray(damping, dtype=float)
    return arguments.check_matrix(
        f"{where}(damping)", given * np.eye(axes) if given.ndim == 0 else given, (axes, axes)
    )


@dataclass(frozen=True)
class LumpedMagnet(Record):
    """An electromagnet that lifts a body z below it (z downward, m): docs/theory/control.md (6).

    Inductance L(z) = L1 + L0 / (1 + z/a), force 1/2 dL/dz i^2. inductance: L0, H; length: a, m; mass: M, kg; damping:
    N s/m, positive where it opposes motion; gravity: m/s^2.
    """

    inductance: float
    length: float
    mass: float
    damping: float = 0.0
    gravity: float = GRAVITY

    def __post_init__(self) -> None:
        numbers = vars(self).copy()
        arguments.check_not_negative("LumpedMagnet", damping=numbers.pop("damping"))
        arguments.check_positive("LumpedMagnet", **numbers)

    def force(self, z: float, current: float) -> float:
        """Magnetic force along z.

        Parameters
        ----------
        z
            Position, m.
        current
            A.

        Returns
        -------
        float
            Force, N: negative, as it pulls up.
        """
        return -self.inductance * current**2 / (2 * self.length * self._widening(z) ** 2)

    def acceleration(self, z: float, velocity: float, current: float) -> float:
        """Acceleration along z.

        Parameters
        ----------
        z
            Position, m.
        velocity
            m/s.
        current
            A.

        Returns
        -------
        float
            d2z/dt2, m/s^2.
        """
        return self.gravity + (self.force(z, current) - self.damping * velocity) / self.mass

    def equilibrium_current(self, z: float) -> float:
        """The current that carries the weight: (1 + z/a) sqrt(2 a M g / L0), a straight line in z.

        Parameters
        ----------
        z
            Position, m.

        Returns
        -------
        float
            Current, A.
        """
        weight = self.mass * self.gravity
        return self._widening(z) * float(np.sqrt(2 * self.length * weight / self.inductance))

    def plant(self, z: float) -> StateSpace:
        """The motion about an equilibrium, current in, position out: (6). Its gain is negative.

        Parameters
        ----------
        z
            Position of the equilibrium, m.

        Returns
        -------
        StateSpace
            The model.

        Examples
        --------
        >>> magnet = LumpedMagnet(inductance=0.01, length=0.05, mass=0.01)
        >>> bool(magnet.plant(0.02).B[1, 0] < 0 < magnet.plant(0.02).A[1, 0])
        True
        """
        current, wide = self.equilibrium_current(z), self._widening(z)
        stiffness = -self.inductance * current**2 / (self.length**2 * wide**3)
        per_ampere = -self.inductance * current / (self.length * wide**2)
        return levitated_plant(self.mass, stiffness, per_ampere, self.damping)

    def _widening(self, z: float) -> float:
        arguments.check_not_negative("LumpedMagnet", z=z)
        return 1.0 + z / self.length


def lumped_magnet_from_lift_currents(
    current_at_zero: float, slope: float, mass: float, damping: float = 0.0, gravity: float = GRAVITY
) -> LumpedMagnet:
    """The lumped magnet with measured equilibrium currents.

    The model's own law is a straight line, so both constants follow: a = current_at_zero / slope and L0 = 2 a
    M g / current_at_zero^2.

    Parameters
    ----------
    current_at_zero
        Equilibrium current at z = 0, A.
    slope
        Its slope along z, A/m.
    mass
        M, kg.
    damping
        N s/m.
    gravity
        g, m/s^2.

    Returns
    -------
    LumpedMagnet
        The magnet.

    Examples
    --------
    >>> magnet = lumped_magnet_from_lift_currents(1.215, 34.3, mass=0.01119)
    >>> print(round(magnet.equilibrium_current(0.010), 4), "A")
    1.558 A
    """
    where = "lumped_magnet_from_lift_currents"
    arguments.check_positive(where, current_at_zero=current_at_zero, slope=slope, mass=mass, gravity=gravity)
    length = current_at_zero / slope
    return LumpedMagnet(2 * length * mass * gravity / current_at_zero**2, length, mass, damping, gravity)


@dataclass(frozen=True, eq=False, repr=False)
class MapPlant(Record):
    """A levitated magnet, linear about a point of a map and one set of currents, in the frame of the map (z up).

    position (3,), m; currents (n_coils,), A; mass, kg; stiffness (3, 3) = -dF_i/dx_j, N/m; force_per_signal
    (3, signals), N per unit of each signal; damping (3, 3), N s/m; imbalance (3,): magnetic force plus weight at the
    point, over the weight, 0 at an equilibrium (it accelerates the real magnet, but is not part of the linear model);
    assumptions: of the numbers.
    """

    position: Array
    currents: Array
    mass: float
    stiffness: Array
    force_per_signal: Array
    damping: Array
    imbalance: Array
    assumptions: tuple[str, ...]

    @property
    def pole_products(self) -> Array:
        """K_ii/m (3,), 1/s^2: product of the two poles of x, y and z, each alone. If negative, one pole is unstable.

        Their sum is 0 for a moment that keeps its direction, with any coils and iron (Earnshaw).
        """
        return np.diag(self.stiffness) / self.mass

    def model(self) -> StateSpace:
        """All three axes: states x, y, z and their velocities, inputs the signals, outputs x, y, z."""
        return levitated_plant(self.mass, self.stiffness, self.force_per_signal, self.damping)

    def to_control(self) -> python_control.StateSpace:
        """`model` as a state space of python-control, with names. Raises FieldmapError if it is not installed."""
        axes = ("x", "y", "z")
        states = (*axes, *(f"velocity_{axis}" for axis in axes))
        inputs = [f"signal_{k}" for k in range(self.force_per_signal.shape[1])]
        return self.model().to_control(None, states, inputs, axes)

    def axis(self, axis: Literal["x", "y", "z"], signal: int = 0) -> StateSpace:
        """One axis alone, with the others held.

        Parameters
        ----------
        axis
            The axis.
        signal
            Number of the signal that is the input.

        Returns
        -------
        StateSpace
            The model from the signal to the coordinate, m.
        """
        i = self._axis("MapPlant.axis", axis)
        count = self.force_per_signal.shape[1]
        must = f"must be 0 to {count - 1}"
        arguments.check(0 <= signal < count, "MapPlant.axis(signal)", must, signal, "count from 0")
        force = self.force_per_signal[i, signal]
        return levitated_plant(self.mass, self.stiffness[i, i], force, self.damping[i, i])

    def damping_for_pole(self, axis: Literal["x", "y", "z"], pole: float) -> float:
        """The damping rate with which an axis alone has this real pole: -(s + K/(m s)).

        A map has no damping. For a pole from an identification, such as the slow one, this is the damping that
        follows from the pole and the map's stiffness.

        Parameters
        ----------
        axis
            The axis.
        pole
            s, 1/s.

        Returns
        -------
        float
            c/m, 1/s.
        """
        good = bool(np.isfinite(pole)) and pole != 0
        arguments.check(good, "MapPlant.damping_for_pole(pole)", "must be finite and not 0", pole, "in 1/s")
        return float(-(pole + self.pole_products[self._axis("MapPlant.damping_for_pole", axis)] / pole))

    @staticmethod
    def _axis(where: str, axis: str) -> int:
        return "xyz".index(arguments.check_choice(f"{where}(axis)", axis, "xyz"))


def plant_from_map(
    field: AnyField,
    payload: Payload | None,
    position: ArrayLike,
    currents: Any,
    signals: ArrayLike | None = None,
    damping: ArrayLike = 0.0,
    moment: Literal["fixed", "aligned"] = "fixed",
    signal_steps: ArrayLike | None = None,
) -> MapPlant:
    """The linear motion of the payload's magnet about a point of a map, at currents that should carry it there.

    Parameters
    ----------
    field
        An opened map, a solution, or any other `fieldmap.field.Field` with a box.
    payload
        The levitated body.
    position
        The magnet's centre (3,), m.
    currents
        (n_coils,), A, such as `lift_current(...).currents` or those of `find_equilibrium`.
    signals
        Currents (n_coils, k), A, per unit of each input signal, such as `division_slopes(u, x, y, n)`; every
        coil is an input unless given.
    damping
        N s/m, a number or (3, 3).
    moment
        "fixed" keeps the payload's direction; "aligned" lets the moment follow B.
    signal_steps
        Steps (k,) of the central differences in each signal; unless given, steps in which no current changes
        by more than 1 % of the largest. The differences are exact where the force is linear in the currents,
        and of second order in the step where iron saturates. For iron with hysteresis they are slopes of loops
        of this size, as in `FieldMap.by_currents`.

    Returns
    -------
    MapPlant
        The plant, in the frame of the map.

    Raises
    ------
    InputError
        For arguments that do not fit.
    OutsideMapError
        For a point or currents beyond the map.

    Examples
    --------
    >>> lift = lift_current(m, device.payload, point)  # doctest: +SKIP
    >>> slopes = division_slopes(lift.current, 0, 0, n=1.25)  # doctest: +SKIP
    >>> plant = plant_from_map(m, device.payload, point, lift.currents, slopes)  # doctest: +SKIP
    >>> A, B = zero_order_hold(*plant.axis("z", signal=0)[:2], Ts=2e-3)  # doctest: +SKIP
    """
    carried, where = check_payload(payload, "plant_from_map"), "plant_from_map"
    source, amperes = resolve_currents(field, currents)
    point = check_position(require_bounds(source), position, f"{where}(position)")
    count = len(source.coil_names)
    directions = arguments.check_matrix(
        f"{where}(signals)", np.eye(count) if signals is None else signals, (count, None)
    )
    arguments.check_choice(f"{where}(moment)", moment, ("fixed", "aligned"))
    held = carried.moment_vector if moment == "fixed" else None
    balance = Balance(source, amperes, carried.mass, carried.moment, held)
    loss = _damping(where, damping, 3)
    largest = np.abs(directions).max(axis=0)
    change = CURRENT_STEP * (np.abs(amperes).max() or 1.0)
    steps = np.divide(change, largest, out=np.ones_like(largest), where=largest > 0.0)
    if signal_steps is not None:
        steps = arguments.check_signal(f"{where}(signal_steps)", signal_steps)
        good = steps.shape == largest.shape and bool((steps > 0.0).all())
        must = f"must be {largest.size} positive numbers, one for each signal"
        arguments.check(good, f"{where}(signal_steps)", must, steps.tolist(), "leave it out for small steps")
    return MapPlant(
        position=point,
        currents=amperes,
        mass=carried.mass,
        stiffness=balance.stiffness(point),
        force_per_signal=balance.force_per_signal(point, directions, steps),
        damping=loss,
        imbalance=balance.residual(point[None, :])[0] / balance.weight,
        assumptions=(
            *assumptions(moment)[:2],
            "the field follows the currents without delay (no eddy currents, no amplifier)",
        ),
    )
