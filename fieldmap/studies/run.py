"""Solve all variants of a study and write its data set, with what earlier runs have done."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from fieldmap.errors import InputError, Problem
from fieldmap.parallel import Workers
from fieldmap.studies.data_set import csv_text, data_set, require_xarray, write_netcdf
from fieldmap.studies.journal import Journal
from fieldmap.studies.reading import read_study
from fieldmap.studies.study import Study
from fieldmap.studies.summary import Row, Task, VariantResult, solve_variant

Progress = Callable[[str, float], None]
OUTPUT_FOLDER = Path("maps/out")


@dataclass(frozen=True, eq=False)
class StudyRun:
    """A finished study. data: xarray.Dataset; path, table: of the NetCDF and the CSV file. failed: variants with a
    reason why a number is missing, by their names."""

    study: Study
    data: Any
    path: Path
    table: Path
    failed: dict[str, tuple[str, ...]]


def run_study(
    study: str | PathLike[str] | Study,
    output: str | PathLike[str] | None = None,
    resume: bool = True,
    retry: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> StudyRun:
    """Solve every variant of a study at all its currents, and write OUTPUT (NetCDF) and the same as CSV beside it.

    study: path of a study file, name of a shipped one, or what `read_study` returns. output: maps/out/NAME.nc unless
    given. resume: keep the variants of an earlier run, if everything that decides their numbers is the same; the data
    are those of a run without a break. retry: solve those again that failed. workers, scheduler: who solves
    them, `fieldmap.parallel.Workers`. progress(message, fraction) is called as the work goes on.

    A variant that fails is recorded with its reason and the others go on. Raises StudyError or InputError before any
    long work and without leaving a file, FieldmapError where xarray or h5netcdf are missing.

    >>> import fieldmap.studies
    >>> run = fieldmap.studies.run_study("pole_disk")                             # doctest: +SKIP
    >>> run.data.equilibrium_area.sel(currents="equal", thickness=6.0)            # doctest: +SKIP
    """
    require_xarray()
    order = study if isinstance(study, Study) else read_study(Path(study))
    target = _target(order, output)
    say = progress or (lambda message, fraction: None)
    with (
        Workers(workers, scheduler) as team,
        Journal(target, order.fingerprint, resume, retry) as journal,
    ):
        _solve(order, journal, team, say)
        results = [journal.done[number] for number in range(len(order.variants))]
    data = data_set(order, results)
    table = target.with_suffix(".csv")
    write_netcdf(data, target)
    _write_text(table, csv_text(order, results))
    say("complete", 1.0)
    return StudyRun(order, data, target, table, _failed(order, results))


def _solve(study: Study, journal: Journal, team: Workers, say: Progress) -> None:
    """The variants that are not done, kept as they come."""
    total = len(study.variants)
    waiting = [number for number in range(total) if number not in journal.done]
    resumed = total - len(waiting)
    words = f"resumed with {resumed} of {total} variants" if resumed else f"solving {total} variants"
    say(words, 0.0)
    for outcome in team.map(solve_variant, [task_of(study, number) for number in waiting]):
        number = waiting[outcome.index]
        result = outcome.value
        if result is None:  # every process that tried it died
            rows = tuple(Row({}, (f"variant: {outcome.reason}",)) for _ in study.current_sets)
            result = VariantResult(rows)
        journal.keep(number, result)
        done = len(journal.done) - resumed
        say(f"{len(journal.done)} of {total} variants: {study.variants[number].name}", done / len(waiting))


def task_of(study: Study, number: int) -> Task:
    """All that solving one variant needs."""
    return Task(study.variants[number].document, study.current_sets, study.iron, study.record)


def _failed(study: Study, results: list[VariantResult]) -> dict[str, tuple[str, ...]]:
    found = {}
    for variant, result in zip(study.variants, results, strict=True):
        reasons = tuple(dict.fromkeys(reason for row in result.rows for reason in row.problems))
        if reasons:
            found[variant.name] = reasons
    return found


def _target(study: Study, output: str | PathLike[str] | None) -> Path:
    target = OUTPUT_FOLDER / f"{study.path.stem}.nc" if output is None else Path(output)
    if target.suffix != ".nc":
        remedy = "write for example --output maps/out/study.nc; the CSV is put beside it"
        raise InputError(Problem(str(target), "must be a file name that ends in .nc", target.name, remedy))
    if target.is_dir():
        raise InputError(Problem(str(target), "must be a file", "a directory", "name the file inside it"))
    return target


def _write_text(path: Path, text: str) -> None:
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    partial.write_text(text, encoding="utf-8", newline="")
    os.replace(partial, path)
