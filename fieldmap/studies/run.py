"""Solve all variants of a study, continue earlier runs, and write the results as NetCDF and as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fieldmap.arguments import raise_all
from fieldmap.device.changes import changed
from fieldmap.device.reader import device_of
from fieldmap.errors import StudyError
from fieldmap.extras import require
from fieldmap.parallel import Common, Workers
from fieldmap.plain import Plain, plain_items
from fieldmap.progress import Forecast, rate
from fieldmap.provenance import library_versions
from fieldmap.records import Record
from fieldmap.store import Checkpoint, checkpoint_path, write_whole
from fieldmap.store.output_formats import output_problems
from fieldmap.store.whole_files import whole_file
from fieldmap.studies.quantities import NEED_PAYLOAD, number_names, recorded
from fieldmap.studies.reading import read_study
from fieldmap.studies.study import Study, Value
from fieldmap.studies.variant_result import COPPER_WINDINGS, Row, Task, VariantResult, solve_variant
from fieldmap.typing import Array, PathLike, Progress

OUTPUT_FOLDER = Path("maps/out")
# Entry of the checkpoint for a failed variant that is to be solved again.
_TRIED_AGAIN = {"tried_again": True}


@dataclass(frozen=True, eq=False, repr=False)
class StudyRow(Record):
    """One variant at one set of currents.

    settings: varied keys in their units, or the variant's name; currents: name of the set; numbers: recorded numbers,
    SI units, NaN where missing; problem: the reason, or "".
    """

    settings: dict[str, Value]
    currents: str
    numbers: dict[str, Array]
    problem: str


@dataclass(frozen=True, eq=False, repr=False)
class StudyRun(Record):
    """A finished study. data: xarray.Dataset; path, table: of the NetCDF and the CSV file. failed: variants with a
    reason why a number is missing, by their names."""

    study: Study
    data: Any
    path: Path
    table: Path
    failed: dict[str, tuple[str, ...]]

    def rows(self) -> list[StudyRow]:
        """One row for each variant and set of currents, in the order of the data set."""
        study, found = self.study, []
        names = [axis.name for axis in study.axes] or ["variant"]
        recorded_names = [quantity.name for quantity in recorded(study.record.groups)]
        for v, variant in enumerate(study.variants):
            here = self.data.isel(dict(zip(names, variant.place, strict=True)))
            for entry in study.current_sets:
                at = here.sel(currents=entry.name)
                numbers = {quantity: np.asarray(at[quantity].values) for quantity in recorded_names}
                found.append(StudyRow(study.settings(v), entry.name, numbers, str(at["problem"].item())))
        return found

    def to_dict(self) -> dict[str, Plain]:
        """Title, rows and failures as plain Python, in SI units; varied keys in their own units."""
        rows = [
            row.settings | {"currents": row.currents} | row.numbers | {"problem": row.problem}
            for row in self.rows()
        ]
        return plain_items(title=self.study.title, rows=rows, failed=self.failed)


def run_study(
    study: PathLike | Study,
    output: PathLike | None = None,
    resume: bool = True,
    retry: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> StudyRun:
    """Solve every variant of a study at all its currents, and write the results as NetCDF and as CSV.

    A variant that fails is recorded with its reason and does not stop the others.

    Parameters
    ----------
    study
        Path of a study file, name of a shipped one, or a `Study`.
    output
        The NetCDF file, with a CSV file of the same name; maps/out/NAME.nc unless given.
    resume
        Keep the variants of an earlier run, if everything that determines their numbers is the same; the data
        are then those of an uninterrupted run.
    retry
        Solve failed variants again.
    workers
        Processes that solve: `fieldmap.parallel.Workers`.
    progress
        Called as progress(message, fraction) between steps.
    scheduler
        Address of a dask scheduler whose workers solve.

    Returns
    -------
    StudyRun
        The data, and where they were written.

    Raises
    ------
    StudyError or InputError
        Before any long work, without leaving a file.
    FieldmapError
        If xarray or h5netcdf is missing.

    Examples
    --------
    >>> import fieldmap.studies
    >>> run = fieldmap.studies.run_study("pole_disk")                             # doctest: +SKIP
    >>> run.data.equilibrium_area.sel(currents="equal", thickness=6.0)            # doctest: +SKIP
    """
    require_xarray()
    order = study if isinstance(study, Study) else read_study(Path(study))
    if not order.current_sets:
        must_hold, remedy = "numbers are recorded at sets of currents", "add a table [[currents]]"
        raise StudyError.of(f"{order.path}: currents", must_hold, "none", remedy)
    target = output_file(order.path, output)
    say = progress or (lambda message, fraction: None)
    with (
        Workers(workers, scheduler) as team,
        Checkpoint(checkpoint_path(target, stays=True), order.fingerprint, resume) as checkpoint,
    ):
        done = finished_variants(checkpoint)
        if retry:
            _forget_failed(done, checkpoint)
        _solve(order, done, checkpoint, team, say)
        results = [done[number] for number in range(len(order.variants))]
    columns = _columns(order, results)
    data = _data_set(order, results, columns)
    table = target.with_suffix(".csv")
    write_netcdf(data, target)
    write_whole(table, _csv_text(order, results, columns), "study table")
    say("complete", 1.0)
    return StudyRun(order, data, target, table, _failed(order, results))


def _solve(
    study: Study, finished: dict[int, VariantResult], checkpoint: Checkpoint, team: Workers, say: Progress
) -> None:
    """Solve the variants that are not finished, and add them to `finished` and to the checkpoint."""
    total = len(study.variants)
    waiting = [number for number in range(total) if number not in finished]
    resumed = total - len(waiting)
    forecast = Forecast(say, {"variants": len(waiting)}, team.processes)
    begun = f"resumed with {resumed} of {total} variants" if resumed else f"solving {total} variants"
    forecast.at("variants", begun)
    # The device file is sent once, and for each variant only the keys that it changes.
    common = Common.of(Task(study.device_document, study.current_sets, study.iron, study.record))
    for outcome in team.map(_solved, [study.variants[number].settings for number in waiting], common):
        number = waiting[outcome.index]
        result = outcome.value
        if result is None:  # every process that tried it died
            rows = tuple(Row({}, (f"variant: {outcome.reason}",)) for _ in study.current_sets)
            result = VariantResult(rows)
        checkpoint.put(str(number), about=asdict(result))
        finished[number] = result
        done = len(finished) - resumed
        name, pace = study.variants[number].name, rate(done, forecast.taken(), "variant")
        forecast.at("variants", f"{len(finished)} of {total} variants: {name}{pace}", done, len(waiting))


def _solved(task: Task, settings: Iterable[tuple[str, Value]]) -> VariantResult:
    return solve_variant(replace(task, document=changed(task.document, settings)))


def finished_variants(checkpoint: Checkpoint) -> dict[int, VariantResult]:
    """The variants in the checkpoint of a study, by number, without those that are to be solved again."""
    found = {}
    for key in checkpoint:
        piece = checkpoint.get(key)
        assert piece is not None
        if piece.about != _TRIED_AGAIN:
            rows = tuple(Row(row["numbers"], tuple(row["problems"])) for row in piece.about["rows"])
            found[int(key)] = VariantResult(rows, tuple(piece.about["assumptions"]))
    return found


def _forget_failed(finished: dict[int, VariantResult], checkpoint: Checkpoint) -> None:
    """Remove failed variants from `finished` and from the checkpoint, so that a run that is killed before it has solved
    them again leaves them to the next."""
    for number in [k for k, result in finished.items() if any(row.problems for row in result.rows)]:
        checkpoint.put(str(number), about=_TRIED_AGAIN)
        del finished[number]


def _failed(study: Study, results: list[VariantResult]) -> dict[str, tuple[str, ...]]:
    told = (tuple(dict.fromkeys(why for row in one.rows for why in row.problems)) for one in results)
    return {variant.name: why for variant, why in zip(study.variants, told, strict=True) if why}


def output_file(study: Path, output: PathLike | None) -> Path:
    """The NetCDF file of a study: as given, or named after the study file. Raises InputError as `checked_output`."""
    return checked_output(OUTPUT_FOLDER / f"{study.stem}.nc" if output is None else Path(output))


def checked_output(target: Path) -> Path:
    """The NetCDF file of a study or a search. Raises InputError if it or its CSV file cannot be written."""
    problems = output_problems(str(target), target, ["study"])
    table = target.with_suffix(".csv")
    raise_all(problems or output_problems(str(table), table, ["study table"]))
    return target


_CONVENTIONS = "SI units. Right-handed frame of the device file, z up. gradient: dB_component/dx_direction."
_OF_THE_PAYLOAD = (
    "the payload is a vertical point dipole at the magnet's centre and does not magnetise the iron",
    "the currents are constant",
)


def require_xarray() -> ModuleType:
    """The module xarray. Raises FieldmapError, with the extra to install, if xarray or h5netcdf is missing."""
    require("h5netcdf", "studies", "fieldmap.studies")
    return require("xarray", "studies", "fieldmap.studies")


def write_netcdf(data: Any, path: Path) -> None:
    """Write the data set; the file appears complete or not at all."""
    with whole_file(path, "study") as partial:
        data.to_netcdf(partial, engine="h5netcdf")


def _data_set(study: Study, results: Sequence[VariantResult], columns: Mapping[str, Array]) -> Any:
    """xarray.Dataset of all variants: one axis for each varied key (or `variant`), then `currents`: docs/studies.md."""
    leading = (*(tuple(axis.name for axis in study.axes) or ("variant",)), "currents")
    shape = (*study.shape, len(study.current_sets))
    variables = {}
    for quantity in recorded(study.record.groups):
        values = columns[quantity.name]
        values = values.reshape(*shape, *values.shape[2:])
        attributes = {"units": quantity.unit, "long_name": quantity.meaning}
        variables[quantity.name] = ((*leading, *quantity.axes), values, attributes)
    reasons = [[" || ".join(row.problems) for row in result.rows] for result in results]
    about = {"long_name": "why numbers of this variant are missing; empty where nothing failed"}
    variables["problem"] = (leading, np.array(reasons, dtype=object).reshape(shape), about)
    variables |= _files(study)
    return require_xarray().Dataset(variables, coords=_coordinates(study), attrs=_attributes(study, results))


def _columns(study: Study, results: Sequence[VariantResult]) -> dict[str, Array]:
    """Each quantity (variants, currents, axes of the quantity); NaN where there is no number."""
    found = {}
    for quantity in recorded(study.record.groups):
        missing = np.full([len(study.labels[axis]) for axis in quantity.axes], np.nan)
        rows = [[row.numbers.get(quantity.name, missing) for row in result.rows] for result in results]
        found[quantity.name] = np.array(rows, dtype=float)
    return found


def _files(study: Study) -> dict[str, Any]:
    """The files as read. They are variables, because an attribute of HDF5 holds at most 64 kB."""
    device = device_of(study.device_document)
    included = json.dumps(dict(sorted(device.included.items())))
    texts = {
        "study_file": (study.text, "the study file as read"),
        "device_file": (device.text, "the device file as read, before any key was changed"),
        "included_files": (included, "files that the device file names, as JSON: name to text or hash"),
    }
    return {name: ((), text, {"long_name": meaning}) for name, (text, meaning) in texts.items()}


def variant_coordinates(study: Study) -> dict[str, Any]:
    """Coordinates of the data set along the varied keys, or along the variants one by one."""
    if not study.axes:
        return {"variant": ("variant", [variant.name for variant in study.variants])}
    about = {
        axis.name: {"long_name": axis.key} | ({"units": axis.unit} if axis.unit else {})
        for axis in study.axes
    }
    return {axis.name: (axis.name, np.array(axis.values), about[axis.name]) for axis in study.axes}


def variant_heads(study: Study) -> list[str]:
    """Headings of the columns of varied keys."""
    return [f"{axis.name} ({axis.unit})" if axis.unit else axis.name for axis in study.axes] or ["variant"]


def _coordinates(study: Study) -> dict[str, Any]:
    found: dict[str, Any] = {"currents": ("currents", [entry.name for entry in study.current_sets])}
    found |= variant_coordinates(study)
    axes = {axis for quantity in recorded(study.record.groups) for axis in quantity.axes}
    found |= {axis: (axis, list(study.labels[axis])) for axis in sorted(axes - {"point"})}
    if "point" in axes:
        for k, letter in enumerate("xyz"):
            found[f"point_{letter}"] = ("point", study.record.points[:, k], {"units": "m"})
    return found


def _attributes(study: Study, results: Sequence[VariantResult]) -> dict[str, str]:
    carries = any(entry.common is None for entry in study.current_sets)
    carried = carries or NEED_PAYLOAD & set(study.record.groups)
    assumed = dict.fromkeys(text for result in results for text in result.assumptions)
    if "power" in study.record.groups:
        assumed[COPPER_WINDINGS] = None
    limit, versions = study.record.current_limit, library_versions("xarray", "h5netcdf")
    return {
        "title": study.title,
        "Conventions": "CF-1.10",
        "comment": _CONVENTIONS,
        "source": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "assumptions": "\n".join((*(_OF_THE_PAYLOAD if carried else ()), *assumed)),
        "force_share": f"{study.record.force_share!r}",
        "current_limit_A": "none" if limit is None else f"{limit!r}",
        "iron": repr(study.iron),
        "fingerprint": study.fingerprint,
    }


def _csv_text(study: Study, results: Sequence[VariantResult], columns: Mapping[str, Array]) -> str:
    """One line for each variant and set of currents; every number of the data set, units in the header.

    A column is NAME [axis labels] (unit): `flux_density 1 z (T)` is B_z at the first point, `current 5 (A)` of coil 5.
    """
    names = number_names(study.record.groups, study.labels)
    heads = [f"{name} ({quantity.unit})" for name, (quantity, _) in names.items()]
    rows: list[list[Any]] = [[*variant_heads(study), "currents", *heads, "problem"]]
    for v, result in enumerate(results):
        values = study.settings(v).values()
        for c, (entry, row) in enumerate(zip(study.current_sets, result.rows, strict=True)):
            numbers = [float(columns[quantity.name][(v, c, *at)]) for quantity, at in names.values()]
            cells = ["" if np.isnan(number) else repr(number) for number in numbers]
            rows.append([*values, entry.name, *cells, " || ".join(row.problems)])
    return csv_table(rows)


def csv_table(rows: Iterable[Sequence[Any]]) -> str:
    """Rows as the text of a CSV file."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
