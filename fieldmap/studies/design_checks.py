"""What must hold of a problem of design: each mistake at its place, however the problem was written down.

Places are ("variable", number, ...), ("objective",), ("limit", number), ("besides", number) and the names of settings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from fieldmap.device.changes import changed, key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import FieldmapError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding, closest, one_of
from fieldmap.inputs.key_paths import Location, dotted, matches, value_at
from fieldmap.studies.design_problem import CURRENT, METHODS, DesignProblem, Number, Variable
from fieldmap.studies.quantities import (
    GROUPS,
    NEED_BOX,
    NEED_LIMIT,
    NEED_PAYLOAD,
    NEED_POINTS,
    number_names,
)
from fieldmap.studies.study import axis_labels
from fieldmap.typing import Array


def checked(draft: DesignProblem, device: Device) -> tuple[DesignProblem, list[Finding]]:
    """The problem with the starts of its variables filled in, and every mistake of it."""
    found = [*_of_variables(draft, device), *_of_numbers(draft, device), *_of_settings(draft)]
    if not found:
        draft = replace(draft, variables=tuple(_started(one, draft) for one in draft.variables))
        found += [*_of_pairs(draft), *_of_starts(draft)]
    return draft, found


def _of_variables(draft: DesignProblem, device: Device) -> Iterator[Finding]:
    keys = [variable.key for variable in draft.variables]
    if not keys or len(set(keys)) < len(keys):
        must_hold, remedy = "must name at least one key, each once", "list variables with their bounds"
        yield Finding(("variables",), must_hold, f"{keys}", remedy)
    for k, variable in enumerate(draft.variables):
        yield from _of_variable(("variable", k), variable, draft, device)


def _of_variable(
    place: Location, variable: Variable, draft: DesignProblem, device: Device
) -> Iterator[Finding]:
    if not (np.isfinite([variable.lower, variable.upper]).all() and variable.lower < variable.upper):
        received = f"{variable.lower:g} and {variable.upper:g}"
        must_hold = "lower must be below upper, both finite"
        yield Finding((*place, "lower"), must_hold, received, "correct the bounds")
    if variable.step is not None and not variable.step > 0:
        received = f"{variable.step:g}"
        yield Finding((*place, "step"), "step must be above 0", received, "correct it, or leave it out")
    if variable.is_current:
        name = variable.key.removeprefix(CURRENT)
        if name not in (*device.coil_names, "*"):
            must_hold = f"must be the current of one of {one_of(list(device.coil_names))}, or of *"
            yield Finding((*place, "key"), must_hold, repr(name), "use one of these")
        if all(entry.common is None for entry in draft.current_sets):
            must_hold, received = "needs currents that are given", "currents that carry the payload"
            remedy = "give the currents, A, or leave the variable out"
            yield Finding((*place, "key"), must_hold, received, remedy)
        return
    for key, _ in variable.settings(0.0):
        finding = key_finding((*place, "key"), key, draft.document)
        if finding is not None:
            yield finding
            continue
        data = draft.document.data
        values = [value_at(data, where) for where in matches(data, key)]
        if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
            yield Finding((*place, "key"), f"{key} must be a number", f"{values[0]!r}", "vary a number")


def _of_numbers(draft: DesignProblem, device: Device) -> Iterator[Finding]:
    asked: list[tuple[Location, Number | str]] = [(("objective",), draft.objective)]
    asked += [(("limit", k), limit.number) for k, limit in enumerate(draft.limits)]
    asked += [(("besides", k), number) for k, number in enumerate(draft.besides)]
    for place, number in asked:
        assert isinstance(number, Number)
        yield from _of_number(place, number, draft, device)
    for k, limit in enumerate(draft.limits):
        if not limit.lower < limit.upper or not np.isfinite([limit.lower, limit.upper]).any():
            must_hold = "a limit has a lower or an upper bound, the lower one below the upper one"
            received = f"{limit.lower:g} and {limit.upper:g}"
            yield Finding(("limit", k), must_hold, received, "give bounds")


def _of_number(place: Location, number: Number, draft: DesignProblem, device: Device) -> Iterator[Finding]:
    sets = [entry.name for entry in draft.current_sets]
    for part, name in (("currents", number.currents), ("minus", number.minus)):
        if name not in sets and (name or part == "currents"):
            must_hold = f"must name its set of currents, one of {one_of(sets)}"
            yield Finding((*place, part), must_hold, repr(name), "choose one of these")
    if number.of is not None:
        return
    at = (*place, "number")
    names = number_names(GROUPS, axis_labels(draft.record, draft.coil_names, draft.body_names))
    if number.name not in names:
        guess = closest(number.name, list(names))
        remedy = f'did you mean "{guess}"?' if guess else "choose one; numbers at points need points"
        yield Finding(at, "must be a number that studies record", repr(number.name), remedy)
        return
    group = names[number.name][0].group
    if group in NEED_PAYLOAD and (device.payload is None or device.workspace is None):
        yield Finding(at, "needs the device's [payload] and [workspace]", "none", "add them")
    if group in NEED_LIMIT and draft.record.current_limit is None:
        yield Finding(at, "needs the limit of the currents", "none", "add a [driver] with its limit")
    if group in NEED_POINTS and not len(draft.record.points):
        yield Finding(at, "needs points", "none", "give points")
    if group in NEED_BOX and draft.record.box is None:
        yield Finding(at, "needs the box", "none", "give its lower and upper corner")
    if group in ("iron", "error") and not device.bodies:
        yield Finding(at, "needs iron", "a device without bodies", "choose another number")
    if group == "error" and device.workspace is None:
        yield Finding(at, "needs the device's [workspace]", "none", "add it, or choose another number")
    if number.name == "reachable_share" and draft.iron.saturating:
        yield Finding(at, "superposes coils: linear iron only", "saturating iron", "choose another number")


def _of_settings(draft: DesignProblem) -> Iterator[Finding]:
    if draft.method not in METHODS:
        must_hold = f"must be one of {one_of(list(METHODS))}"
        yield Finding(("method",), must_hold, repr(draft.method), "choose one of these")
    if draft.solves < 1:
        yield Finding(("solves",), "must be at least 1", f"{draft.solves}", "allow more")
    if not 0 < draft.tolerance < 1:
        yield Finding(("tolerance",), "must lie between 0 and 1", f"{draft.tolerance:g}", "correct it")
    if draft.check_refinement is not None and not draft.check_refinement > 1:
        received = f"{draft.check_refinement:g}"
        yield Finding(("check_refinement",), "must be above 1", received, "write 1.4")
    if not draft.iron.refinement > 0:
        yield Finding(("refinement",), "must be above 0", f"{draft.iron.refinement:g}", "write 1")


def _started(variable: Variable, draft: DesignProblem) -> Variable:
    """The variable with the device's own value as its start, where none is given."""
    if variable.start is not None:
        return variable
    if variable.is_current:
        name = variable.key.removeprefix(CURRENT)
        entry = next(one for one in draft.current_sets if one.common is not None)
        place = 0 if name == "*" else draft.coil_names.index(name)
        return replace(variable, start=float((entry.common or 0.0) * entry.shares[place]))
    data = draft.document.data
    values = [value_at(data, place) for place in matches(data, variable.key)]
    return replace(variable, start=float(values[0]))


