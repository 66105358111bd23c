"""From a study file to a study: its variants, what it asks of the device that they vary, all problems at once."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.currents import divide_currents
from fieldmap.device.changes import changed, key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, Problem, RecipeError, StudyError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding
from fieldmap.inputs.key_paths import Location, dotted, matches
from fieldmap.maps.recipe import Recipe, read_recipe, read_recipe_device
from fieldmap.shipped import is_file
from fieldmap.studies.quantities import GROUPS, NEED_BOX, NEED_LIMIT, NEED_PAYLOAD, NEED_POINTS, ON_REQUEST
from fieldmap.studies.schema import STUDY, CurrentKeys, StudyFile, VaryKeys
from fieldmap.studies.study import Axis, CurrentSet, IronModel, Record, Study, Value, Variant, setting_words

Settings = tuple[tuple[str, Value], ...]
LARGEST_STUDY = 10_000
MILLI = 1e-3


def axes_of(contents: StudyFile) -> tuple[Axis, ...]:
    """The varied keys; none where the variants are listed one by one."""
    return tuple(Axis(entry.name, entry.key, tuple(entry.values)) for entry in contents.vary)


def key_findings(contents: StudyFile, document: Document) -> list[Finding]:
    """Keys that the device file does not have, and studies of too many variants."""
    told = (key_finding(location, key, document) for location, key in _keys(contents))
    found = [finding for finding in told if finding is not None]
    found += _set_twice(contents, document)
    count = 1
    for entry in contents.vary:
        count *= len(entry.values)
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
    return tuple(_combined(contents.vary, place, document) for place in _places(contents.vary))


def _places(vary: Sequence[VaryKeys]) -> Iterator[tuple[int, ...]]:
    return itertools.product(*(range(len(entry.values)) for entry in vary))


def _combined(vary: Sequence[VaryKeys], place: tuple[int, ...], document: Document) -> Variant:
    values = {entry.name: entry.values[k] for entry, k in zip(vary, place, strict=True)}
    settings = tuple(pair for entry in vary for pair in _settings(entry, values[entry.name]))
    return Variant(setting_words(values), place, settings, changed(document, settings))


def _settings(entry: VaryKeys, value: Any) -> Iterator[tuple[str, Value]]:
    yield entry.key, value
    for linked in entry.linked:
        for key in linked.keys:
            yield key, linked.offset + linked.factor * value


def variant_findings(contents: StudyFile, variants: tuple[Variant, ...]) -> list[Finding]:
    """What the device schema refuses in a variant, each complaint once, at the study's table that causes it."""
    found: dict[tuple[str, str, str], Finding] = {}
    for number, variant in enumerate(variants):
        try:
            device_of(variant.document)
        except DeviceFileError as error:
            location: Location = ("variant", number) if contents.variant else ("vary",)
            for problem in error.problems:
                key = problem.where.split(": ", 1)[-1]
                location = _cause(contents, variant, key) or location
                must_hold = f"{key} of the device {problem.must_hold}"
                received = f"{problem.received} in the variant {variant.name}"
                same = (key, problem.must_hold, problem.received)
                found.setdefault(same, Finding(location, must_hold, received, problem.remedy))
    return list(found.values())


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


