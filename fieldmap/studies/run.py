"""Solve all variants of a study and write its data set, with what earlier runs have done."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.parallel import Workers
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.store import Checkpoint, checkpoint_path, write_whole
from fieldmap.studies.data_set import csv_text, data_set, require_xarray, write_netcdf
from fieldmap.studies.quantities import recorded
from fieldmap.studies.reading import read_study
from fieldmap.studies.study import Study, Value
from fieldmap.studies.variant_result import Row, Task, VariantResult, solve_variant
from fieldmap.typing import Array, PathLike, Progress

OUTPUT_FOLDER = Path("maps/out")
# Stands in the checkpoint for a failed variant that is to be solved again.
_TRIED_AGAIN = {"tried_again": True}


@dataclass(frozen=True, eq=False, repr=False)
class StudyRow(Record):
    """One variant at one set of currents.

    settings: varied keys in their units, or the variant's name; currents: name of the set; numbers: what was recorded,
    SI units, NaN where it is missing; problem: why, or "".
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
        axes = self.study.axes
        names = [axis.name for axis in axes] or ["variant"]
        recorded_names = [quantity.name for quantity in recorded(self.study.record.groups)]
        found = []
        for variant in self.study.variants:
            here = self.data.isel(dict(zip(names, variant.place, strict=True)))
            about: dict[str, Value] = {
                axis.name: axis.values[k] for axis, k in zip(axes, variant.place, strict=False)
            } or {"variant": variant.name}
            for name in self.data.currents.values:
                at = here.sel(currents=name)
                numbers = {quantity: np.asarray(at[quantity].values) for quantity in recorded_names}
                found.append(StudyRow(about, str(name), numbers, str(at["problem"].item())))
        return found

    def to_dict(self) -> dict[str, Plain]:
        """Title, rows and failures as plain Python: SI units, but varied keys in theirs."""
        rows = [
            row.settings | {"currents": row.currents} | row.numbers | {"problem": row.problem}
            for row in self.rows()
        ]
        return plain_items(title=self.study.title, rows=rows, failed=self.failed)


def run_study(
    study: str | PathLike | Study,
    output: str | PathLike | None = None,
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
    target = output_file(order.path, output)
    say = progress or (lambda message, fraction: None)
    with (
        Workers(workers, scheduler) as team,
        Checkpoint(checkpoint_path(target), order.fingerprint, resume) as checkpoint,
    ):
        done = finished_variants(checkpoint)
        if retry:
            _forget_failed(done, checkpoint)
        _solve(order, done, checkpoint, team, say)
        results = [done[number] for number in range(len(order.variants))]
    data = data_set(order, results)
    table = target.with_suffix(".csv")
    write_netcdf(data, target)
    write_whole(table, csv_text(order, results).encode())
    say("complete", 1.0)
    return StudyRun(order, data, target, table, _failed(order, results))


def _solve(
    study: Study, finished: dict[int, VariantResult], checkpoint: Checkpoint, team: Workers, say: Progress
) -> None:
    """Solve the variants that are not among the finished ones; put them there, and into the checkpoint."""
    total = len(study.variants)
    waiting = [number for number in range(total) if number not in finished]
    resumed = total - len(waiting)
    say(f"resumed with {resumed} of {total} variants" if resumed else f"solving {total} variants", 0.0)
    for outcome in team.map(solve_variant, [task_of(study, number) for number in waiting]):
        number = waiting[outcome.index]
        result = outcome.value
        if result is None:  # every process that tried it died
            rows = tuple(Row({}, (f"variant: {outcome.reason}",)) for _ in study.current_sets)
            result = VariantResult(rows)
        checkpoint.put(str(number), about=asdict(result))
        finished[number] = result
        share = (len(finished) - resumed) / len(waiting)
        say(f"{len(finished)} of {total} variants: {study.variants[number].name}", share)


def finished_variants(checkpoint: Checkpoint) -> dict[int, VariantResult]:
    """The variants in the checkpoint of a study, by number, without those that a run has begun to try again."""
    found = {}
    for key in checkpoint:
        piece = checkpoint.get(key)
        assert piece is not None
        if piece.about != _TRIED_AGAIN:
            rows = tuple(Row(row["numbers"], tuple(row["problems"])) for row in piece.about["rows"])
            found[int(key)] = VariantResult(rows, tuple(piece.about["assumptions"]))
    return found


def _forget_failed(finished: dict[int, VariantResult], checkpoint: Checkpoint) -> None:
    """Take the variants that failed out of the finished ones and out of the checkpoint, so that a run that is killed
    before it has tried them again leaves them to the next."""
    for number in [k for k, result in finished.items() if any(row.problems for row in result.rows)]:
        checkpoint.put(str(number), about=_TRIED_AGAIN)
        del finished[number]


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


def output_file(study: Path, output: str | PathLike | None) -> Path:
    """The NetCDF file of a study file: as asked, or of its name. Raises InputError for one that cannot be it."""
    target = OUTPUT_FOLDER / f"{study.stem}.nc" if output is None else Path(output)
    if target.suffix != ".nc":
        remedy = "write for example --output maps/out/study.nc; the CSV is put beside it"
        raise InputError(Problem(str(target), "must be a file name that ends in .nc", target.name, remedy))
    if target.is_dir():
        raise InputError(Problem(str(target), "must be a file", "a directory", "name the file inside it"))
    return target