def _of_pairs(draft: DesignProblem) -> Iterator[Finding]:
    """Keys and currents that one variable sets and that follow another one as well, which would then do nothing
    there."""
    of_all = f"{CURRENT}*"
    for k, key in enumerate(draft.keys):
        if of_all in draft.keys and key != of_all and draft.variables[k].is_current:
            remedy, received = "leave one of them out, or name every coil", f"{key} and {of_all}"
            yield Finding(("variable", k, "key"), "no current may follow two variables", received, remedy)
    data = draft.document.data
    followed = [_followers(variable, draft.document) for variable in draft.variables]
    told: set[frozenset[str]] = set()
    for k, variable in enumerate(draft.variables):
        own = {place for key, _ in variable.settings(0.0) for place in matches(data, key)}
        for other, places in zip(draft.variables, followed, strict=True):
            pair = frozenset((variable.key, other.key))
            if other is variable or pair in told or not own & places:
                continue
            told.add(pair)
            key = dotted(data, min(own & places, key=str))
            remedy = "leave one of them out, or let both act by a parameter of the device file"
            received = f"{key} follows {other.key} and is set with {variable.key}"
            yield Finding(("variable", k, "key"), "no key may follow two variables", received, remedy)


def _followers(variable: Variable, document: Document) -> set[Location]:
    """Every place of the device file whose value follows a variable."""
    start = variable.start or 0.0
    sides = [
        changed(document, variable.settings(start + side * variable.difference)).data for side in (0.0, 0.5)
    ]
    return set(_differing(sides[0], sides[1], ()))


def _differing(one: Any, other: Any, place: Location) -> Iterator[Location]:
    steps: Iterable[Any] = ()
    if isinstance(one, dict) and isinstance(other, dict):
        steps = one.keys() & other.keys()
    elif isinstance(one, list) and isinstance(other, list):
        steps = range(min(len(one), len(other)))
    elif one != other:
        yield place
    for step in steps:
        yield from _differing(one[step], other[step], (*place, step))


def _of_starts(draft: DesignProblem) -> Iterator[Finding]:
    """Starts outside the bounds, and what the device's schema refuses at the start or at a bound."""
    for k, variable in enumerate(draft.variables):
        start = variable.start
        if start is None or not variable.lower <= start <= variable.upper:
            must_hold = f"start must lie within {variable.lower:g} and {variable.upper:g}"
            yield Finding(("variable", k, "start"), must_hold, f"{start}", "give a start, or other bounds")
    told: set[str] = set()
    for place, where, values in _places(draft):
        try:
            device_of(draft.document_at(values))
        except FieldmapError as error:
            for problem in error.problems:
                key = problem.where.split(": ", 1)[-1]
                if key not in told:
                    told.add(key)
                    must_hold = f"{key} of the device {problem.must_hold}"
                    yield Finding(place, must_hold, f"{problem.received} {where}", problem.remedy)


def _places(draft: DesignProblem) -> Iterator[tuple[Location, str, Array]]:
    """The start, and the start with one variable at a bound; where each is told, and in words."""
    begin = np.array([one.start for one in draft.variables], dtype=float)
    yield ("variable", 0, "start"), "at the start", begin
    for k, variable in enumerate(draft.variables):
        for name, bound in (("lower", variable.lower), ("upper", variable.upper)):
            at = begin.copy()
            at[k] = bound
            yield ("variable", k, name), f"with {variable.key} at its {name} bound", at
