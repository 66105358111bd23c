"""Several bodies in the field of one machine. They interact with coils and with each other, directly and through
iron, and they touch walls and each other: docs/theory/reaction.md, docs/theory/dynamics.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_choice, check_positive, check_signal
from fieldmap.core.machine import ANGULAR_VELOCITY, INSIDE, STATE, TURN, VELOCITY, CoreMachine
from fieldmap.core.several_bodies import ON_BODY, UNSETTLED, CoreSeveralBodies
from fieldmap.dynamics.field_of_currents import modelled, sampled_field
from fieldmap.dynamics.motion import ORDERS
from fieldmap.dynamics.rigid_body import Drag, Plate, RigidBody, Walls
from fieldmap.field import Field, coil_currents
from fieldmap.lookup import FieldMap
from fieldmap.lookup.evaluation import outside_error
from fieldmap.lookup.magnetic_body import unsettled
from fieldmap.records import Record
from fieldmap.typing import Array

Control = Callable[[float, Array], ArrayLike]
"""A controller: function from time, s, and the states (n, 13) of all bodies to currents (n_coils,), A."""


@dataclass(frozen=True, eq=False, repr=False)
class SeveralBodiesRun(Record):
    """time (m,), s; states (m, n, 13) of n bodies, as from `state_of`; currents (m, n_coils), A, from that time on.

    inside: whether all magnets stayed in the map; known: whether all currents lay in the domain of the map's iron;
    touched, collided: whether a body touched a wall, and another body.
    """

    time: Array
    states: Array
    currents: Array
    inside: bool
    known: bool
    touched: bool
    collided: bool


@dataclass(frozen=True, eq=False, repr=False)
class SeveralBodies(Record):
    """n bodies in one field, with drag, plate and walls.

    field: a map, or a field with a box that can be sampled (`sampled_field`). The force on each body comes from the
    coils, from the magnets and soft iron of all other bodies, and from the reaction of the machine's iron to all
    bodies, if the map has it. drag, plate, walls: as for `move`; the eddy currents of different bodies do not
    interact. radii (n,), m: of spheres about the centres of mass with which bodies touch each other, with the contact
    time, restitution and friction of `walls`; 0, the default, for no contact. Raises InputError for invalid radii,
    and for a field that is neither a map nor the sum of its coils' fields.
    """

    field: Field
    bodies: tuple[RigidBody, ...]
    drag: Drag | None = None
    plate: Plate | None = None
    walls: Walls | None = None
    radii: ArrayLike | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "field", sampled_field(self.field))
        object.__setattr__(self, "bodies", tuple(self.bodies))
        count, remedy = len(self.bodies), "give a RigidBody for each"
        check(count > 0, "SeveralBodies(bodies)", "must be one or more", count, remedy)
        given = np.zeros(count) if self.radii is None else self.radii
        radii = np.array(check_signal("SeveralBodies(radii)", given))
        fits, must_hold = radii.shape == (count,) and bool((radii >= 0).all()), f"must be {count}, 0 or more"
        check(fits, "SeveralBodies(radii)", must_hold, radii.tolist(), "give one for each body, m")
        object.__setattr__(self, "radii", radii)

    def wrench(self, states: ArrayLike, currents: Any) -> Array:
        """Force and torque of the field on each body about its centre of mass.

        Parameters
        ----------
        states
            States (n, 13), from `state_of`.
        currents
            Currents (n_coils,), A.

        Returns
        -------
        Array
            Force, N, and torque, N m (n, 6), frame of the map.

        Raises
        ------
        OutsideMapError
            If a part of a body is outside the map.
        NotConverged
            If the moments of soft iron do not converge, because bodies overlap.
        """
        wrench = np.empty((len(self.bodies), 6))
        self._ask(self._states(states), currents, wrench)
        return wrench

    def energy(self, states: ArrayLike, currents: Any) -> float:
        """Kinetic energy, potential energy of the weight, and energy of magnets and soft iron in the field and in the
        fields of each other. Without losses it is constant at constant currents between contacts.

        Parameters
        ----------
        states, currents
            As for `wrench`.

        Returns
        -------
        float
            Energy, J.

        Raises
        ------
        OutsideMapError, NotConverged
            As `wrench`.
        """
        rows = self._states(states)
        total = self._ask(rows, currents, np.empty((len(rows), 6)))
        for body, row in zip(self.bodies, rows, strict=True):
            moving, turning = row[VELOCITY : VELOCITY + 3], row[ANGULAR_VELOCITY : ANGULAR_VELOCITY + 3]
            total += 0.5 * body.mass * float(moving @ moving) + 0.5 * float(turning**2 @ body.inertia)
            total += body.mass * body.gravity * float(row[2])
        return total

    def run(
        self,
        states: ArrayLike,
        currents: Control | ArrayLike,
        duration: float,
        step: float = 1e-4,
        *,
        sample: float = 1e-3,
        order: str = "second",
    ) -> SeveralBodiesRun:
        """The motion of all bodies, by steps of fixed length.

        Parameters
        ----------
        states
            States at the start (n, 13).
        currents
            Currents (n_coils,), A; or a controller, a function (time, states) -> currents, which is called at the
            beginning of every sample. Its currents flow at once, until the next sample.
        duration, step
            s.
        sample
            Period of the controller and of the rows of the result, s; a whole number of steps.
        order
            "second" or "fourth", as for `move`.

        Returns
        -------
        SeveralBodiesRun
            The run, which ends when a magnet leaves the map.

        Raises
        ------
        InputError
            For invalid arguments or currents of a controller.
        NotConverged
            If the moments of soft iron do not converge, because bodies overlap.
        """
        check_positive("SeveralBodies.run", duration=duration, step=step, sample=sample)
        rule = ORDERS[check_choice("SeveralBodies.run(order)", order, ORDERS)]
        every = round(sample / step)
        whole = every >= 1 and abs(every * step - sample) <= 1e-9 * sample
        check(
            whole, "SeveralBodies.run(sample)", "must be a number of steps", sample, f"{step:g} s is a step"
        )
        core, now = self._core(search=False), np.array(self._states(states))
        rows = round(duration / sample) + 1
        found, amperes = np.empty((rows, *now.shape)), np.empty((rows, len(self.field.coil_names)))
        # Constant currents: all rows in one call.
        block = 2 if callable(currents) else rows
        filled, status, touched, known = 1, INSIDE, 0, True
        found[0] = now
        while filled < rows and status == INSIDE:
            asked = currents((filled - 1) * sample, now.copy()) if callable(currents) else currents
            amperes[filled - 1 :] = coil_currents(asked, self.field.coil_names)
            known &= core.follow(amperes[filled - 1].copy())
            part = found[filled - 1 : filled - 1 + block]
            done, status, met = core.move(now, step, every, rule, part)
            filled, touched = filled + done - 1, touched | met
        if status == UNSETTLED:
            raise unsettled("SeveralBodies.run")
        return SeveralBodiesRun(
            sample * np.arange(filled, dtype=np.float64),
            found[:filled],
            amperes[:filled],
            inside=status == INSIDE,
            known=known,
            touched=bool(touched & ~ON_BODY),
            collided=bool(touched & ON_BODY),
        )

    def _core(self, search: bool) -> CoreSeveralBodies:
        """The bodies in the field of the coils; search: as for `FieldOfCurrents.plant`."""
        coils = len(self.field.coil_names)
        numbers = [body.numbers(self.drag, self.plate, self.walls) for body in self.bodies]
        at_once = np.zeros((coils, 4)), np.zeros((coils, 7))
        plant = self._follows.plant(numbers[0], np.zeros(3), *at_once, search=search)
        contact = (self.walls or Walls()).numbers(1.0)
        return CoreSeveralBodies(CoreMachine(plant), numbers, np.asarray(self.radii), contact)

    @cached_property
    def _follows(self) -> Any:
        assert isinstance(self.field, FieldMap)
        return modelled(self.field)

    @cached_property
    def _asked(self) -> CoreSeveralBodies:
        return self._core(search=True)

    def _ask(self, states: Array, currents: Any, wrench: Array) -> float:
        """Fill wrench (n, 6), and return the energy of the magnets and the soft iron, J."""
        core = self._asked
        core.follow(np.array(coil_currents(currents, self.field.coil_names), dtype=np.float64))
        status, energy = core.wrench(states, wrench)
        if status == UNSETTLED:
            raise unsettled("SeveralBodies")
        if status != INSIDE:
            place = core.fault()[1]
            raise outside_error(place[None], 1, self.field.lower, self.field.upper)
        return energy

    def _states(self, states: ArrayLike | Sequence[Array]) -> Array:
        rows = np.array(check_signal("SeveralBodies(states)", states, columns=STATE))
        shape = (len(self.bodies), STATE)
        lengths = np.linalg.norm(rows[..., TURN : TURN + 4], axis=-1)
        fits = rows.shape == shape and bool((np.abs(lengths - 1.0) <= 1e-9).all())
        must_hold = f"must be {shape} with quaternions of length 1"
        check(fits, "SeveralBodies(states)", must_hold, f"shape {rows.shape}", "make each by state_of")
        return rows
