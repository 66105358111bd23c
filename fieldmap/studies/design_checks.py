"""Checks of design problems from a study file or from Python arguments; and design problems made from the arguments of
`fm.optimise` and `analyse_tolerances`, with each mistake reported at its argument."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.changes import changed, key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import TEXT, device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, InputError, Problem
from fieldmap.inputs.document import Document, parsed
from fieldmap.inputs.findings import Finding, meant, one_of
from fieldmap.inputs.key_paths import Location, dotted, matches, value_at
from fieldmap.studies.design import CURRENT, Carrying, DesignProblem, Method, Number, Search, Variable
from fieldmap.studies.quantities import GROUPS
from fieldmap.studies.study import CurrentSet, Record, StudyIron, current_set, lacking, refused, saturates
from fieldmap.typing import Array, PathLike

# Locations of mistakes, as in a study file.
_VARIABLE: Location = ("optimise", "variable")
_LIMIT: Location = ("optimise", "constraint")


def checked(draft: DesignProblem, device: Device) -> tuple[DesignProblem, list[Finding]]:
    """The problem with the starts of its variables filled in, and all its mistakes."""
    found = [*_of_variables(draft, device), *_of_numbers(draft, device), *_of_settings(draft)]
    if not found:
        draft = replace(draft, variables=tuple(_started(one, draft) for one in draft.variables))
        found += [*_of_pairs(draft), *_of_starts(draft)]
    return draft, found


def _of_variables(draft: DesignProblem, device: Device) -> Iterator[Finding]:
    if not draft.keys or len(set(draft.keys)) < len(draft.keys):
        must_hold, remedy = "must name at least one key, each once", "list variables with their bounds"
        yield Finding(_VARIABLE, must_hold, f"{list(draft.keys)}", remedy)
    for k, variable in enumerate(draft.variables):
        place = (*_VARIABLE, k)
        if not (np.isfinite([variable.lower, variable.upper]).all() and variable.lower < variable.upper):
            received = f"{variable.lower:g} and {variable.upper:g}"
            must_hold = "lower must be below upper, both finite"
            yield Finding((*place, "lower"), must_hold, received, "correct the bounds")
        if variable.step is not None and not variable.step > 0:
            received, remedy = f"{variable.step:g}", "correct it, or leave it out"
            yield Finding((*place, "step"), "step must be above 0", received, remedy)
        what = _wrong_current if variable.is_current else _wrong_keys
        for told in what(variable, draft, device):
            yield replace(told, location=(*place, "key"))


def _wrong_current(variable: Variable, draft: DesignProblem, device: Device) -> Iterator[Finding]:
    name = variable.key.removeprefix(CURRENT)
    if name not in (*device.coil_names, "*"):
        must_hold = f"must be the current of one of {one_of(list(device.coil_names))}, or of *"
        yield Finding((), must_hold, repr(name), "use one of these")
    if all(entry.common is None for entry in draft.current_sets):
        must_hold, received = "needs currents that are given", "currents that carry the payload"
        yield Finding((), must_hold, received, "give the currents, A, or leave the variable out")


def _wrong_keys(variable: Variable, draft: DesignProblem, device: Device) -> Iterator[Finding]:
    data = draft.document.data
    for key, _ in variable.settings(0.0):
        finding = key_finding((), key, draft.document)
        values = [value_at(data, where) for where in matches(data, key)]
        if finding is not None:
            yield finding
        elif not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
            yield Finding((), f"{key} must be a number", f"{values[0]!r}", "vary a number")


def _of_numbers(draft: DesignProblem, device: Device) -> Iterator[Finding]:
    asked: list[tuple[Location, Number]] = [
        (("optimise", "minimise" if draft.sign > 0 else "maximise"), draft.objective)
    ]
    asked += [((*_LIMIT, k), limit.asked) for k, limit in enumerate(draft.limits)]
    asked += [(("besides", k), number) for k, number in enumerate(draft.besides)]
    for place, number in asked:
        yield from _of_number(place, number, draft, device)
    for k, limit in enumerate(draft.limits):
        if not limit.lower < limit.upper or not np.isfinite([limit.lower, limit.upper]).any():
            must_hold = "a limit has a lower or an upper bound, the lower one below the upper one"
            received = f"{limit.lower:g} and {limit.upper:g}"
            yield Finding((*_LIMIT, k), must_hold, received, "give bounds")


def _of_number(place: Location, number: Number, draft: DesignProblem, device: Device) -> Iterator[Finding]:
    sets = [entry.name for entry in draft.current_sets]
    for part, name in (("currents", number.currents), ("minus", number.minus)):
        if name not in sets and (name or part == "currents"):
            must_hold = f"must name its set of currents, one of {one_of(sets)}"
            yield Finding((*place, part), must_hold, repr(name), "choose one of these")
    if number.of is not None:
        return
    names = draft.places
    if number.name not in names:
        remedy = meant(number.name, list(names), "choose one; numbers at points need points")
        received = repr(number.name)
        yield Finding((*place, "number"), "must be a number that studies record", received, remedy)
        return
    for groups, must_hold, received, remedy in lacking(device, draft.record, draft.iron.saturating):
        if names[number.name][0].group in groups:
            yield Finding((*place, "number"), must_hold, received, f"{remedy}, or choose another number")


def _of_settings(draft: DesignProblem) -> Iterator[Finding]:
    check, methods = draft.check_refinement, get_args(Method)
    settings = (
        ("method", draft.method in methods, f"one of {one_of(list(methods))}", "choose one of these"),
        ("solves", draft.solves >= 1, "at least 1", "allow more"),
        ("tolerance", 0 < draft.tolerance < 1, "between 0 and 1", "correct it"),
        ("check_refinement", check is None or check > 1, "above 1", "write 1.4"),
        ("refinement", draft.iron.refinement > 0, "above 0", "write 1"),
    )
    for name, good, must, remedy in settings:
        if not good:
            table, of = ("iron", draft.iron) if name == "refinement" else ("optimise", draft)
            yield Finding((table, name), f"must be {must}", f"{getattr(of, name)!r}", remedy)


def given_current(key: str, sets: Sequence[CurrentSet], coil_names: Sequence[str]) -> float:
    """Current of a coil, A, in the first set with given currents; 0 if there is none."""
    name = key.removeprefix(CURRENT)
    for entry in sets:
        if entry.common is not None and name in (*coil_names, "*"):
            return float(entry.common * entry.shares[0 if name == "*" else coil_names.index(name)])
    return 0.0


def _started(variable: Variable, draft: DesignProblem) -> Variable:
    """The variable with the device's own value as its start, unless a start is given."""
    if variable.start is not None:
        return variable
    if variable.is_current:
        own = given_current(variable.key, draft.current_sets, draft.coil_names)
        return replace(variable, start=own)
    data = draft.document.data
    values = [value_at(data, place) for place in matches(data, variable.key)]
    return replace(variable, start=float(values[0]))


