"""A problem of design as data: what of a device may change, what is to be smallest, and what must hold.

`fieldmap.studies.optimisation` solves it; a study file with [optimise] and the arguments of `fm.optimise` both become
one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import records
from fieldmap.device.changes import changed
from fieldmap.device.model import Device
from fieldmap.field import FieldAtCurrents
from fieldmap.inputs.document import Document
from fieldmap.iron.sensitivity.quantities import Quantity as FieldQuantity
from fieldmap.studies.study import CurrentSet, IronModel, Record
from fieldmap.typing import Array

CURRENT = "current."
"""Begins the key of the current of a coil."""
METHODS = ("SLSQP", "trust-constr", "COBYQA", "optuna")
WITHOUT_SLOPES = frozenset({"COBYQA", "optuna"})
# Of a difference, as a share of the distance between the bounds.
_STEP = 0.02


@dataclass(frozen=True, repr=False)
class Linked(records.Record):
    """Keys that follow a variable: offset + factor * value, in the units of the keys."""

    keys: tuple[str, ...]
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, repr=False)
class Variable(records.Record):
    """A number of the device that may change between bounds, in the unit of its key.

    key: a key path of the device file, "parameters.NAME", or "current.NAME" for the current of a coil, A ("current.*"
    for all of them). start: where the search begins, the device's own value unless given. linked: keys that follow.
    step: of differences, where derivatives are taken by them; a fiftieth of the distance between the bounds unless
    given.
    """

    key: str
    lower: float
    upper: float
    start: float | None = None
    linked: tuple[Linked, ...] = ()
    step: float | None = None

    @property
    def difference(self) -> float:
        """Step of differences."""
        return self.step or _STEP * (self.upper - self.lower)

    @property
    def is_current(self) -> bool:
        """Whether it is the current of coils."""
        return self.key.startswith(CURRENT)

    def settings(self, value: float) -> tuple[tuple[str, float], ...]:
        """Every key of the device file that it sets, with the value there."""
        if self.is_current:
            return ()
        followers = [(key, one.offset + one.factor * value) for one in self.linked for key in one.keys]
        return ((self.key, value), *followers)


DesignFunction: TypeAlias = Callable[[Device, FieldAtCurrents], float]
"""function(device, state) -> a number."""


@dataclass(frozen=True, eq=False, repr=False)
class Number(records.Record):
    """A number that a study records, by the name of its column without the unit: "equilibrium_area", "current 5",
    "flux_density 1 z" (of the first point).

    currents: name of the set of currents; may be left out where there is one. minus: of another set, at which the same
    number is taken and subtracted: how far an equilibrium moves is "equilibrium_x" at one set minus that at another.
    of: in the place of the name's meaning, a quantity of `state.derivative`, which gives one number and has exact
    derivatives, or any function of the device and the state, which is differenced. name is then any text.
    """

    name: str
    currents: str = ""
    minus: str = ""
    of: FieldQuantity | DesignFunction | None = None

    @property
    def label(self) -> str:
        """Name with its sets of currents.

        >>> Number("equilibrium_x", "signal", minus="equal").label
        'equilibrium_x, signal - equal'
        """
        sets = " - ".join(name for name in (self.currents, self.minus) if name)
        return f"{self.name}, {sets}" if sets else self.name


@dataclass(frozen=True, eq=False, repr=False)
class Limit(records.Record):
    """A number that must not leave lower to upper, in its SI unit. number: as text, of the only set of currents."""

    number: Number | str
    lower: float = -np.inf
    upper: float = np.inf

    @property
    def scale(self) -> float:
        """What its violation is measured by: the largest of its bounds by size; 1 where that is 0."""
        finite = [abs(bound) for bound in (self.lower, self.upper) if np.isfinite(bound)]
        return max(finite, default=0.0) or 1.0

    def violation(self, value: float) -> float:
        """How far a value lies outside, in its unit; 0 inside.

        >>> Limit("power", upper=10.0).violation(12.5)
        2.5
        """
        return max(self.lower - value, value - self.upper, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class Carrying(records.Record):
    """Currents that carry the payload with its centre at a position (3,), m. shares (c,): of each coil, 1 unless
    given."""

    position: ArrayLike
    shares: ArrayLike | None = None


@dataclass(frozen=True, eq=False, repr=False)
class DesignProblem(records.Record):
    """What to optimise. document: the device file; numbers: of the study that objective and limits are made of, with
    their sets of currents written out. sign: 1 to minimise the objective, -1 to maximise it. method: one of METHODS;
    solves: at most that many; tolerance: relative change of the objective at which the search ends, and violation of a
    limit that counts as none; check_refinement: how much finer the mesh is on which the optimum is checked, None for
    no check. besides: other numbers that are asked of each design."""

    title: str
    document: Document
    variables: tuple[Variable, ...]
    objective: Number
    sign: float
    limits: tuple[Limit, ...]
    current_sets: tuple[CurrentSet, ...]
    iron: IronModel
    record: Record
    coil_names: tuple[str, ...]
    body_names: tuple[str, ...]
    method: str
    solves: int
    tolerance: float
    check_refinement: float | None
    seed: int = 0
    besides: tuple[Number, ...] = ()

    @property
    def numbers(self) -> tuple[Number, ...]:
        """Objective first, then those of the limits and others, each once."""
        limited = [limit.number for limit in self.limits]
        every = [self.objective, *(one for one in limited if isinstance(one, Number)), *self.besides]
        return tuple({one.label: one for one in every}.values())

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the variables."""
        return tuple(variable.key for variable in self.variables)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (k,)."""
        return (
            np.array([variable.lower for variable in self.variables]),
            np.array([variable.upper for variable in self.variables]),
        )

    def named(self, values: Array) -> dict[str, float]:
        """Values (k,) by key."""
        return {key: float(value) for key, value in zip(self.keys, values, strict=True)}

    def document_at(self, values: Array) -> Document:
        """The device file with these values of the variables."""
        return changed(self.document, settings_at(self.variables, self.named(values)))

    def currents_at(self, values: Array) -> tuple[CurrentSet, ...]:
        """The sets of currents with these values of the variables: coils whose current varies have it in every set
        whose currents are given."""
        varied = {
            variable.key.removeprefix(CURRENT): float(value)
            for variable, value in zip(self.variables, values, strict=True)
            if variable.is_current
        }
        return tuple(_with_currents(entry, self.coil_names, varied) for entry in self.current_sets)


def settings_at(variables: tuple[Variable, ...], values: Mapping[str, float]) -> list[tuple[str, Any]]:
    """Every key that variables set at values by their keys."""
    return [pair for variable in variables for pair in variable.settings(values[variable.key])]


def _with_currents(entry: CurrentSet, names: tuple[str, ...], varied: Mapping[str, float]) -> CurrentSet:
    if not varied or entry.common is None:
        return entry
    amperes = entry.common * entry.shares
    amperes = np.array([varied.get(name, varied.get("*", i)) for name, i in zip(names, amperes, strict=True)])
    common = float(np.abs(amperes).mean())
    # Without any current there are no shares; the number 0 stands for them.
    return CurrentSet(entry.name, amperes / common if common else amperes, common, entry.carried_at)
