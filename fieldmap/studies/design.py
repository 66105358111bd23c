"""Design problems: variables of a device, an objective, and limits.

`fieldmap.studies.reading` makes one from a study file with [optimise], `fieldmap.studies.design_checks` from the
arguments of `fm.optimise`; `fieldmap.studies.optimisation` solves it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from fieldmap import records
from fieldmap.device.changes import changed
from fieldmap.device.model import Device
from fieldmap.field import FieldAtCurrents
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.document import Document
from fieldmap.inputs.tables import Positive, Table, Text, broken, whole
from fieldmap.iron.sensitivity.quantities import Quantity as FieldQuantity
from fieldmap.maps.training.plan import Accuracy
from fieldmap.studies.quantities import Places, number_names
from fieldmap.studies.study import (
    CurrentSet,
    Linked,
    LinkedKeys,
    Record,
    Some,
    StudyIron,
    axis_labels,
    settings_with,
)
from fieldmap.typing import Array

CURRENT = "current."
"""Prefix of the key of a coil's current."""
Method = Literal["SLSQP", "trust-constr", "COBYQA", "optuna"]
WITHOUT_SLOPES = frozenset({"COBYQA", "optuna"})
# Default step of differences, as a share of the distance between the bounds.
_STEP = 0.02


@dataclass(frozen=True, repr=False)
class Variable(records.Record):
    """A number of the device that may change between bounds, in the unit of its key.

    key: a key path of the device file, "parameters.NAME", or "current.NAME" for the current of a coil, A ("current.*"
    for all of them). start: start value, the device's own value unless given. linked: keys that depend on this one.
    step: of differences, for derivatives without an exact one; a fiftieth of the distance between the bounds unless
    given.
    """

    key: Annotated[
        str,
        Key(
            Text,
            'key path of the device file, "parameters.NAME", or "current.NAME" of a coil',
            examples=("body.disk.radius_mm",),
        ),
    ]
    lower: Annotated[float, Key(float, "lower bound, in the unit of the key")]
    upper: Annotated[float, Key(float, "upper bound")]
    start: Annotated[
        float | None,
        Key(float | None, "where the search begins; the device's own value if left out", examples=(60.0,)),
    ] = None
    linked: Annotated[
        tuple[Linked, ...], Key(list[LinkedKeys], "[[optimise.variable.linked]]: keys that follow")
    ] = ()
    step: Annotated[
        float | None,
        Key(
            Positive | None,
            "of differences, for derivatives without an exact one; a fiftieth of the range if left out",
            examples=(0.5,),
        ),
    ] = None

    @property
    def difference(self) -> float:
        """Step of differences."""
        return self.step or _STEP * (self.upper - self.lower)

    @property
    def is_current(self) -> bool:
        """Whether it is the current of coils."""
        return self.key.startswith(CURRENT)

    def settings(self, value: float) -> tuple[tuple[str, Any], ...]:
        """Every key of the device file that the variable sets.

        Parameters
        ----------
        value
            Value of the variable.

        Returns
        -------
        tuple[tuple[str, Any], ...]
            Keys with their values.
        """
        if self.is_current:
            return ()
        return settings_with(self.key, value, self.linked)


DesignFunction: TypeAlias = Callable[[Device, FieldAtCurrents], float]
"""function(device, state) -> a number."""


