"""A problem of design from the arguments of `fm.optimise`: units, names and bounds checked, all mistakes at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.changes import key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import TEXT, device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, FieldmapError, InputError, Problem
from fieldmap.inputs.document import Document, parsed
from fieldmap.inputs.findings import closest, one_of
from fieldmap.inputs.key_paths import matches, value_at
from fieldmap.iron.sensitivity.quantities import Quantity as FieldQuantity
from fieldmap.studies.design_problem import CURRENT, METHODS, Carrying, DesignProblem, Limit, Number, Variable
from fieldmap.studies.quantities import (
    GROUPS,
    NEED_BOX,
    NEED_LIMIT,
    NEED_PAYLOAD,
    NEED_POINTS,
    number_names,
)
from fieldmap.studies.study import CurrentSet, IronModel, Record, axis_labels
from fieldmap.typing import PathLike

WHERE = "optimise"


def design_problem(
    device: PathLike | Device,
    variables: Sequence[Variable],
    objective: Number | str | Callable[..., Any],
    constraints: Sequence[Limit],
    *,
    currents: Any,
    maximise: bool,
    saturating: bool | None,
    refinement: float,
    points: ArrayLike | None,
    box: tuple[ArrayLike, ArrayLike] | None,
    force_share: float,
    method: str,
    solves: int,
    tolerance: float,
    check_refinement: float | None,
    seed: int,
) -> DesignProblem:
    """The arguments of `optimise` as a problem. Raises InputError with one Problem for every mistake."""
    document = _document(device)
    made = device_of(document)
    problems: list[Problem] = []
    sets = _current_sets(currents, made, problems)
    used = {body.material for body in made.bodies}
    curved = any(made.materials[name].saturates for name in used)
    corners = None if box is None else (np.asarray(box[0], dtype=float), np.asarray(box[1], dtype=float))
    limit = made.driver.current_limit if made.driver is not None else None
    where = np.asarray([] if points is None else points, dtype=float).reshape(-1, 3)
    draft = DesignProblem(
        title=f"Optimum of {made.name}",
        document=document,
        variables=tuple(variables),
        objective=_number(objective, sets),
        sign=-1.0 if maximise else 1.0,
        limits=tuple(replace(one, number=_number(one.number, sets)) for one in constraints),
        current_sets=sets,
        iron=IronModel(curved if saturating is None else saturating, refinement=refinement),
        record=Record(GROUPS, where, force_share, limit, corners),
        coil_names=made.coil_names,
        body_names=tuple(body.name for body in made.bodies),
        method=method,
        solves=solves,
        tolerance=tolerance,
        check_refinement=check_refinement,
        seed=seed,
    )
    return checked(draft, made, problems)


def checked(draft: DesignProblem, device: Device, problems: Sequence[Problem] = ()) -> DesignProblem:
    """The problem with the starts of its variables filled in. Raises InputError with one Problem for every mistake."""
    found = [*problems, *_of_variables(draft, device), *_of_numbers(draft, device), *_of_settings(draft)]
    if not found:
        draft = replace(draft, variables=tuple(_started(one, draft) for one in draft.variables))
        found += _of_starts(draft)
    if found:
        raise InputError(*found)
    return draft


def _document(device: PathLike | Device) -> Document:
    if isinstance(device, Device):
        path = device.source or Path(TEXT)
        return DEVICE.prepared(parsed(path, device.text or device.to_toml(), DeviceFileError))
    if isinstance(device, str) and "\n" in device:
        return DEVICE.prepared(parsed(Path(TEXT), device, DeviceFileError))
    return DEVICE.load(DEVICE.find(device))


def _current_sets(given: Any, device: Device, problems: list[Problem]) -> tuple[CurrentSet, ...]:
    named = given if isinstance(given, Mapping) else {"": 1.0 if given is None else given}
    sets = []
    for name, one in named.items():
        carrying = isinstance(one, Carrying)
        amperes = (1.0 if one.shares is None else one.shares) if isinstance(one, Carrying) else one
        try:
            shares = np.array(np.broadcast_to(np.asarray(amperes, dtype=float), len(device.coils)))
        except ValueError:
            shares = np.zeros(len(device.coils))
        common = float(np.abs(shares).mean()) if len(shares) else 0.0
        if not common or not np.isfinite(common):
            must_hold = f"one number for all coils, or one for each of {len(device.coils)}, not all 0"
            remedy = "write amperes, or Carrying(position)"
            problems.append(Problem(f"{WHERE}(currents)", must_hold, f"{amperes}"[:80], remedy))
            shares, common = np.ones(len(device.coils)), 1.0
        if carrying and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            remedy = "add them, or write amperes"
            problems.append(Problem(f"{WHERE}(currents)", must_hold, "none", remedy))
        place = np.asarray(one.position, dtype=float) if isinstance(one, Carrying) else None
        sets.append(CurrentSet(str(name), shares / common, None if carrying else common, place))
    return tuple(sets)


def _number(given: Any, sets: Sequence[CurrentSet]) -> Number:
    """A number with its set of currents, where there is one only."""
    if isinstance(given, Number):
        number = given
    elif isinstance(given, str):
        number = Number(given)
    elif isinstance(given, FieldQuantity):
        number = Number(type(given).__name__, of=given)
    else:
        number = Number(getattr(given, "__name__", "function"), of=given)
    if not number.currents and len(sets) == 1:
        number = replace(number, currents=sets[0].name)
    return number


def _of_variables(draft: DesignProblem, device: Device) -> Iterator[Problem]:
    keys = [variable.key for variable in draft.variables]
    if not keys or len(set(keys)) < len(keys):
        must_hold, remedy = "must name at least one key, each once", "list Variable(key, lower, upper)"
        yield Problem(f"{WHERE}(variables)", must_hold, f"{keys}", remedy)
    for variable in draft.variables:
        yield from _of_variable(variable, draft, device)


def _of_variable(variable: Variable, draft: DesignProblem, device: Device) -> Iterator[Problem]:
    where = f"{WHERE}, {variable.key}"
    if not (np.isfinite([variable.lower, variable.upper]).all() and variable.lower < variable.upper):
        received = f"{variable.lower:g} and {variable.upper:g}"
        yield Problem(where, "lower must be below upper, both finite", received, "correct the bounds")
    if variable.step is not None and not variable.step > 0:
        yield Problem(where, "step must be above 0", f"{variable.step:g}", "correct it, or leave it out")
    if variable.is_current:
        name = variable.key.removeprefix(CURRENT)
        if name not in (*device.coil_names, "*"):
            must_hold = f"must be the current of one of {one_of(list(device.coil_names))}, or of *"
            yield Problem(where, must_hold, repr(name), "use one of these")
        if all(entry.common is None for entry in draft.current_sets):
            remedy = "give the currents, A, or leave the variable out"
            yield Problem(where, "needs currents that are given", "currents that carry the payload", remedy)
        return
    for key, _ in variable.settings(0.0):
        finding = key_finding((key,), key, draft.document)
        if finding is not None:
            yield Problem(f"{WHERE}, {key}", finding.must_hold, finding.received, finding.remedy)


def _of_numbers(draft: DesignProblem, device: Device) -> Iterator[Problem]:
    labels = axis_labels(draft.record, draft.coil_names, draft.body_names)
    names = number_names(GROUPS, labels)
    sets = [entry.name for entry in draft.current_sets]
    for number in draft.numbers:
        where = f"{WHERE}, {number.label}"
        for name in (number.currents, number.minus):
            if name not in sets and (name or not number.currents):
                must_hold = f"must name its set of currents, one of {one_of(sets)}"
                yield Problem(where, must_hold, repr(name), "write Number(name, currents=...)")
        if number.of is not None:
            continue
        if number.name not in names:
            guess = closest(number.name, list(names))
            remedy = f'did you mean "{guess}"?' if guess else "choose one; numbers at points need points"
            yield Problem(where, "must be a number that studies record", repr(number.name), remedy)
            continue
        group = names[number.name][0].group
        if group in NEED_PAYLOAD and (device.payload is None or device.workspace is None):
            yield Problem(where, "needs the device's [payload] and [workspace]", "none", "add them")
        if group in NEED_LIMIT and draft.record.current_limit is None:
            yield Problem(where, "needs the limit of the currents", "none", "add a [driver]")
        if group in NEED_POINTS and not len(draft.record.points):
            yield Problem(where, "needs points", "none", "give points")
        if group in NEED_BOX and draft.record.box is None:
            yield Problem(where, "needs the box", "none", "give its lower and upper corner")
        if group in ("iron", "error") and not device.bodies:
            yield Problem(where, "needs iron", "a device without bodies", "choose another number")
    for limit in draft.limits:
        if not limit.lower < limit.upper or not np.isfinite([limit.lower, limit.upper]).any():
            label = limit.number.label if isinstance(limit.number, Number) else limit.number
            must_hold = "a limit has a lower or an upper bound, the lower one below the upper one"
            received = f"{limit.lower:g} and {limit.upper:g}"
            yield Problem(f"{WHERE}, {label}", must_hold, received, "give bounds")


def _of_settings(draft: DesignProblem) -> Iterator[Problem]:
    if draft.method not in METHODS:
        yield Problem(
            f"{WHERE}(method)", f"must be one of {one_of(list(METHODS))}", repr(draft.method), "choose one"
        )
    if draft.solves < 1:
        yield Problem(f"{WHERE}(solves)", "must be at least 1", f"{draft.solves}", "allow more")
    if not 0 < draft.tolerance < 1:
        yield Problem(f"{WHERE}(tolerance)", "must lie between 0 and 1", f"{draft.tolerance:g}", "correct it")
    if draft.check_refinement is not None and not draft.check_refinement > 1:
        received = f"{draft.check_refinement:g}"
        yield Problem(f"{WHERE}(check_refinement)", "must be above 1, or None", received, "write 1.4")
    if not draft.iron.refinement > 0:
        yield Problem(f"{WHERE}(refinement)", "must be above 0", f"{draft.iron.refinement:g}", "write 1")


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


def _of_starts(draft: DesignProblem) -> Iterator[Problem]:
    """Starts outside the bounds, and what the device's schema refuses at the start or at a bound."""
    for variable in draft.variables:
        start = variable.start
        if start is None or not variable.lower <= start <= variable.upper:
            must_hold = f"start must lie within {variable.lower:g} and {variable.upper:g}"
            yield Problem(f"{WHERE}, {variable.key}", must_hold, f"{start}", "give a start, or other bounds")
    begin = np.array([one.start for one in draft.variables], dtype=float)
    places = [("at the start", begin)]
    for k, variable in enumerate(draft.variables):
        for name, bound in (("lower", variable.lower), ("upper", variable.upper)):
            at = begin.copy()
            at[k] = bound
            places.append((f"with {variable.key} at its {name} bound", at))
    told = set()
    for where, values in places:
        try:
            device_of(draft.document_at(values))
        except FieldmapError as error:
            for problem in error.problems:
                if problem.where not in told:
                    told.add(problem.where)
                    received = f"{problem.received} {where}"
                    yield Problem(problem.where, problem.must_hold, received, problem.remedy)