def _of_pairs(draft: DesignProblem) -> Iterator[Finding]:
    """Findings for keys and currents that depend on two variables, as one of the two would have no effect."""
    of_all = f"{CURRENT}*"
    for k, key in enumerate(draft.keys):
        if of_all in draft.keys and key != of_all and draft.variables[k].is_current:
            remedy, received = "leave one of them out, or name every coil", f"{key} and {of_all}"
            yield Finding((*_VARIABLE, k, "key"), "no current may follow two variables", received, remedy)
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
            yield Finding((*_VARIABLE, k, "key"), "no key may follow two variables", received, remedy)


def _followers(variable: Variable, document: Document) -> set[Location]:
    """Every location of the device file with a value that depends on a variable."""
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
    """Starts outside the bounds, and values that the device's schema refuses at the start or at a bound."""
    for k, variable in enumerate(draft.variables):
        start = variable.start
        if start is None or not variable.lower <= start <= variable.upper:
            must_hold = f"start must lie within {variable.lower:g} and {variable.upper:g}"
            yield Finding((*_VARIABLE, k, "start"), must_hold, f"{start}", "give a start, or other bounds")
    told: set[str] = set()
    for place, where, values in _places(draft):
        for key, problem in refused(draft.document_at(values)):
            if key not in told:
                told.add(key)
                must_hold = f"{key} of the device {problem.must_hold}"
                yield Finding(place, must_hold, f"{problem.received} {where}", problem.remedy)


