"""From a study file to a study: its variants, what it asks of the device that they vary, all problems at once."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.currents import divide_currents
from fieldmap.device.changes import changed, key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, FieldmapError, InputError, Problem, RecipeError, StudyError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding
from fieldmap.inputs.key_paths import Location, dotted, matches
from fieldmap.inputs.tables import MILLI
from fieldmap.maps.recipe import Recipe, read_recipe, read_recipe_device
from fieldmap.shipped import is_file
from fieldmap.studies.quantities import GROUPS, ON_REQUEST
from fieldmap.studies.schema import STUDY, CurrentKeys, StudyFile
from fieldmap.studies.study import (
    Axis,
    CurrentSet,
    IronModel,
    Record,
    Study,
    Variant,
    current_set,
    lacking,
    setting_words,
    settings_with,
)

LARGEST_STUDY = 10_000


def key_findings(contents: StudyFile, document: Document) -> list[Finding]:
    """Keys that the device file does not have, and studies of too many variants."""
    told = (key_finding(location, key, document) for location, key in _keys(contents))
    found = [finding for finding in told if finding is not None]
    found += _set_twice(contents, document)
    count = math.prod(len(entry.values) for entry in contents.vary)
    if max(count, len(contents.variant)) > LARGEST_STUDY:
        must_hold = f"a study has at most {LARGEST_STUDY} variants"
        found.append(Finding(("vary",), must_hold, f"{count}", "leave out values, or make several studies"))
    return found


def _set_twice(contents: StudyFile, document: Document) -> Iterator[Finding]:
    """Keys that two tables of [[vary]], or two lines of one, set."""
    first: dict[Location, Location] = {}
    for location, key in _keys(contents) if contents.vary else ():
        for place in matches(document.data, key):
            if first.setdefault(place, location) != location:
                received = f"{dotted(document.data, place)}, set before by another one"
                yield Finding(location, "every key is set once", received, "leave one of them out")
                break


def _keys(contents: StudyFile) -> Iterator[tuple[Location, str]]:
    for k, entry in enumerate(contents.vary):
        yield ("vary", k, "key"), entry.key
        for j, linked in enumerate(entry.linked):
            for i, key in enumerate(linked.keys):
                yield ("vary", k, "linked", j, "keys", i), key
    for k, variant in enumerate(contents.variant):
        for key in variant.set:
            yield ("variant", k, "set", key), key


def variants_of(contents: StudyFile, document: Document) -> tuple[Variant, ...]:
    """All variants, the last axis fastest. The device files are not checked here."""
    if contents.variant:
        return tuple(
            Variant(entry.name, (k,), tuple(entry.set.items()), changed(document, tuple(entry.set.items())))
            for k, entry in enumerate(contents.variant)
        )
    combined = []
    for place in itertools.product(*(range(len(entry.values)) for entry in contents.vary)):
        chosen = [(entry, entry.values[k]) for entry, k in zip(contents.vary, place, strict=True)]
        settings = tuple(
            pair for entry, value in chosen for pair in settings_with(entry.key, value, entry.linked)
        )
        words = setting_words({entry.name: value for entry, value in chosen})
        combined.append(Variant(words, place, settings, changed(document, settings)))
    return tuple(combined)


def variant_findings(contents: StudyFile, variants: tuple[Variant, ...]) -> list[Finding]:
    """What the device schema refuses in a variant, each complaint once, at the study's table that causes it."""
    found: dict[tuple[str, str, str], Finding] = {}
    for number, variant in enumerate(variants):
        location: Location = ("variant", number) if contents.variant else ("vary",)
        for key, problem in refused(variant.document):
            location = _cause(contents, variant, key) or location
            must_hold = f"{key} of the device {problem.must_hold}"
            received = f"{problem.received} in the variant {variant.name}"
            same = (key, problem.must_hold, problem.received)
            found.setdefault(same, Finding(location, must_hold, received, problem.remedy))
    return list(found.values())


def refused(document: Document) -> list[tuple[str, Problem]]:
    """What is wrong with a changed device file, by its keys."""
    try:
        device_of(document)
    except FieldmapError as error:
        return [(problem.where.split(": ", 1)[-1], problem) for problem in error.problems]
    return []


def _cause(contents: StudyFile, variant: Variant, key: str) -> Location | None:
    """The axis whose key, or one that follows it, is the one complained about."""
    for k, entry in enumerate(contents.vary):
        patterns = [(("vary", k, "values"), entry.key)]
        patterns += [(("vary", k, "linked"), name) for linked in entry.linked for name in linked.keys]
        for location, pattern in patterns:
            places = matches(variant.document.data, pattern)
            if set(places) & set(matches(variant.document.data, key)):
                return location
    return None


def device_findings(contents: StudyFile, device: Device, iron: IronModel, record: Record) -> list[Finding]:
    """What the device lacks for the currents and quantities of the study."""
    return [
        *_of_currents(contents, device),
        *_of_quantities(contents, device, iron, record),
        *_of_iron(contents, device),
    ]