@dataclass(frozen=True, eq=False, repr=False)
class Number(records.Record):
    """A number that a study records, by the name of its column without the unit: "equilibrium_area", "current 5",
    "flux_density 1 z" (of the first point).

    currents: name of the set of currents; may be left out if there is only one. minus: name of another set, at which
    the same number is subtracted; the shift of an equilibrium, for example, is "equilibrium_x" at one set minus the
    same at another. of: instead of a recorded number, a scalar quantity of `state.derivative`, with exact derivatives,
    or a function of the device and the state, with derivatives by differences; name is then any text.
    """

    name: Annotated[
        str,
        Key(
            Text,
            "name of its column in the CSV of a study, without the unit",
            name="number",
            examples=("flux_density 1 z",),
        ),
    ]
    currents: Annotated[
        str, Key(Text | None, "name of the set of currents; the only one if left out", examples=("equal",))
    ] = ""
    minus: Annotated[
        str, Key(Text | None, "set of currents whose number is subtracted", examples=("x = 0.2",))
    ] = ""
    of: FieldQuantity | DesignFunction | None = None

    @property
    def label(self) -> str:
        """Name with its sets of currents.

        >>> Number("equilibrium_x", "signal", minus="equal").label
        'equilibrium_x, signal - equal'
        """
        sets = " - ".join(name for name in (self.currents, self.minus) if name)
        return f"{self.name}, {sets}" if sets else self.name

    @property
    def parts(self) -> tuple[tuple[float, "Number"], ...]:
        """The number at each of its sets of currents, with its sign."""
        first = (1.0, replace(self, minus=""))
        return (first, (-1.0, replace(self, currents=self.minus, minus=""))) if self.minus else (first,)


def number_of(given: Number | str | Callable[..., Any]) -> Number:
    """A number by its name, a quantity of the field, or any function, as a `Number`."""
    if isinstance(given, Number):
        return given
    if isinstance(given, str):
        return Number(given)
    if isinstance(given, FieldQuantity):
        return Number(type(given).__name__, of=given)
    return Number(getattr(given, "__name__", "function"), of=given)


@dataclass(frozen=True, eq=False, repr=False)
class Limit(records.Record):
    """Bounds of a number in its SI unit. number: a text stands for the number at the only set of currents."""

    number: Number | str
    lower: Annotated[
        float, Key(float | None, "lower bound, in the number's SI unit", examples=(1e-3,))
    ] = -np.inf
    upper: Annotated[float, Key(float | None, "upper bound, in the number's SI unit", examples=(3.3,))] = (
        np.inf
    )

    @property
    def asked(self) -> Number:
        """The number, for a limit in a `DesignProblem`, where it is a `Number`."""
        assert isinstance(self.number, Number)
        return self.number

    @property
    def scale(self) -> float:
        """Scale of violations: the larger magnitude of its bounds, or 1 if that is 0."""
        finite = [abs(bound) for bound in (self.lower, self.upper) if np.isfinite(bound)]
        return max(finite, default=0.0) or 1.0

    def violation(self, value: float) -> float:
        """Distance of a value from the allowed range.

        Parameters
        ----------
        value
            The value.

        Returns
        -------
        float
            The distance, in the number's unit; 0 inside the range.

        Examples
        --------
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


_NUMBER: Any = table_of(Number)


class _LimitedNumber(_NUMBER):
    """The keys of a limit's number, which are in the table of the limit."""

    def also_makes(self) -> Mapping[str, Any]:
        """The number."""
        return {"number": Number(self.number, self.currents or "", self.minus or "")}


class _Objective(Table):
    """The number to minimise or maximise."""

    minimise: _NUMBER | None = Field(default=None, description="the number that is to be smallest")
    maximise: _NUMBER | None = Field(default=None, description="or the number that is to be largest")

    def also_makes(self) -> Mapping[str, Any]:
        """The objective and its sign."""
        table: Any = self.minimise or self.maximise
        return {"objective": record_of(table), "sign": 1.0 if self.maximise is None else -1.0}


