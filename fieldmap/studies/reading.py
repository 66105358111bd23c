"""Read a study file and check all of it, with the device that it varies."""

from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.currents import divide_currents
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, Problem, RecipeError, StudyError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding
from fieldmap.maps.recipe import Recipe, read_recipe, read_recipe_device
from fieldmap.studies.device_checks import device_findings
from fieldmap.studies.quantities import GROUPS, NEED_LIMIT, NEED_PAYLOAD, NEED_POINTS
from fieldmap.studies.schema import STUDY, CurrentKeys, StudyFile
from fieldmap.studies.study import CurrentSet, IronModel, Record, Study
from fieldmap.studies.variants import axes_of, key_findings, variant_findings, variants_of

MILLI = 1e-3


def read_study(path_or_name: str | Path) -> Study:
    """Read and check a study file: its path, or the name of a shipped study ("pole_disk").

    The format is described in docs/studies.md. Raises StudyError with one Problem for every error of the file: file,
    line and key path; what must hold; what was received; the remedy. A variant that the device's schema refuses is
    such an error; one whose bodies cannot be built shows only when it is solved.

    >>> study = read_study("pole_disk")
    >>> study.shape, len(study.variants)
    ((4, 3), 12)
    """
    path = STUDY.find(path_or_name)
    study_file = STUDY.load(path)
    contents = STUDY.contents(study_file)
    recipe = _recipe(contents, study_file)
    document = _device_document(contents, recipe, study_file)
    device = device_of(document)
    findings = key_findings(contents, document) + device_findings(contents, device, recipe)
    variants = () if findings else variants_of(contents, document)
    findings += variant_findings(contents, variants)
    if findings:
        raise StudyError(*study_file.problems(findings))
    return Study(
        path=path,
        text=study_file.text,
        title=contents.title,
        axes=axes_of(contents),
        variants=variants,
        current_sets=tuple(_current_set(entry, len(device.coils)) for entry in contents.currents),
        iron=_iron(contents, recipe),
        record=_record(contents, device, _iron(contents, recipe)),
        device_document=document,
        coil_names=device.coil_names,
    )


def _recipe(contents: StudyFile, study_file: Document) -> Recipe | None:
    if contents.recipe is None:
        return None
    beside = study_file.path.parent / contents.recipe
    try:
        return read_recipe(beside if beside.is_file() else contents.recipe)
    except RecipeError as error:
        raise StudyError(*_placed("recipe", error.problems, study_file)) from error


def _device_document(contents: StudyFile, recipe: Recipe | None, study_file: Document) -> Document:
    if recipe is not None:
        source = read_recipe_device(recipe).source
        assert source is not None  # it was read from a file
        return DEVICE.load(source)
    beside = study_file.path.parent / str(contents.device)
    try:
        return DEVICE.load(beside if beside.is_file() else DEVICE.find(str(contents.device)))
    except DeviceFileError as error:
        raise StudyError(*_placed("device", error.problems, study_file)) from error


def _placed(key: str, problems: tuple[Problem, ...], study_file: Document) -> list[Problem]:
    """Problems of another file, at the key that names it."""
    findings = [
        Finding((key,), f"{problem.where}: {problem.must_hold}", problem.received, problem.remedy)
        for problem in problems
    ]
    return study_file.problems(findings)


def _current_set(entry: CurrentKeys, coils: int) -> CurrentSet:
    given: Any = entry.amperes_A if entry.amperes_A is not None else entry.shares
    if entry.division is not None:
        division = entry.division
        currents = divide_currents(division.u_A or 1.0, division.x, division.y, division.n)
    else:
        currents = np.array(np.broadcast_to(np.asarray(1.0 if given is None else given, float), coils))
    common = float(np.abs(currents).mean())
    looked_for = entry.carries_at_mm is not None
    place = np.array(entry.carries_at_mm) * MILLI if looked_for else None
    return CurrentSet(entry.name, currents / common, None if looked_for else common, place)


def _iron(contents: StudyFile, recipe: Recipe | None) -> IronModel:
    if recipe is not None:
        plan = recipe.currents
        if plan is None:
            return IronModel(False, recipe.mu_r, recipe.tolerance, recipe.refinement)
        return IronModel(True, None, recipe.tolerance, plan.refinement)
    keys = contents.iron
    if keys is None:
        return IronModel(False)
    mu_r = None if keys.mu_r == "initial" else float(keys.mu_r)
    refinement = 1.0 if keys.refinement is None else keys.refinement
    return IronModel(keys.model == "saturating", mu_r, keys.tolerance, refinement, keys.accuracy)


def _record(contents: StudyFile, device: Device, iron: IronModel) -> Record:
    keys = contents.record
    limit = keys.current_limit_A
    if limit is None and device.driver is not None:
        limit = device.driver.current_limit
    lacking: set[str] = set()
    lacking |= set(NEED_PAYLOAD) if device.payload is None or device.workspace is None else set()
    lacking |= set(NEED_LIMIT) if limit is None else set()
    lacking |= set(NEED_POINTS) if not keys.points_mm else set()
    lacking |= {"reachable_share"} if iron.saturating else set()
    lacking |= {"iron"} if not device.bodies else set()
    lacking |= {"error"} if not device.bodies or device.workspace is None else set()
    wanted: list[str] = (
        [name for name in GROUPS if name not in lacking] if keys.quantities is None else keys.quantities
    )
    wanted += ["error"] if iron.accuracy is not None and device.bodies else []
    points = np.array(keys.points_mm, float).reshape(-1, 3) * MILLI
    return Record(tuple(g for g in GROUPS if g in wanted), points, keys.force_share, limit)
