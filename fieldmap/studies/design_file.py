"""From a study file with [optimise] to a problem of design, all its mistakes at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldmap.device.reader import device_of
from fieldmap.errors import Problem, StudyError
from fieldmap.inputs.findings import Finding
from fieldmap.inputs.key_paths import Location
from fieldmap.studies.design_checks import checked
from fieldmap.studies.design_problem import DesignProblem, Limit, Linked, Number, Variable
from fieldmap.studies.quantities import GROUPS
from fieldmap.studies.reading import device_findings, named_device, read_parts
from fieldmap.studies.schema import STUDY, NumberKeys, OptimiseKeys, StudyFile, VariableKeys


def read_design_problem(path_or_name: str | Path) -> DesignProblem:
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
            Limit(_number(entry, contents), _bound(entry.lower, -np.inf), _bound(entry.upper, np.inf))
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
    findings = [*device_findings(contents, device, recipe), *_of_tables(contents)]
    done, of_problem = checked(draft, device)
    findings += [replace(finding, location=_location(finding.location, keys)) for finding in of_problem]
    if findings:
        raise StudyError(*study_file.problems(findings))
    return done


def _bound(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _variable(entry: VariableKeys) -> Variable:
    linked = tuple(Linked(tuple(one.keys), one.factor, one.offset) for one in entry.linked)
    return Variable(entry.key, entry.lower, entry.upper, entry.start, linked, entry.step)


def _number(entry: NumberKeys, contents: StudyFile) -> Number:
    sets = [one.name for one in contents.currents]
    named = "" if entry.currents in sets and len(sets) == 1 else entry.currents or ""
    return Number(entry.number, named, entry.minus or "")


def _location(place: Location, keys: OptimiseKeys) -> Location:
    """Where a mistake stands in the file."""
    match place:
        case ("objective", *rest):
            return ("optimise", "minimise" if keys.maximise is None else "maximise", *rest)
        case ("limit", *rest):
            return ("optimise", "constraint", *rest)
        case ("variables", *_):
            return ("optimise", "variable")
        case ("refinement", *_):
            return ("iron", "refinement")
        case _:
            return ("optimise", *place)


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