def _one_objective(keys: Any) -> None:
    there = [name for name in ("minimise", "maximise") if getattr(keys, name) is not None]
    if len(there) != 1:
        received = " and ".join(there) or "neither"
        raise broken("an optimisation has minimise or maximise", received, "give one of them")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Search(records.Record):
    """Objective, variables and limits of an optimisation: `fieldmap optimise`.

    sign: 1 to minimise the objective, -1 to maximise it. check_refinement: None for no check. besides: other numbers
    that are computed for each design.
    """

    objective: Number
    sign: float
    variables: Annotated[
        tuple[Variable, ...],
        Key(Some[table_of(Variable)], "[[optimise.variable]]: a key that may change", name="variable"),  # type: ignore[misc]
    ]
    limits: Annotated[
        tuple[Limit, ...],
        Key(
            list[table_of(Limit, bases=(_LimitedNumber,))],  # type: ignore[misc]
            "[[optimise.constraint]]: a limited number",
            name="constraint",
        ),
    ] = ()
    method: Annotated[
        str,
        Key(Method, "by derivatives (the first two), without them, or by Optuna's sampler"),
    ] = "SLSQP"
    solves: Annotated[int, Key(whole(1), "designs that are solved at most")] = 200
    tolerance: Annotated[
        float,
        Key(
            Accuracy, "relative change at which the search ends, and violation of a limit that counts as none"
        ),
    ] = 1e-4
    check_refinement: Annotated[
        float | None,
        Key(
            Annotated[float, Field(gt=1, le=10)],
            "how much finer the mesh is on which the best design is checked",
        ),
    ] = 1.4
    seed: Annotated[int, Key(whole(0), "of Optuna's sampler")] = 0

    besides: tuple[Number, ...] = ()

    def renamed(self, name: str, new: str) -> "Search":
        """The search with one set of currents renamed in all its numbers."""

        def of(given: Number | str) -> Number:
            number = number_of(given)
            return replace(number, currents=new) if number.currents == name else number

        limits = tuple(replace(one, number=of(one.number)) for one in self.limits)
        besides = tuple(map(of, self.besides))
        return replace(self, objective=of(self.objective), limits=limits, besides=besides)


OptimiseKeys = table_of(Search, name="OptimiseKeys", bases=(_Objective,), rules=(_one_objective,))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DesignProblem(Search):
    """A search with its device file (document), sets of currents and iron. Its numbers name their sets of currents."""

    title: str
    document: Document
    current_sets: tuple[CurrentSet, ...]
    iron: StudyIron
    record: Record
    coil_names: tuple[str, ...]
    body_names: tuple[str, ...]

    @property
    def numbers(self) -> tuple[Number, ...]:
        """Numbers of the objective, the limits and `besides`, in this order, each once."""
        every = [self.objective, *(limit.asked for limit in self.limits), *self.besides]
        return tuple({one.label: one for one in every}.values())

    @property
    def places(self) -> Places:
        """Every number that a study would record, by its name."""
        labels = axis_labels(self.record, self.coil_names, self.body_names)
        return number_names(self.record.groups, labels)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the variables."""
        return tuple(variable.key for variable in self.variables)

    def values(self, named: Mapping[str, float]) -> Array:
        """Values of the variables in their order.

        Parameters
        ----------
        named
            Values by key.

        Returns
        -------
        Array
            Values (k,).
        """
        return np.array([named[key] for key in self.keys], dtype=float)

    @property
    def starts(self) -> Array:
        """Start values (k,) of the variables."""
        return np.array([one.start for one in self.variables], dtype=float)

    def named(self, values: Array) -> dict[str, float]:
        """Values of the variables by key.

        Parameters
        ----------
        values
            Values (k,).

        Returns
        -------
        dict[str, float]
            Values by key.
        """
        return {key: float(value) for key, value in zip(self.keys, values, strict=True)}

    def document_at(self, values: Array) -> Document:
        """The device file with these values of the variables.

        Parameters
        ----------
        values
            Values (k,).

        Returns
        -------
        Document
            The device file.
        """
        return changed(self.document, settings_at(self.variables, self.named(values)))

    def currents_at(self, values: Array) -> tuple[CurrentSet, ...]:
        """The sets of currents with these values of the variables.

        A varied current holds in every set with given currents.

        Parameters
        ----------
        values
            Values (k,).

        Returns
        -------
        tuple[CurrentSet, ...]
            The sets.
        """
        given = self.named(values)
        varied = {one.key.removeprefix(CURRENT): given[one.key] for one in self.variables if one.is_current}
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
    # Without any current the shares are 0.
    return CurrentSet(entry.name, amperes / common if common else amperes, common, entry.carried_at)
