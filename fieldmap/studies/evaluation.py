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
from fieldmap.studies.design import DesignProblem, Number
from fieldmap.studies.number_slopes import Slopes, VariedParameters, exact_slopes
from fieldmap.studies.quantities import Places, number_names
from fieldmap.studies.study import axis_labels
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
    problem, device = asked.problem, device_of(asked.problem.document_at(asked.values))
    iron = SolvedIron(device, replace(problem.iron, refinement=asked.refinement), asked.refinement)
    parameters = VariedParameters(device, problem.document, problem.variables, problem.named(asked.values))
    labels = axis_labels(problem.record, problem.coil_names, problem.body_names)
    places = number_names(problem.record.groups, labels)
    numbers: dict[str, float] = {}
    slopes: dict[str, Mapping[str, float]] = {}
    refused: dict[str, str] = {}
    for entry in problem.currents_at(asked.values):
        here = [_at(one, entry.name) for one in problem.numbers if entry.name in (one.currents, one.minus)]
        if not here:
            continue
        wanted = {places[one.name][0].group for one in here if one.of is None}
        groups = tuple(group for group in problem.record.groups if group in wanted)
        point = OperatingPoint(device, iron, entry, replace(problem.record, groups=groups))
        numbers |= _numbers(point, here, places)
        if asked.derive:
            try:
                found = exact_slopes(point, here, parameters, asked.derive)
            except FieldmapError as error:
                found = Slopes({}, dict.fromkeys(asked.derive, reason("derivative", error)))
            slopes |= found.by
            refused |= found.refused
    joined = {one.label: _joined(one, numbers) for one in problem.numbers}
    return joined, Slopes(_joined_slopes(problem.numbers, slopes), refused)


def _at(number: Number, name: str) -> Number:
    """The number at one of its sets of currents."""
    return replace(number, currents=name, minus="")


def _numbers(point: OperatingPoint, here: Iterable[Number], places: Places) -> dict[str, float]:
    values, problems = numbers_at(point)
    found = {}
    for number in here:
        if number.of is None:
            quantity, at = places[number.name]
            if quantity.name not in values:
                raise _MissingError(" || ".join(problems))
            value: Any = np.asarray(values[quantity.name])[at] if at else values[quantity.name]
        else:
            state: Any = point.iron.field.at(point.currents)
            if isinstance(number.of, FieldQuantity):
                value = quantity_of(state, number.of)
            else:
                value = number.of(point.device, state)
            value = np.asarray(value, dtype=float).reshape(())
        if not np.isfinite(value):
            raise Infeasible(Problem(number.label, "must be a finite number", str(value), "see the device"))
        found[number.label] = float(value)
    return found


class _MissingError(FieldmapError):
    """A number that could not be found, with the study's reasons."""

    def __init__(self, why: str) -> None:
        super().__init__()
        self.args = (why,)


def _joined(number: Number, at_sets: Mapping[str, float]) -> float:
    value = at_sets[_at(number, number.currents).label]
    return value - at_sets[_at(number, number.minus).label] if number.minus else value


def _joined_slopes(
    numbers: Iterable[Number], at_sets: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, float]]:
    """Derivatives of the numbers, where they are there at every set that a number is made of."""
    found = {}
    for number in numbers:
        labels = [_at(number, number.currents).label]
        labels += [_at(number, number.minus).label] if number.minus else []
        if all(label in at_sets for label in labels):
            first, *rest = (at_sets[label] for label in labels)
            keys = [key for key in first if all(key in other for other in rest)]
            found[number.label] = {key: first[key] - sum(other[key] for other in rest) for key in keys}
    return found
