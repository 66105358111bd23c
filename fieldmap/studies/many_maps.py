"""One map for each variant of a study, as one job: `fieldmap map RECIPE --over STUDY`, `fm.generate_many`.

A finished map is not made again, so that an interrupted run can be resumed.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldmap.arguments import check
from fieldmap.device.changes import changed
from fieldmap.device.reader import device_of
from fieldmap.errors import StudyError
from fieldmap.inputs.document import Document
from fieldmap.iron.solvers.shared import SharedSolves
from fieldmap.maps.generation import make_map
from fieldmap.maps.recipe import Recipe, read_recipe, read_recipe_device
from fieldmap.parallel import Common, Workers
from fieldmap.plain import Plain, plain_items
from fieldmap.progress import Forecast, rate, shown_or_silent
from fieldmap.provenance import library_versions
from fieldmap.records import Record
from fieldmap.store import read_info, write_whole
from fieldmap.studies.reading import read_study
from fieldmap.studies.run import (
    OUTPUT_FOLDER,
    checked_output,
    csv_table,
    require_xarray,
    variant_coordinates,
    variant_heads,
    write_netcdf,
)
from fieldmap.studies.study import Study, Value
from fieldmap.typing import PathLike, Progress

# Tables of a device file that do not change the solution of linear iron. They decide only the order of the maps;
# `SharedSolves` finds solutions that maps share by their contents.
_NOT_OF_THE_IRON = ("coil", "payload", "driver", "workspace", "sensor", "reference", "section", "provenance")
_LOOKUP = "harmonic"
_ERRORS = {
    "certified_flux_density": ("T", "largest error of B against the solver, currents up to the reference"),
    "certified_gradient": ("T m-1", "the same of its gradient"),
    "current_flux_density": ("T", "largest error of B of the model of saturating iron, at states tried"),
    "current_gradient": ("T m-1", "the same of its gradient"),
}


@dataclass(frozen=True, eq=False, repr=False)
class ManyMaps(Record):
    """The maps of a study. data: xarray.Dataset of the index; path, table: of the index as NetCDF and as CSV; failed:
    variants without a map, with the reason, by their names."""

    study: Study
    data: Any
    path: Path
    table: Path
    failed: dict[str, str]

    def to_dict(self) -> dict[str, Plain]:
        """Title, number of maps, and failures as plain Python."""
        total = len(self.study.variants)
        return plain_items(title=self.study.title, maps=total - len(self.failed), failed=self.failed)


class _Job(NamedTuple):
    """Data common to all maps; each process adds the solutions that maps with the same iron share."""

    recipe: Recipe
    document: Document
    resume: bool
    accept_error: bool
    shared: SharedSolves


class _Made(NamedTuple):
    """Stated errors of one map, in the order of `_ERRORS`, NaN where there is none, and its nodes; or the problem if
    there is no map."""

    errors: Sequence[float] = (np.nan,) * len(_ERRORS)
    lower: Sequence[float] = (np.nan,) * 3
    spacing: Sequence[float] = (np.nan,) * 3
    nodes: Sequence[int] = (0,) * 3
    problem: str = ""


def generate_many(
    recipe: PathLike,
    over: PathLike | Study,
    output: PathLike | None = None,
    resume: bool = True,
    workers: int = 1,
    progress: Progress | bool | None = None,
    scheduler: str | None = None,
    *,
    accept_error: bool = False,
    part: tuple[int, int] | None = None,
) -> ManyMaps | None:
    """Make the map of a recipe for every variant of a study, and an index of the maps.

    Maps of linear iron share solutions. If several variants have the same iron, the same box, or coils that differ only
    in turns, each process solves it once for all of them. A variant that fails is recorded with its reason, and does
    not stop the others; another run tries it again.

    Parameters
    ----------
    recipe
        Path of a recipe file, or the name of a shipped one.
    over
        Path of a study file, name of a shipped one, or a `Study`. Its device must be that of the recipe; its currents,
        iron and records are not used.
    output
        NetCDF file of the index; maps/out/STUDY_maps.nc unless given. A CSV file of the index and the folder of the
        maps have the same name. Every worker must see this folder.
    resume
        Keep finished maps, and continue begun ones, if everything that determines their numbers is the same.
    workers, scheduler
        Processes that make the maps, each one map at a time: as for `fieldmap.studies.run_study`.
    progress
        Called as progress(message, fraction) after each map; None, True and False as for `fieldmap.generate`.
    accept_error
        As for `fieldmap.generate`.
    part
        (k, n): only the k-th of n parts of the maps, k from 1, and no index, as for one task of a cluster's array job.
        A run without it, afterwards, writes the index.

    Returns
    -------
    ManyMaps | None
        The maps; None for a part.

    Raises
    ------
    RecipeError, StudyError, InputError
        Before any long work.
    FieldmapError
        If xarray or h5netcdf is missing.

    Examples
    --------
    >>> import fieldmap as fm
    >>> many = fm.generate_many("quick", "pole_pieces.toml")                      # doctest: +SKIP
    >>> many.data.certified_flux_density.max()                                    # doctest: +SKIP
    """
    require_xarray()
    order, study = read_recipe(recipe), over if isinstance(over, Study) else read_study(over)
    _require_one_device(order, study)
    usual = OUTPUT_FOLDER / f"{study.path.stem}_maps.nc"
    target = checked_output(usual if output is None else Path(output))
    files = map_files(study, target)
    groups = _groups(study)
    firsts, numbers = {group[0] for group in groups}, [number for group in groups for number in group]
    if part is not None:
        k, n = part
        check(1 <= k <= n, "generate_many, part", "(k, n) with k from 1 to n", repr(part), "correct it")
        numbers = numbers[len(numbers) * (k - 1) // n : len(numbers) * k // n]
    common = Common(_job, order, study.device_document, resume, accept_error)
    found: dict[int, _Made] = {}
    # Workers of a scheduler may run in another folder.
    items = [(study.variants[number].settings, str(files[number].absolute())) for number in numbers]
    with shown_or_silent("maps", progress, timed=True) as say, Workers(workers, scheduler) as team:
        pieces = _Pieces([number in firsts for number in numbers])
        forecast = Forecast(say, {"maps": pieces.whole}, team.processes)
        forecast.at("maps", f"making {len(numbers)} maps")
        for outcome in team.map(_made, items, common):
            number = numbers[outcome.index]
            found[number] = _Made(problem=outcome.reason) if outcome.value is None else outcome.value
            pieces.count(outcome.index, outcome.seconds)
            forecast.expect("maps", pieces.whole)
            name, pace = study.variants[number].name, rate(len(found), forecast.taken(), "map")
            message = f"{len(found)} of {len(numbers)} maps: {name}{pace}"
            forecast.at("maps", message, pieces.done, pieces.whole)
    if part is not None:
        return None
    made = [found[number] for number in range(len(files))]
    names = [file.relative_to(target.parent).as_posix() for file in files]
    data, table = _index(study, made, names), target.with_suffix(".csv")
    write_netcdf(data, target)
    write_whole(table, _csv(study, made, names), "study table")
    failed = {one.name: of.problem for one, of in zip(study.variants, made, strict=True) if of.problem}
    return ManyMaps(study, data, target, table, failed)


def map_files(study: Study, index: Path) -> list[Path]:
    """Paths of the maps of all variants, numbered from 1, in a folder next to the index."""
    digits = len(str(len(study.variants)))
    folder = index.with_suffix("")
    return [folder / f"{number + 1:0{digits}d}.h5" for number in range(len(study.variants))]


def _require_one_device(order: Recipe, study: Study) -> None:
    ours, theirs = read_recipe_device(order), device_of(study.device_document)
    if ours.texts != theirs.texts:
        must_hold = f"must name the device of the recipe, {order.device}"
        remedy = f'write recipe = "{order.path.name}" in the place of device, or take a recipe of its device'
        raise StudyError.of(f"{study.path}: device", must_hold, str(study.device_document.path), remedy)


class _Pieces:
    """Seconds of the finished maps and of all maps. The first map of an iron takes longer than the others."""

    def __init__(self, first: Sequence[bool]) -> None:
        self._first, self._left = first, [first.count(False), first.count(True)]
        self._seconds: tuple[list[float], list[float]] = ([], [])

    def count(self, index: int, seconds: float) -> None:
        """Note a finished map."""
        kind = self._first[index]
        self._left[kind] -= 1
        self._seconds[kind].append(seconds)

    @property
    def done(self) -> float:
        return sum(map(sum, self._seconds))

    @property
    def whole(self) -> float:
        known = [float(np.mean(of)) for of in self._seconds if of] or [1.0]
        means = [float(np.mean(of)) if of else known[0] for of in self._seconds]
        return self.done + sum(left * mean for left, mean in zip(self._left, means, strict=True))


def _groups(study: Study) -> list[list[int]]:
    """Numbers of the variants in groups of the same iron; in a group, variants that differ only in turns follow each
    other."""
    groups: dict[str, dict[str, list[int]]] = {}
    for number, variant in enumerate(study.variants):
        data = variant.document.data
        iron = {key: of for key, of in data.items() if key not in (*_NOT_OF_THE_IRON, "parameters")}
        coils = [{key: of for key, of in coil.items() if key != "turns"} for coil in data.get("coil", ())]
        of_iron, rest = (
            json.dumps(of, sort_keys=True, default=str) for of in (iron, [coils, data.get("workspace")])
        )
        groups.setdefault(of_iron, {}).setdefault(rest, []).append(number)
    return [[number for alike in group.values() for number in alike] for group in groups.values()]


def _job(recipe: Recipe, document: Document, resume: bool, accept_error: bool) -> _Job:
    return _Job(recipe, document, resume, accept_error, SharedSolves())


def _made(job: _Job, item: tuple[Sequence[tuple[str, Value]], str]) -> _Made:
    """Make one map, in a worker process."""
    settings, file = item
    device = device_of(changed(job.document, settings))
    with shown_or_silent("map", False) as say:
        path = make_map(job.recipe, device, file, job.resume, say, Workers(), job.accept_error, job.shared)
    info = read_info(path)
    grid, errors = info.grid, (info.error_bounds.get(_LOOKUP), info.current_error)
    pairs = [(np.nan, np.nan) if one is None else (one.flux_density, one.gradient) for one in errors]
    stated = [number for pair in pairs for number in pair]
    return _Made(stated, grid.lower.tolist(), grid.spacing.tolist(), grid.shape)


def _index(study: Study, made: Sequence[_Made], files: Sequence[str]) -> Any:
    """xarray.Dataset of names, errors and problems, with the axes of the study's own data set."""
    axes = tuple(axis.name for axis in study.axes) or ("variant",)
    columns: dict[str, tuple[list[Any], Any, dict[str, str]]] = {
        name: ([one.errors[k] for one in made], float, {"units": unit, "long_name": meaning})
        for k, (name, (unit, meaning)) in enumerate(_ERRORS.items())
    }
    columns["map_file"] = (list(files), object, {"long_name": "the map, relative to this file"})
    problems = [one.problem for one in made]
    columns["problem"] = (problems, object, {"long_name": "why there is no map; empty where there is one"})
    variables = {
        name: (axes, np.array(values, dtype=kind).reshape(study.shape), about)
        for name, (values, kind, about) in columns.items()
    }
    grids = {"nodes": "1", "lower": "m", "spacing": "m"}
    for name, unit in grids.items():
        values = np.array([getattr(one, name) for one in made]).reshape(*study.shape, 3)
        about = {"units": unit, "long_name": f"{name} of the map's grid along x, y, z"}
        variables[name] = ((*axes, "direction"), values, about)
    attributes = {
        "title": study.title,
        "Conventions": "CF-1.10",
        "source": f"fieldmap {library_versions()['fieldmap']}",
        "study_file": study.path.name,
    }
    return require_xarray().Dataset(variables, coords=variant_coordinates(study), attrs=attributes)


def _csv(study: Study, made: Sequence[_Made], files: Sequence[str]) -> str:
    heads = [f"{name} ({unit})" for name, (unit, _) in _ERRORS.items()]
    rows: list[list[Any]] = [[*variant_heads(study), "map_file", *heads, "problem"]]
    for number, (one, file) in enumerate(zip(made, files, strict=True)):
        errors = ["" if np.isnan(error) else repr(float(error)) for error in one.errors]
        rows.append([*study.settings(number).values(), file, *errors, one.problem])
    return csv_table(rows)