def device_findings(contents: StudyFile, device: Device, recipe: Recipe | None) -> list[Finding]:
    """What the device lacks for the currents and quantities of the study."""
    saturating = recipe is not None and recipe.currents is not None
    saturating |= contents.iron is not None and contents.iron.model == "saturating"
    return [
        *_of_currents(contents, device),
        *_of_quantities(contents, device, saturating),
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


def _of_quantities(contents: StudyFile, device: Device, saturating: bool) -> Iterator[Finding]:
    record = contents.record
    for k, name in enumerate(record.quantities or ()):
        place = ("record", "quantities", k)
        if name in NEED_PAYLOAD and (device.payload is None or device.workspace is None):
            remedy = "add them to the device file, or leave the quantity out"
            yield Finding(place, f"{name} needs the device's [payload] and [workspace]", "none", remedy)
        if name in NEED_LIMIT and record.current_limit_A is None and device.driver is None:
            yield Finding(
                place, f"{name} needs the limit of the currents", "none", "add record.current_limit_A"
            )
        if name in NEED_POINTS and not record.points_mm:
            yield Finding(place, f"{name} needs record.points_mm", "none", "add points_mm = [[x, y, z]]")
        if name in NEED_BOX and record.box_mm is None:
            remedy = "add box_mm = [[x, y, z], [x, y, z]], its lower and upper corner"
            yield Finding(place, f"{name} needs record.box_mm", "none", remedy)
        if name == "reachable_share" and saturating:
            remedy = "leave it out; reach is recorded of saturating iron as well"
            yield Finding(
                place, "reachable_share superposes coils: linear iron only", "saturating iron", remedy
            )
        if name in ("iron", "error") and not device.bodies:
            yield Finding(place, f"{name} needs iron", "a device without bodies", "leave it out")
        if name == "error" and device.workspace is None:
            yield Finding(place, "error needs the device's [workspace]", "none", "add it, or leave error out")


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
    findings = key_findings(contents, document) + device_findings(contents, device, recipe)
    variants = () if findings else variants_of(contents, document)
    findings += variant_findings(contents, variants)
    if findings:
        raise StudyError(*study_file.problems(findings))
    sets, iron, record = read_parts(contents, device, recipe)
    return Study(
        path=path,
        text=study_file.text,
        title=contents.title,
        axes=axes_of(contents),
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
    recipe = _recipe(contents, study_file)
    return _device_document(contents, recipe, study_file), recipe


def read_parts(
    contents: StudyFile, device: Device, recipe: Recipe | None
) -> tuple[tuple[CurrentSet, ...], IronModel, Record]:
    """Sets of currents, iron, and what is recorded."""
    sets = tuple(_current_set(entry, len(device.coils)) for entry in contents.currents)
    iron = _iron(contents, recipe)
    return sets, iron, _record(contents, device, iron)


def _recipe(contents: StudyFile, study_file: Document) -> Recipe | None:
    if contents.recipe is None:
        return None
    beside = study_file.path.parent / contents.recipe
    try:
        return read_recipe(beside if is_file(beside) else contents.recipe)
    except RecipeError as error:
        raise StudyError(*_placed("recipe", error.problems, study_file)) from error


def _device_document(contents: StudyFile, recipe: Recipe | None, study_file: Document) -> Document:
    if recipe is not None:
        source = read_recipe_device(recipe).source
        assert source is not None  # it was read from a file
        return DEVICE.load(source)
    beside = study_file.path.parent / str(contents.device)
    try:
        return DEVICE.load(beside if is_file(beside) else DEVICE.find(str(contents.device)))
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
    if entry.lift_and_directions is not None:
        of = entry.lift_and_directions
        currents = divide_currents(of.u_A or 1.0, of.x, of.y, of.n)
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
    lacking |= set(NEED_BOX) if keys.box_mm is None else set()
    lacking |= ON_REQUEST
    lacking |= {"reachable_share"} if iron.saturating else set()
    lacking |= {"iron"} if not device.bodies else set()
    lacking |= {"error"} if not device.bodies or device.workspace is None else set()
    wanted: list[str] = (
        [name for name in GROUPS if name not in lacking] if keys.quantities is None else keys.quantities
    )
    wanted += ["error"] if iron.accuracy is not None and device.bodies else []
    points = np.array(keys.points_mm, float).reshape(-1, 3) * MILLI
    groups = tuple(g for g in GROUPS if g in wanted)
    corners = None if keys.box_mm is None else np.array(keys.box_mm, float) * MILLI
    box = None if corners is None else (corners[0], corners[1])
    return Record(groups, points, keys.force_share, limit, box)
