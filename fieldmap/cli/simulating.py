"""What `fieldmap simulate` does: scenarios, runs, files."""

import os
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.cli.arguments import output_problems
from fieldmap.dynamics import simulate_many
from fieldmap.dynamics.loop_run import LevitationRun, as_csv, recorded
from fieldmap.dynamics.scenario import Experiment, RunMetrics, prepare, read_scenario, reading_mm, run_metrics
from fieldmap.errors import InputError, Problem

# Runs that a picture or a file keeps all signals of.
MOST_KEPT = 50
_PICTURES = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class Wanted:
    """The command line."""

    scenario: str
    map_file: Path | None
    output: Path | None
    save: Path | None
    runs: int
    seed: int | None
    threads: int
    changes: tuple[str, ...]
    vary: str | None


@dataclass(frozen=True, eq=False)
class Result:
    """One run: its metrics, and its signals if they are kept."""

    metrics: RunMetrics
    run: LevitationRun | None


@dataclass(frozen=True, eq=False)
class Batch:
    """Runs of one set of values. label: the varied value, or ""; seconds: of processors, for the runs alone."""

    label: str
    experiment: Experiment
    results: tuple[Result, ...]
    seconds: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """All batches, and the files that were written."""

    wanted: Wanted
    batches: tuple[Batch, ...]
    written: tuple[Path, ...]


def check_wanted(wanted: Wanted) -> None:
    """Everything that can be wrong with the command line, before any work. Raises InputError."""
    problems = []
    if wanted.runs < 1:
        problems.append(Problem("--runs", "must be 1 or more", str(wanted.runs), "give a whole number"))
    problems += output_problems("--output", wanted.output, (".h5", ".csv"))
    several = wanted.runs > 1 or wanted.vary is not None
    if wanted.output is not None and wanted.output.suffix == ".csv" and several:
        problems.append(Problem("--output", "a .csv file holds one run", "several runs", "take .h5"))
    problems += output_problems("--save", wanted.save, _PICTURES)
    if problems:
        raise InputError(*problems)


def simulate_all(wanted: Wanted, progress: Callable[[str, float], None]) -> Outcome:
    """Every run of every value, and the files asked for."""
    fixed = dict(pair(text, "--set") for text in wanted.changes)
    key, values = ("", [None]) if wanted.vary is None else _values(wanted.vary)
    batches = []
    opened = None
    for number, value in enumerate(values):
        changes = fixed if value is None else {**fixed, key: value}
        scenario = read_scenario(wanted.scenario, changes)
        if wanted.map_file is not None and opened is None:
            opened = opened_map(wanted.map_file)
        experiment = prepare(scenario, opened)
        label = "" if value is None else f"{key} = {value}"

        def part(message: str, fraction: float, number: int = number, label: str = label) -> None:
            progress(f"{label} {message}".strip(), (number + fraction) / len(values))

        batches.append(_batch(wanted, experiment, label, part))
    return Outcome(wanted, tuple(batches), tuple(_files(wanted, batches)))


def _batch(
    wanted: Wanted, experiment: Experiment, label: str, progress: Callable[[str, float], None]
) -> Batch:
    scenario = experiment.scenario
    seed = wanted.seed if wanted.seed is not None else scenario.contents.noise.seed or 0
    keep_all = wanted.runs <= MOST_KEPT and (wanted.output is not None or wanted.save is not None)

    def keep(run: LevitationRun) -> Result:
        return Result(run_metrics(scenario, run), run if keep_all else None)

    experiment.warm()
    begin = time.process_time()
    if wanted.runs == 1:
        results = [keep(experiment.run(seed))]
    else:
        threads = wanted.threads or os.cpu_count() or 1
        results = simulate_many(
            wanted.runs, experiment.run, seed=seed, threads=threads, keep=keep, progress=progress
        )
    return Batch(label, experiment, tuple(results), time.process_time() - begin)


def opened_map(path: Path) -> Any:
    """A map that answers for currents beyond its table too."""
    from fieldmap.cli.opening import check_map_path
    from fieldmap.lookup import open_map

    return open_map(check_map_path(str(path)), outside_currents="evaluate")


def pair(text: str, option: str) -> tuple[str, Any]:
    """KEY=VALUE; raises InputError for anything else."""
    key, sign, value = text.partition("=")
    if not (sign and key.strip() and value.strip()):
        raise InputError(Problem(option, "must be KEY=VALUE", text, "write for example control.z.Kc=0.2"))
    return key.strip(), _value(value.strip())


def _values(text: str) -> tuple[str, list[Any]]:
    key, sign, values = text.partition("=")
    parts = [part for part in values.split(",") if part.strip()]
    if not (sign and key.strip() and parts):
        raise InputError(
            Problem("--vary", "must be KEY=A,B,...", text, "write for example control.z.Kc=0.2,0.334,0.5")
        )
    return key.strip(), [_value(part.strip()) for part in parts]


def _value(text: str) -> Any:
    """As TOML would read it; a text without quotes stays a text."""
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        return text


def _files(wanted: Wanted, batches: list[Batch]) -> list[Path]:
    written = []
    if wanted.output is not None:
        written.append(_write(wanted.output, batches))
    if wanted.save is not None:
        from fieldmap.plot.runs import save_run_figure

        first = batches[0].experiment.scenario
        pictures = [_picture(batch, result) for batch in batches for result in batch.results if result.run]
        written.append(save_run_figure(wanted.save, first.contents.title, pictures))
    return written


def _write(path: Path, batches: list[Batch]) -> Path:
    from fieldmap.store import write_runs

    records = [
        recorded(result.run, batch.experiment.device.coil_names, {"value": batch.label})
        for batch in batches
        for result in batch.results
        if result.run is not None
    ]
    scenario = batches[0].experiment.scenario
    if path.suffix == ".csv":
        path.write_text(as_csv(records[0]))
        return path
    about = {
        "device": batches[0].experiment.device.text,
        "title": scenario.contents.title,
        "scenario": scenario.text,
        "changes": str(dict(scenario.changes)),
    }
    return write_runs(path, records, about)


def _picture(batch: Batch, result: Result) -> dict[str, Any]:
    scenario, run = batch.experiment.scenario, result.run
    assert run is not None
    empty = np.zeros((1, 3))
    some = len(run.time) > 0
    return {
        "time": run.time if some else np.zeros(1),
        "wanted": reading_mm(scenario, run.references) if some else empty,
        "true": reading_mm(scenario, run.sensed) if some else empty,
        "seen": reading_mm(scenario, run.seen) if some else empty,
        "currents": run.currents if some else np.zeros((1, run.coils)),
        "coil_names": batch.experiment.device.coil_names,
        "event": result.metrics.event,
    }
