"""Study files: their keys, and the study or design problem that they state; all errors are reported at once."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from fieldmap import records
from fieldmap.device.changes import changed, key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, InputError, Problem, RecipeError, StudyError
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding, one_of
from fieldmap.inputs.key_paths import Location, dotted, matches
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import Text, Versioned, broken
from fieldmap.maps.recipe import Recipe, read_recipe, read_recipe_device
from fieldmap.shipped import is_file
from fieldmap.studies import study
from fieldmap.studies.design import DesignProblem, OptimiseKeys, Search
from fieldmap.studies.design_checks import checked
from fieldmap.studies.quantities import GROUPS, ON_REQUEST, TAKEN
from fieldmap.typing import PathLike

LARGEST_STUDY = 10_000


def _one_of_each(keys: Any) -> None:
    for names in (("device", "recipe"), ("vary", "variant", "optimise")):
        there = [name for name in names if getattr(keys, name)]
        if len(there) != 1:
            received = " and ".join(there) or "none of them"
            raise broken(f"a study has {' or '.join(names)}", received, "give one of them")
    if keys.optimise is not None and not keys.currents:
        must_hold = "an optimisation has at least one set of currents"
        raise broken(must_hold, "none", "add a table [[currents]]")
    if keys.recipe is not None and keys.iron is not None:
        remedy = "leave [iron] out, or name the device"
        raise broken("iron is that of the recipe", "recipe and [iron]", remedy)


def _names_of_their_own(keys: Any) -> None:
    for what in ("vary", "variant", "currents"):
        names = [entry.name for entry in getattr(keys, what)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise broken(f"every {what} needs a name of its own", one_of(twice), "rename one")
    taken = [entry.name for entry in keys.vary if entry.name in TAKEN]
    if taken:
        must_hold = "the names of the data set's own axes and variables are taken"
        raise broken(must_hold, one_of(taken), "rename it")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StudySettings(records.Record):
    """A study file."""

    title: Annotated[str, Key(Text, "one line about the study")]
    device: Annotated[str | None, Key(Text | None, "device file or name of a shipped device")] = None
    recipe: Annotated[str | None, Key(Text | None, "map recipe, whose device and iron are taken")] = None
    iron: Annotated[study.StudyIron | None, Key(study.IronKeys | None, "how the iron is modelled")] = None
    vary: Annotated[
        tuple[study.Axis, ...], Key(list[study.AxisKeys], "[[vary]]: all combinations of these values")
    ] = ()
    variant: Annotated[
        tuple[study.OneVariant, ...],
        Key(list[table_of(study.OneVariant)], "[[variant]]: one by one"),  # type: ignore[misc]
    ] = ()
    currents: Annotated[
        tuple[study.StatedCurrents, ...],
        Key(list[study.CurrentsKeys], "[[currents]] tables; none where a study is for maps alone"),
    ] = ()
    record: Annotated[study.Record, Key(table_of(study.Record), "the recorded quantities")] = field(
        default_factory=study.Record
    )
    optimise: Annotated[
        Search | None, Key(OptimiseKeys | None, "instead of variants: a search for the best values")
    ] = None


STUDY = FileKind(
    "study",
    table_of(StudySettings, "", "StudyFile", (Versioned,), rules=(_one_of_each, _names_of_their_own)),
    StudyError,
    "maps",
    "studies",
)


def read_study(path_or_name: PathLike) -> study.Study:
    """Read and check a study file, as docs/studies.md describes it.

    Parameters
    ----------
    path_or_name
        Path of the file, or the name of a shipped study ("pole_disk").

    Raises
    ------
    StudyError
        One Problem for every error of the file: file, line and key path; what must hold; what was received; the remedy.
        A variant that the device's schema refuses is such an error. A variant with bodies that cannot be built fails
        only when it is solved.

    Examples
    --------
    >>> study = read_study("pole_disk")
    >>> study.shape, len(study.variants)
    ((4, 3), 12)
    """
    file, settings = _read(path_or_name)
    if settings.optimise is not None:
        must_hold, remedy = "must be a study of variants", "`fieldmap optimise` takes it"
        raise StudyError(file.problem("optimise", must_hold, "a table [optimise]", remedy))
    document, _, findings, common = _opened(file, settings)
    findings = [*key_findings(settings, document), *findings]
    variants = () if findings else variants_of(settings, document)
    findings += variant_findings(settings, variants)
    if findings:
        raise StudyError(*file.problems(findings))
    common |= {"path": file.path, "text": file.text, "device_document": document}
    return study.Study(axes=settings.vary, variants=variants, **common)


def read_design_problem(path_or_name: PathLike) -> DesignProblem:
    """Read and check a study file with [optimise], as docs/optimise.md describes it.

    Parameters
    ----------
    path_or_name
        Path of the file, or the name of a shipped one.

    Raises
    ------
    StudyError
        One Problem for every error of the file: file, line and key path; what must hold; what was received; the remedy.
    """
    file, settings = _read(path_or_name)
    search = settings.optimise
    if search is None:
        must_hold, remedy = "must have a table [optimise]", "`fieldmap study` takes a study of variants"
        raise StudyError.of(str(file.path), must_hold, "a study of variants", remedy)
    document, device, findings, common = _opened(file, settings)
    common["record"] = replace(common["record"], groups=GROUPS)
    if len(settings.currents) == 1:
        # The only set of currents needs no name.
        search = search.renamed(settings.currents[0].name, "")
        common["current_sets"] = (replace(common["current_sets"][0], name=""),)
    done, of_problem = checked(DesignProblem(**vars(search), document=document, **common), device)
    findings = [*findings, *_not_for_designs(settings), *of_problem]
    if findings:
        raise StudyError(*file.problems(findings))
    return done


def _read(path_or_name: PathLike) -> tuple[Document, StudySettings]:
    file = STUDY.load(STUDY.find(path_or_name))
    return file, record_of(STUDY.contents(file))


def _opened(
    file: Document, settings: StudySettings
) -> tuple[Document, Device, list[Finding], dict[str, Any]]:
    """Device file and device of a study, findings in the settings that studies and design problems share, and these
    settings by name. Raises StudyError if there is no device."""
    document, recipe = _named_device(file, settings)
    device = device_of(document)
    iron = settings.iron or study.StudyIron()
    if recipe is not None:
        model = "linear" if recipe.currents is None else "saturating"
        iron = study.StudyIron(model, recipe.mu_r, recipe.tolerance, recipe.refinement)
    sets = tuple(entry.currents(len(device.coils)) for entry in settings.currents)
    record = _record(settings.record, device, iron)
    findings: list[Finding] = []
    for k, entry in enumerate(settings.currents):
        findings += [one.below("currents", k) for one in entry.mistakes(device)]
    findings += _of_quantities(settings.record.groups or (), device, iron, record)
    findings += _of_iron(settings.iron, device)
    names = {"coil_names": device.coil_names, "body_names": tuple(body.name for body in device.bodies)}
    common = {"title": settings.title, "current_sets": sets, "iron": iron, "record": record, **names}
    return document, device, findings, common


def _named_device(file: Document, settings: StudySettings) -> tuple[Document, Recipe | None]:
    """The device file that a study names, and the recipe, if it names one. Raises StudyError."""
    if settings.recipe is None:
        return device_file(str(settings.device), file, StudyError), None
    beside = file.path.parent / settings.recipe
    try:
        recipe = read_recipe(beside if is_file(beside) else settings.recipe)
    except RecipeError as error:
        raise StudyError(*_placed("recipe", error.problems, file)) from error
    source = read_recipe_device(recipe).source
    assert source is not None  # it was read from a file
    return DEVICE.load(source), recipe


def device_file(name: str, file: Document, error: type[InputError]) -> Document:
    """The device file that another file names by `device`: in the same folder, or a shipped one."""
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


def _record(stated: study.Record, device: Device, iron: study.StudyIron) -> study.Record:
    """The record, with the values that the file leaves to the device."""
    limit = stated.current_limit
    if limit is None and device.driver is not None:
        limit = device.driver.current_limit
    record = replace(stated, current_limit=limit)
    wanted = set(GROUPS if stated.groups is None else stated.groups)
    if stated.groups is None:
        wanted -= ON_REQUEST.union(*(groups for groups, *_ in study.lacking(device, record, iron.saturating)))
    if iron.accuracy is not None and device.bodies:
        wanted.add("error")
    return replace(record, groups=tuple(group for group in GROUPS if group in wanted))


def _of_quantities(
    groups: tuple[str, ...], device: Device, iron: study.StudyIron, record: study.Record
) -> Iterator[Finding]:
    for k, name in enumerate(groups):
        for lacked, must_hold, received, remedy in study.lacking(device, record, iron.saturating):
            if name in lacked:
                place = ("record", "quantities", k)
                yield Finding(place, f"{name} {must_hold}", received, f"{remedy}, or leave {name} out")


def _of_iron(iron: study.StudyIron | None, device: Device) -> Iterator[Finding]:
    if iron is not None and iron.saturating and not device.bodies:
        must_hold, received = "there must be iron to saturate", "a device without bodies"
        yield Finding(("iron", "model"), must_hold, received, 'write "linear"')
    if iron is not None and iron.accuracy is not None and device.workspace is None:
        must_hold = "the error is estimated in the device's [workspace]"
        yield Finding(("iron", "accuracy"), must_hold, "none", "add one to the device file")


def _not_for_designs(settings: StudySettings) -> Iterator[Finding]:
    if settings.iron is not None and settings.iron.accuracy is not None:
        must_hold = "designs are compared on meshes of one refinement"
        remedy = "write iron.refinement; the best design is checked on a finer mesh"
        yield Finding(("iron", "accuracy"), must_hold, f"{settings.iron.accuracy:g}", remedy)
    if settings.record.groups is not None:
        must_hold = "an optimisation takes the numbers that it needs"
        yield Finding(("record", "quantities"), must_hold, "a list", "leave it out")


def key_findings(settings: StudySettings, document: Document) -> list[Finding]:
    """Findings for keys that the device file does not have, keys that are set twice, and too many variants."""
    told = (key_finding(location, key, document) for location, key in _keys(settings))
    found = [finding for finding in told if finding is not None]
    found += _set_twice(settings, document)
    count = math.prod(len(entry.values) for entry in settings.vary)
    if max(count, len(settings.variant)) > LARGEST_STUDY:
        must_hold = f"a study has at most {LARGEST_STUDY} variants"
        found.append(Finding(("vary",), must_hold, f"{count}", "leave out values, or make several studies"))
    return found


def _set_twice(settings: StudySettings, document: Document) -> Iterator[Finding]:
    """Findings for keys that two tables of [[vary]], or two lines of one table, set."""
    first: dict[Location, Location] = {}
    for location, key in _keys(settings) if settings.vary else ():
        for place in matches(document.data, key):
            if first.setdefault(place, location) != location:
                received = f"{dotted(document.data, place)}, set before by another one"
                yield Finding(location, "every key is set once", received, "leave one of them out")
                break


def _keys(settings: StudySettings) -> Iterator[tuple[Location, str]]:
    for k, entry in enumerate(settings.vary):
        yield ("vary", k, "key"), entry.key
        for j, linked in enumerate(entry.linked):
            for i, key in enumerate(linked.keys):
                yield ("vary", k, "linked", j, "keys", i), key
    for k, variant in enumerate(settings.variant):
        for key in variant.set:
            yield ("variant", k, "set", key), key


def variants_of(settings: StudySettings, document: Document) -> tuple[study.Variant, ...]:
    """All variants, the last axis fastest. The device files are not checked here."""
    stated: list[tuple[str, tuple[int, ...], list[tuple[str, Any]]]] = [
        (one.name, (k,), list(one.set.items())) for k, one in enumerate(settings.variant)
    ]
    places = itertools.product(*(range(len(axis.values)) for axis in settings.vary))
    for place in places if settings.vary else ():
        chosen = [(axis, axis.values[k]) for axis, k in zip(settings.vary, place, strict=True)]
        together = [
            pair for axis, value in chosen for pair in study.settings_with(axis.key, value, axis.linked)
        ]
        stated.append((study.setting_words({axis.name: value for axis, value in chosen}), place, together))
    return tuple(
        study.Variant(name, place, tuple(keys), changed(document, keys)) for name, place, keys in stated
    )


def variant_findings(settings: StudySettings, variants: tuple[study.Variant, ...]) -> list[Finding]:
    """Errors of the device schema in the variants, each once, at the study's table that causes it."""
    found: dict[tuple[str, str, str], Finding] = {}
    for number, variant in enumerate(variants):
        location: Location = ("variant", number) if settings.variant else ("vary",)
        for key, problem in study.refused(variant.document):
            location = _cause(settings, variant, key) or location
            must_hold = f"{key} of the device {problem.must_hold}"
            received = f"{problem.received} in the variant {variant.name}"
            same = (key, problem.must_hold, problem.received)
            found.setdefault(same, Finding(location, must_hold, received, problem.remedy))
    return list(found.values())


def _cause(settings: StudySettings, variant: study.Variant, key: str) -> Location | None:
    """Location of the axis with a key, or a linked key, that is the key of an error."""
    for k, entry in enumerate(settings.vary):
        patterns = [(("vary", k, "values"), entry.key)]
        patterns += [(("vary", k, "linked"), name) for linked in entry.linked for name in linked.keys]
        for location, pattern in patterns:
            places = matches(variant.document.data, pattern)
            if set(places) & set(matches(variant.document.data, key)):
                return location
    return None
