"""A problem of design: what of a device may change, what is to be smallest, and what must hold.

A study file with [optimise] and the arguments of `fm.optimise` both become one, and are checked by the same rules, each
mistake told at its place. `fieldmap.studies.optimisation` solves it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import records
from fieldmap.device.changes import changed, key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import TEXT, device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, InputError, Problem, StudyError
from fieldmap.field import FieldAtCurrents
from fieldmap.inputs.document import Document, parsed
from fieldmap.inputs.findings import Finding, closest, one_of
from fieldmap.inputs.key_paths import Location, dotted, matches, value_at
from fieldmap.iron.sensitivity.quantities import Quantity as FieldQuantity
from fieldmap.studies.quantities import GROUPS, number_names
from fieldmap.studies.reading import device_findings, named_device, read_parts, refused
from fieldmap.studies.schema import STUDY, NumberKeys, StudyFile, VariableKeys
from fieldmap.studies.study import (
    CurrentSet,
    IronModel,
    Record,
    axis_labels,
    current_set,
    lacking,
    settings_with,
)
from fieldmap.typing import Array, PathLike

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

    def settings(self, value: float) -> tuple[tuple[str, Any], ...]:
        """Every key of the device file that it sets, with the value there."""
        if self.is_current:
            return ()
        return settings_with(self.key, value, self.linked)


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

    def values(self, named: Mapping[str, float]) -> Array:
        """Values (k,) of the variables, which stand by key."""
        return np.array([named[key] for key in self.keys], dtype=float)

    @property
    def starts(self) -> Array:
        """Values (k,) of the variables where the search begins."""
        return np.array([one.start for one in self.variables], dtype=float)

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


def read_design_problem(path_or_name: PathLike) -> DesignProblem:
    """Read and check a study file with [optimise]: its path, or the name of a shipped one.

    The format is described in docs/optimise.md. Raises StudyError with one Problem for every error of the file: file,
    line and key path; what must hold; what was received; the remedy.
    """
    path = STUDY.find(path_or_name)
    study_file = STUDY.load(path)
    contents = STUDY.contents(study_file)
    keys = contents.optimise
    if keys is None:
        must_hold, remedy = "must have a table [optimise]", "`fieldmap study` takes a study of variants"
        raise StudyError(Problem(str(path), must_hold, "a study of variants", remedy))
    document, recipe = named_device(contents, study_file)
    device = device_of(document)
    sets, iron, record = read_parts(contents, device, recipe)
    if len(sets) == 1:  # it needs no name
        sets = (replace(sets[0], name=""),)
    sign, objective = (1.0, keys.minimise) if keys.maximise is None else (-1.0, keys.maximise)
    assert objective is not None  # the schema's check
    draft = DesignProblem(
        title=contents.title,
        document=document,
        variables=tuple(_variable(entry) for entry in keys.variable),
        objective=_number(objective, contents),
        sign=sign,
        limits=tuple(
            Limit(
                _number(entry, contents),
                -np.inf if entry.lower is None else entry.lower,
                np.inf if entry.upper is None else entry.upper,
            )
            for entry in keys.constraint
        ),
        current_sets=sets,
        iron=iron,
        record=replace(record, groups=GROUPS),
        coil_names=device.coil_names,
        body_names=tuple(body.name for body in device.bodies),
        method=keys.method,
        solves=keys.solves,
        tolerance=keys.tolerance,
        check_refinement=keys.check_refinement,
        seed=keys.seed,
    )
    findings = [*device_findings(contents, device, iron, record), *_of_tables(contents)]
    done, of_problem = _checked(draft, device)
    findings += of_problem
    if findings:
        raise StudyError(*study_file.problems(findings))
    return done


def _variable(entry: VariableKeys) -> Variable:
    linked = tuple(Linked(tuple(one.keys), one.factor, one.offset) for one in entry.linked)
    return Variable(entry.key, entry.lower, entry.upper, entry.start, linked, entry.step)


def _number(entry: NumberKeys, contents: StudyFile) -> Number:
    sets = [one.name for one in contents.currents]
    named = "" if entry.currents in sets and len(sets) == 1 else entry.currents or ""
    return Number(entry.number, named, entry.minus or "")


def _of_tables(contents: StudyFile) -> list[Finding]:
    found = []
    if contents.iron is not None and contents.iron.accuracy is not None:
        must_hold = "designs are compared on meshes of one refinement"
        remedy = "write iron.refinement; the best design is checked on a finer mesh"
        found.append(Finding(("iron", "accuracy"), must_hold, f"{contents.iron.accuracy:g}", remedy))
    if contents.record.quantities is not None:
        must_hold = "an optimisation takes the numbers that it needs"
        found.append(Finding(("record", "quantities"), must_hold, "a list", "leave it out"))
    return found


def design_problem(
    device: PathLike | Device,
    variables: Sequence[Variable],
    objective: Number | str | Callable[..., Any],
    constraints: Sequence[Limit] = (),
    *,
    currents: Any,
    saturating: bool | None,
    refinement: float,
    points: ArrayLike | None,
    box: tuple[ArrayLike, ArrayLike] | None,
    force_share: float,
    solves: int,
    maximise: bool = False,
    method: str = "SLSQP",
    tolerance: float = 1e-4,
    check_refinement: float | None = None,
    seed: int = 0,
    besides: Sequence[Number | str | Callable[..., Any]] = (),
    caller: str = "optimise",
) -> DesignProblem:
    """The arguments of `optimise`, or of another caller, as a problem. Raises InputError with one Problem for every
    mistake."""
    document = device_document(device)
    made = device_of(document)
    problems: list[Problem] = []
    sets = current_sets(currents, made, f"{caller}(currents)", problems)
    used = {body.material for body in made.bodies}
    curved = any(made.materials[name].saturates for name in used)
    corners = None if box is None else (np.asarray(box[0], dtype=float), np.asarray(box[1], dtype=float))
    limit = made.driver.current_limit if made.driver is not None else None
    where = np.asarray([] if points is None else points, dtype=float).reshape(-1, 3)
    draft = DesignProblem(
        title=f"Optimum of {made.name}",
        document=document,
        variables=tuple(variables),
        objective=_number_of(objective, sets),
        sign=-1.0 if maximise else 1.0,
        limits=tuple(replace(one, number=_number_of(one.number, sets)) for one in constraints),
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
        besides=tuple(_number_of(one, sets) for one in besides),
    )
    done, findings = _checked(draft, made)
    problems += [_told(finding, draft, caller) for finding in findings]
    if problems:
        raise InputError(*problems)
    return done


def _told(finding: Finding, draft: DesignProblem, caller: str) -> Problem:
    """A mistake at the argument that it is in."""
    where = f"{caller}({finding.location[-1]})"
    match finding.location:
        case ("optimise", "variable"):
            where = f"{caller}(variables)"
        case ("optimise", "variable", int(k), *_):
            where = f"{caller}, {draft.variables[k].key}"
        case ("optimise", "minimise" | "maximise", *_):
            where = f"{caller}, {draft.objective.label}"
        case ("optimise", "constraint", int(k), *_):
            number = draft.limits[k].number
            where = f"{caller}, {number.label if isinstance(number, Number) else number}"
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
    """The argument `currents` as sets of currents, as `optimise` describes it. where: what its mistakes, which go to
    `problems`, are told of."""
    named = given if isinstance(given, Mapping) else {"": 1.0 if given is None else given}
    coils, sets = len(device.coils), []
    for name, one in named.items():
        place = np.asarray(one.position, dtype=float) if isinstance(one, Carrying) else None
        amperes = (1.0 if one.shares is None else one.shares) if isinstance(one, Carrying) else one
        if (
            np.shape(amperes) not in ((), (1,), (coils,))
            or not np.any(amperes)
            or not np.isfinite(amperes).all()
        ):
            must_hold = f"one number for all coils, or one for each of {coils}, not all 0"
            remedy = "write amperes, or Carrying(position)"
            problems.append(Problem(where, must_hold, f"{amperes}"[:80], remedy))
            amperes = 1.0
        if place is not None and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            problems.append(Problem(where, must_hold, "none", "add them, or write amperes"))
        sets.append(current_set(str(name), amperes, coils, place))
    return tuple(sets)


def _number_of(given: Any, sets: Sequence[CurrentSet]) -> Number:
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


# Places of mistakes, as a file has them.
_VARIABLE: Location = ("optimise", "variable")
_LIMIT: Location = ("optimise", "constraint")


def _checked(draft: DesignProblem, device: Device) -> tuple[DesignProblem, list[Finding]]:
    """The problem with the starts of its variables filled in, and every mistake of it."""
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
    asked: list[tuple[Location, Number | str]] = [(_objective_place(draft), draft.objective)]
    asked += [((*_LIMIT, k), limit.number) for k, limit in enumerate(draft.limits)]
    asked += [(("besides", k), number) for k, number in enumerate(draft.besides)]
    for place, number in asked:
        assert isinstance(number, Number)
        yield from _of_number(place, number, draft, device)
    for k, limit in enumerate(draft.limits):
        if not limit.lower < limit.upper or not np.isfinite([limit.lower, limit.upper]).any():
            must_hold = "a limit has a lower or an upper bound, the lower one below the upper one"
            received = f"{limit.lower:g} and {limit.upper:g}"
            yield Finding((*_LIMIT, k), must_hold, received, "give bounds")


def _objective_place(draft: DesignProblem) -> Location:
    return ("optimise", "minimise" if draft.sign > 0 else "maximise")


def _of_number(place: Location, number: Number, draft: DesignProblem, device: Device) -> Iterator[Finding]:
    sets = [entry.name for entry in draft.current_sets]
    for part, name in (("currents", number.currents), ("minus", number.minus)):
        if name not in sets and (name or part == "currents"):
            must_hold = f"must name its set of currents, one of {one_of(sets)}"
            yield Finding((*place, part), must_hold, repr(name), "choose one of these")
    if number.of is not None:
        return
    names = number_names(GROUPS, axis_labels(draft.record, draft.coil_names, draft.body_names))
    if number.name not in names:
        guess = closest(number.name, list(names))
        remedy = f'did you mean "{guess}"?' if guess else "choose one; numbers at points need points"
        received = repr(number.name)
        yield Finding((*place, "number"), "must be a number that studies record", received, remedy)
        return
    for groups, must_hold, received, remedy in lacking(device, draft.record, draft.iron.saturating):
        if names[number.name][0].group in groups:
            yield Finding((*place, "number"), must_hold, received, f"{remedy}, or choose another number")


def _of_settings(draft: DesignProblem) -> Iterator[Finding]:
    check, refinement = draft.check_refinement, draft.iron.refinement
    settings: tuple[tuple[str, bool, str, Any, str], ...] = (
        (
            "method",
            draft.method in METHODS,
            f"one of {one_of(list(METHODS))}",
            draft.method,
            "choose one of these",
        ),
        ("solves", draft.solves >= 1, "at least 1", draft.solves, "allow more"),
        ("tolerance", 0 < draft.tolerance < 1, "between 0 and 1", draft.tolerance, "correct it"),
        ("check_refinement", check is None or check > 1, "above 1", check, "write 1.4"),
        ("refinement", refinement > 0, "above 0", refinement, "write 1"),
    )
    for name, good, must, received, remedy in settings:
        if not good:
            table = "iron" if name == "refinement" else "optimise"
            yield Finding((table, name), f"must be {must}", f"{received!r}", remedy)


def given_current(key: str, sets: Sequence[CurrentSet], coil_names: Sequence[str]) -> float:
    """Of a coil, A, in the first set whose currents are given; 0 where there is none."""
    name = key.removeprefix(CURRENT)
    for entry in sets:
        if entry.common is not None and name in (*coil_names, "*"):
            return float(entry.common * entry.shares[0 if name == "*" else coil_names.index(name)])
    return 0.0


def _started(variable: Variable, draft: DesignProblem) -> Variable:
    """The variable with the device's own value as its start, where none is given."""
    if variable.start is not None:
        return variable
    if variable.is_current:
        own = given_current(variable.key, draft.current_sets, draft.coil_names)
        return replace(variable, start=own)
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
            yield Finding((*_VARIABLE, k, "start"), must_hold, f"{start}", "give a start, or other bounds")
    told: set[str] = set()
    for place, where, values in _places(draft):
        for key, problem in refused(draft.document_at(values)):
            if key not in told:
                told.add(key)
                must_hold = f"{key} of the device {problem.must_hold}"
                yield Finding(place, must_hold, f"{problem.received} {where}", problem.remedy)


def _places(draft: DesignProblem) -> Iterator[tuple[Location, str, Array]]:
    """The start, and the start with one variable at a bound; where each is told, and in words."""
    begin = draft.starts
    yield (*_VARIABLE, 0, "start"), "at the start", begin
    for k, variable in enumerate(draft.variables):
        for name, bound in (("lower", variable.lower), ("upper", variable.upper)):
            at = begin.copy()
            at[k] = bound
            yield (*_VARIABLE, k, name), f"with {variable.key} at its {name} bound", at