def _places(draft: DesignProblem) -> Iterator[tuple[Location, str, Array]]:
    """The start, and the start with one variable at a bound: location of findings, words, and values (k,)."""
    begin = draft.starts
    yield (*_VARIABLE, 0, "start"), "at the start", begin
    for k, variable in enumerate(draft.variables):
        for name, bound in (("lower", variable.lower), ("upper", variable.upper)):
            at = begin.copy()
            at[k] = bound
            yield (*_VARIABLE, k, name), f"with {variable.key} at its {name} bound", at


def design_problem(
    caller: str,
    search: Search,
    device: PathLike | Device,
    currents: Any,
    saturating: bool | None,
    refinement: float,
    points: ArrayLike | None,
    box: tuple[ArrayLike, ArrayLike] | None,
    force_share: float,
) -> DesignProblem:
    """The design problem of a search, a device and currents, for `optimise` or another caller. Raises InputError with
    one Problem for every mistake."""
    document = device_document(device)
    made = device_of(document)
    problems: list[Problem] = []
    sets = current_sets(currents, made, f"{caller}(currents)", problems)
    curved = saturates(made) if saturating is None else saturating
    corners = None if box is None else (np.asarray(box[0], dtype=float), np.asarray(box[1], dtype=float))
    limit = made.driver.current_limit if made.driver is not None else None
    where = np.asarray([] if points is None else points, dtype=float).reshape(-1, 3)

    draft = DesignProblem(
        **vars(search.renamed("", sets[0].name if len(sets) == 1 else "")),
        title=f"Optimum of {made.name}",
        document=document,
        current_sets=sets,
        iron=StudyIron("saturating" if curved else "linear", refinement=refinement),
        record=Record(GROUPS, where, force_share, limit, corners),
        coil_names=made.coil_names,
        body_names=tuple(body.name for body in made.bodies),
    )
    done, findings = checked(draft, made)
    problems += [_told(finding, draft, caller) for finding in findings]
    if problems:
        raise InputError(*problems)
    return done


def _told(finding: Finding, draft: DesignProblem, caller: str) -> Problem:
    """A mistake, reported at its argument."""
    where = f"{caller}({finding.location[-1]})"
    match finding.location:
        case ("optimise", "variable"):
            where = f"{caller}(variables)"
        case ("optimise", "variable", int(k), *_):
            where = f"{caller}, {draft.variables[k].key}"
        case ("optimise", "minimise" | "maximise", *_):
            where = f"{caller}, {draft.objective.label}"
        case ("optimise", "constraint", int(k), *_):
            where = f"{caller}, {draft.limits[k].asked.label}"
        case ("besides", int(k), *_):
            where = f"{caller}, {draft.besides[k].label}"
    return Problem(where, finding.must_hold, finding.received, finding.remedy)


def device_document(device: PathLike | Device) -> Document:
    """The device file of a path, a name, a text of several lines, or a device made in Python."""
    if isinstance(device, Device):
        path = device.source or Path(TEXT)
        return DEVICE.prepared(parsed(path, device.text or device.to_toml(), DeviceFileError))
    if isinstance(device, str) and "\n" in device:
        return DEVICE.prepared(parsed(Path(TEXT), device, DeviceFileError))
    return DEVICE.load(DEVICE.find(device))


def current_sets(given: Any, device: Device, where: str, problems: list[Problem]) -> tuple[CurrentSet, ...]:
    """The argument `currents` of `optimise` as sets of currents. Mistakes are added to `problems`, at `where`."""
    named = given if isinstance(given, Mapping) else {"": 1.0 if given is None else given}
    coils, sets = len(device.coils), []
    for name, one in named.items():
        place = np.asarray(one.position, dtype=float) if isinstance(one, Carrying) else None
        amperes = (1.0 if one.shares is None else one.shares) if isinstance(one, Carrying) else one
        fits = np.shape(amperes) in ((), (1,), (coils,)) and np.any(amperes) and np.isfinite(amperes).all()
        if not fits:
            must_hold = f"one number for all coils, or one for each of {coils}, not all 0"
            remedy = "write amperes, or Carrying(position)"
            problems.append(Problem(where, must_hold, f"{amperes}"[:80], remedy))
            amperes = 1.0
        if place is not None and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            problems.append(Problem(where, must_hold, "none", "add them, or write amperes"))
        sets.append(current_set(str(name), amperes, coils, place))
    return tuple(sets)