def _of_currents(contents: StudyFile, device: Device) -> Iterator[Finding]:
    coils = len(device.coils)
    for k, entry in enumerate(contents.currents):
        for key in ("amperes_A", "shares"):
            given = getattr(entry, key)
            if isinstance(given, list) and len(given) != coils:
                must_hold = f"one number for each of the {coils} coils ({', '.join(device.coil_names)}), or one for all"
                yield Finding(
                    ("currents", k, key),
                    must_hold,
                    f"{len(given)} numbers",
                    "list as many as there are coils",
                )
        if entry.lift_and_directions is not None and coils != 6:
            must_hold = "lift_and_directions is for six coils"
            yield Finding(
                ("currents", k, "lift_and_directions"),
                must_hold,
                f"{coils} coils",
                "write amperes_A or shares",
            )
        if entry.carries_at_mm is not None and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            remedy = "add them to the device file, or write amperes_A"
            yield Finding(("currents", k, "carries_at_mm"), must_hold, "none", remedy)


def _of_quantities(contents: StudyFile, device: Device, iron: IronModel, record: Record) -> Iterator[Finding]:
    for k, name in enumerate(contents.record.quantities or ()):
        for groups, must_hold, received, remedy in lacking(device, record, iron.saturating):
            if name in groups:
                place = ("record", "quantities", k)
                yield Finding(place, f"{name} {must_hold}", received, f"{remedy}, or leave {name} out")


def _of_iron(contents: StudyFile, device: Device) -> Iterator[Finding]:
    keys = contents.iron
    if keys is None:
        return
    if keys.model == "saturating" and not device.bodies:
        yield Finding(
            ("iron", "model"), "there must be iron to saturate", "a device without bodies", 'write "linear"'
        )
    if keys.accuracy is not None and device.workspace is None:
        must_hold = "the error is estimated in the device's [workspace]"
        yield Finding(("iron", "accuracy"), must_hold, "none", "add one to the device file")


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
    if contents.optimise is not None:
        must_hold, remedy = "must be a study of variants", "`fieldmap optimise` takes it"
        raise StudyError(study_file.problem("optimise", must_hold, "a table [optimise]", remedy))
    document, recipe = named_device(contents, study_file)
    device = device_of(document)
    sets, iron, record = read_parts(contents, device, recipe)
    findings = key_findings(contents, document) + device_findings(contents, device, iron, record)
    variants = () if findings else variants_of(contents, document)
    findings += variant_findings(contents, variants)
    if findings:
        raise StudyError(*study_file.problems(findings))
    return Study(
        path=path,
        text=study_file.text,
        title=contents.title,
        axes=tuple(Axis(entry.name, entry.key, tuple(entry.values)) for entry in contents.vary),
        variants=variants,
        current_sets=sets,
        iron=iron,
        record=record,
        device_document=document,
        coil_names=device.coil_names,
        body_names=tuple(body.name for body in device.bodies),
    )


def named_device(contents: StudyFile, study_file: Document) -> tuple[Document, Recipe | None]:
    """The device file that a study names, and the recipe, if it names one. Raises StudyError."""
    if contents.recipe is None:
        return device_file(str(contents.device), study_file, StudyError), None
    beside = study_file.path.parent / contents.recipe
    try:
        recipe = read_recipe(beside if is_file(beside) else contents.recipe)
    except RecipeError as error:
        raise StudyError(*_placed("recipe", error.problems, study_file)) from error
    source = read_recipe_device(recipe).source
    assert source is not None  # it was read from a file
    return DEVICE.load(source), recipe


def device_file(name: str, file: Document, error: type[InputError]) -> Document:
    """The device file that another file names by `device`: beside it, or a shipped one."""
    beside = file.path.parent / name
    try:
        return DEVICE.load(beside if is_file(beside) else DEVICE.find(name))
    except DeviceFileError as wrong:
        raise error(*_placed("device", wrong.problems, file)) from wrong


def _placed(key: str, problems: tuple[Problem, ...], file: Document) -> list[Problem]:
    """Problems of another file, at the key that names it."""
    findings = [
        Finding((key,), f"{problem.where}: {problem.must_hold}", problem.received, problem.remedy)
        for problem in problems
    ]
    return file.problems(findings)


def read_parts(
    contents: StudyFile, device: Device, recipe: Recipe | None
) -> tuple[tuple[CurrentSet, ...], IronModel, Record]:
    """Sets of currents, iron, and what is recorded."""
    sets = tuple(_current_set(entry, len(device.coils)) for entry in contents.currents)
    iron = _iron(contents, recipe)
    return sets, iron, _record(contents, device, iron)


def _current_set(entry: CurrentKeys, coils: int) -> CurrentSet:
    amperes: Any = entry.shares if entry.amperes_A is None else entry.amperes_A
    if entry.lift_and_directions is not None:
        of = entry.lift_and_directions
        amperes = divide_currents(of.u_A or 1.0, of.x, of.y, of.n)
    # Of lists that do not fit `_of_currents` tells.
    fits = amperes is not None and np.size(amperes) in (1, coils)
    place = None if entry.carries_at_mm is None else np.array(entry.carries_at_mm) * MILLI
    return current_set(entry.name, amperes if fits else 1.0, coils, place)


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
    points = np.array(keys.points_mm, float).reshape(-1, 3) * MILLI
    corners = None if keys.box_mm is None else np.array(keys.box_mm, float) * MILLI
    box = None if corners is None else (corners[0], corners[1])
    record = Record(GROUPS, points, keys.force_share, limit, box)
    wanted = set(GROUPS if keys.quantities is None else keys.quantities)
    if keys.quantities is None:
        wanted -= ON_REQUEST.union(*(groups for groups, *_ in lacking(device, record, iron.saturating)))
    if iron.accuracy is not None and device.bodies:
        wanted.add("error")
    return replace(record, groups=tuple(group for group in GROUPS if group in wanted))
