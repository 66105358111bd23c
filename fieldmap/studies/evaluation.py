"""One design solved: the numbers that objective and limits ask for, and their exact derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldmap.device.reader import device_of
from fieldmap.errors import FieldmapError, Infeasible, Problem
from fieldmap.iron.sensitivity.adjoint import quantity_of
from fieldmap.iron.sensitivity.quantities import Quantity as FieldQuantity
from fieldmap.records import Record
from fieldmap.studies.design_problem import DesignProblem, Number
from fieldmap.studies.number_slopes import Slopes, VariedParameters, exact_slopes
from fieldmap.studies.quantities import number_names
from fieldmap.studies.study import CurrentSet, axis_labels
from fieldmap.studies.variant_result import OperatingPoint, SolvedIron, numbers_at, reason
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Asked(Record):
    """A design to be solved: values (k,) of the variables, on a mesh of a refinement. derive: keys by which exact
    derivatives are wanted."""

    problem: DesignProblem
    values: Array
    refinement: float
    derive: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Record):
    """A design solved. values: of the variables by key; numbers: by label; slopes: exact derivatives by label and key;
    refused: keys without, and why. failure: why there are no numbers, or ""."""

    values: Mapping[str, float]
    refinement: float
    numbers: Mapping[str, float]
    slopes: Mapping[str, Mapping[str, float]]
    refused: Mapping[str, str]
    failure: str = ""

    @property
    def solved(self) -> bool:
        """Whether there are numbers."""
        return not self.failure


def evaluate(asked: Asked) -> Evaluation:
    """Solve a design. What fails is a reason in the result, never an error: the search goes on, whatever it was."""
    named = asked.problem.named(asked.values)
    try:
        numbers, slopes = _solved(asked)
    except Exception as error:
        return Evaluation(named, asked.refinement, {}, {}, {}, reason("design", error))
    return Evaluation(named, asked.refinement, numbers, slopes.by, slopes.refused)


def _solved(asked: Asked) -> tuple[dict[str, float], Slopes]:
    problem = asked.problem
    device = device_of(problem.document_at(asked.values))
    iron = SolvedIron(device, replace(problem.iron, refinement=asked.refinement), asked.refinement)
    sets = {entry.name: entry for entry in problem.currents_at(asked.values)}
    numbers: dict[str, float] = {}
    found: dict[str, Slopes] = {}
    parameters = VariedParameters(device, problem.document, problem.variables, problem.named(asked.values))
    for name, entry in sets.items():
        here = tuple(
            _at(number, name) for number in problem.numbers if name in (number.currents, number.minus)
        )
        if not here:
            continue
        point = _point(problem, device, iron, entry, here)
        numbers |= _numbers(point, here)
        if asked.derive:
            found[name] = _slopes(point, here, parameters, asked.derive)
    return (
        {number.label: _joined(number, numbers) for number in problem.numbers},
        _joined_slopes(problem.numbers, found),
    )


def _at(number: Number, name: str) -> Number:
    """The number at one of its sets of currents."""
    return replace(number, currents=name, minus="")


def _point(
    problem: DesignProblem, device: Any, iron: SolvedIron, entry: CurrentSet, here: Iterable[Number]
) -> OperatingPoint:
    names = number_names(problem.record.groups, _labels(problem))
    groups = {names[number.name][0].group for number in here if number.of is None}
    record = replace(problem.record, groups=tuple(one for one in problem.record.groups if one in groups))
    return OperatingPoint(device, iron, entry, record)


def _labels(problem: DesignProblem) -> dict[str, tuple[str, ...]]:
    return axis_labels(problem.record, problem.coil_names, problem.body_names)


def _numbers(point: OperatingPoint, here: tuple[Number, ...]) -> dict[str, float]:
    values, problems = numbers_at(point)
    names = number_names(point.record.groups, point.labels)
    found = {}
    for number in here:
        if number.of is None:
            quantity, at = names[number.name]
            if quantity.name not in values:
                raise _MissingError(" || ".join(problems))
            value: Any = np.asarray(values[quantity.name])[at] if at else values[quantity.name]
        else:
            value = _of(point, number)
        if not np.isfinite(value):
            raise Infeasible(Problem(number.label, "must be a finite number", str(value), "see the device"))
        found[number.label] = float(value)
    return found


class _MissingError(FieldmapError):
    """A number that could not be found, with the study's reasons."""

    def __init__(self, why: str) -> None:
        super().__init__()
        self.args = (why,)


def _of(point: OperatingPoint, number: Number) -> float:
    state: Any = point.iron.field.at(point.currents)
    if isinstance(number.of, FieldQuantity):
        value: Any = quantity_of(state, number.of)
    else:
        assert number.of is not None
        value = number.of(point.device, state)
    return float(np.asarray(value, dtype=float).reshape(()))


def _slopes(
    point: OperatingPoint, here: tuple[Number, ...], parameters: VariedParameters, keys: tuple[str, ...]
) -> Slopes:
    try:
        return exact_slopes(point, here, parameters, keys)
    except FieldmapError as error:
        return Slopes({}, dict.fromkeys(keys, reason("derivative", error)))


def _joined(number: Number, at_sets: Mapping[str, float]) -> float:
    value = at_sets[_at(number, number.currents).label]
    return value - at_sets[_at(number, number.minus).label] if number.minus else value


def _joined_slopes(numbers: Iterable[Number], found: Mapping[str, Slopes]) -> Slopes:
    """Derivatives of the numbers, where they are there at every set that a number is made of."""
    by: dict[str, dict[str, float]] = {}
    for number in numbers:
        sets = [number.currents, *([number.minus] if number.minus else [])]
        parts = [found[name].by.get(_at(number, name).label) for name in sets if name in found]
        if len(parts) < len(sets) or any(part is None for part in parts):
            continue
        first, *rest = [part for part in parts if part is not None]
        keys = [key for key in first if all(key in other for other in rest)]
        by[number.label] = {key: first[key] - sum(other[key] for other in rest) for key in keys}
    refused = {key: why for slopes in found.values() for key, why in slopes.refused.items()}
    return Slopes(by, refused)
