"""Runs of a scenario in batches, one for each combination of values of the varied keys: the runs, the files that hold
them, and a batch in words."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from fieldmap.arguments import check
from fieldmap.control.blocks import Controller
from fieldmap.control.function_controller import FunctionController
from fieldmap.core.machine import TURN
from fieldmap.device import Device
from fieldmap.dynamics.closed_loop import simulate_many
from fieldmap.dynamics.loop_run import LevitationRun, as_csv, recorded, tilt_of
from fieldmap.dynamics.scenario.experiment import Experiment, ScenarioRun, prepare
from fieldmap.dynamics.scenario.metrics import RunMetrics, over_runs, reading_mm
from fieldmap.dynamics.scenario.references import AXES
from fieldmap.dynamics.scenario.schema import read_scenario
from fieldmap.field import Field
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record, count_of
from fieldmap.store import write_runs, write_whole
from fieldmap.typing import PathLike, Progress

MOST_KEPT = 50
"""Most runs in a batch for which signals are kept, for a file or a picture."""
# Largest lean of an upright body, degrees. A larger lean is mentioned in words.
_UPRIGHT = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class BatchRun(Record):
    """One run: its metrics, and its signals if they are kept."""

    metrics: RunMetrics
    run: ScenarioRun | None


@dataclass(frozen=True, eq=False, repr=False)
class Batch(Record):
    """Runs with one value of each varied key.

    Attributes
    ----------
    varied : these values by key; empty if no key varies.
    experiment : the experiment of the runs.
    runs : metrics of each run, and its signals if they are kept.
    seconds : processor time of the runs alone.
    """

    varied: Mapping[str, object]
    experiment: Experiment
    runs: tuple[BatchRun, ...]
    seconds: float

    @property
    def label(self) -> str:
        """The values in words: "KEY = VALUE, KEY = VALUE"."""
        return _label(self.varied)

    def to_dict(self) -> dict[str, Plain]:
        """The batch as plain Python, in SI units except for names that end in _mm and _deg."""
        names = ("sensed", "currents", "outputs", "residual")
        rest = {name: getattr(self.experiment.operating_point, name) for name in names}
        runs = [one.metrics for one in self.runs]
        return plain_items(
            value=self.label, varied=dict(self.varied), rest=rest, seconds=self.seconds, runs=runs
        )


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Record):
    """All batches of a scenario."""

    batches: tuple[Batch, ...]

    @property
    def first(self) -> Experiment:
        """The first experiment. Its title and assumptions hold for all."""
        return self.batches[0].experiment

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Those of the experiments, and the keys of the scenario that were changed for all."""
        return (*self.first.assumptions, *self.first.scenario.changed(but=self.batches[0].varied))

    @property
    def all_ended_early(self) -> bool:
        """Whether an event ended every run."""
        return all(one.metrics.event for batch in self.batches for one in batch.runs)

    def to_dict(self) -> dict[str, Plain]:
        """The simulation as plain Python, in SI units except for names that end in _mm and _deg."""
        return plain_items(
            scenario=self.first.scenario.path.name,
            title=self.first.scenario.contents.title,
            batches=[batch.to_dict() for batch in self.batches],
            assumptions=self.assumptions,
        )


def simulate_batches(
    scenario: PathLike,
    field: Callable[[], Field] | None = None,
    changes: Mapping[str, object] | None = None,
    vary: Mapping[str, Sequence[object]] | None = None,
    runs: int = 1,
    seed: int | None = None,
    threads: int = 0,
    keep_signals: bool = False,
    progress: Progress = lambda message, fraction: None,
    device: Device | None = None,
    controller: Controller | FunctionController | None = None,
) -> Simulation:
    """Run a scenario `runs` times, each with its own noise, for each combination of values of the varied keys.

    Parameters
    ----------
    scenario
        Path of the file, or the name of a shipped scenario.
    field
        Function that opens a map or any field, which replaces the scenario's map. It is called once, after
        the scenario was read.
    changes
        Values by dotted key that replace those of the file.
    vary
        Lists of values by dotted key; the last key changes fastest.
    runs
        Number of runs for each combination.
    seed
        Replaces the seed of the scenario.
    threads
        Number of threads; 0 for one per processor.
    keep_signals
        Keep the signals of the runs, if a batch has at most MOST_KEPT runs.
    progress
        progress(message, fraction) is called during the runs.
    device
        Replaces the map's device for a scenario that names none.
    controller
        Replaces the scenario's controller. A Python function runs on one thread.

    Returns
    -------
    Simulation
        The batches.

    Raises
    ------
    InputError
        As in `read_scenario` and `prepare`; all scenarios are read before the first one runs.
    """
    check(runs >= 1, "runs", "must be 1 or more", runs, "give a whole number")
    fixed, keys = dict(changes or {}), dict(vary or {})
    combinations = [dict(zip(keys, values, strict=True)) for values in product(*keys.values())]
    check(bool(combinations), "vary", "must have a value for every key", list(keys), "leave out empty keys")
    scenarios = [read_scenario(scenario, fixed | varied) for varied in combinations]
    opened = None if field is None else field()
    batches: list[Batch] = []
    for varied, read in zip(combinations, scenarios, strict=True):

        def part(message: str, fraction: float, label: str = _label(varied)) -> None:
            progress(f"{label} {message}".strip(), (len(batches) + fraction) / len(scenarios))

        experiment = prepare(read, opened, device if read.contents.device is None else None, controller)

        def judged(run: LevitationRun, experiment: Experiment = experiment) -> BatchRun:
            found = experiment.judged(run)
            return BatchRun(found.metrics, found if keep_signals and runs <= MOST_KEPT else None)

        experiment.warm()
        chosen = seed if seed is not None else read.settings.noise.seed or 0
        python = getattr(experiment.controller, "form", "") == "python"
        workers = 1 if python else threads or os.cpu_count() or 1
        begin = time.process_time()
        if runs == 1:
            found = [judged(experiment.run(chosen))]
        else:
            found = simulate_many(
                runs, experiment.run, seed=chosen, threads=workers, keep=judged, progress=part
            )
        batches.append(Batch(varied, experiment, tuple(found), time.process_time() - begin))
    return Simulation(tuple(batches))


def _label(varied: Mapping[str, object]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in varied.items())


def write_simulation(path: PathLike, simulation: Simulation) -> Path:
    """Write the kept signals as .h5, or those of a single run as .csv."""
    records = [
        recorded(
            one.run,
            batch.experiment.device.coil_names,
            {"value": batch.label, "zero_depth_mm": batch.experiment.scenario.zero_depth_mm},
        )
        for batch in simulation.batches
        for one in batch.runs
        if one.run is not None
    ]
    path = Path(path)
    if path.suffix == ".csv":
        return write_whole(path, as_csv(records[0]), "recorded run")
    scenario = simulation.first.scenario
    about = {
        "device": simulation.first.device.text,
        "title": scenario.contents.title,
        "scenario": scenario.text,
        "changes": str(dict(scenario.changes)),
    }
    return write_runs(path, records, about)


def batch_words(batch: Batch) -> Iterator[tuple[str, str]]:
    """Statements about a batch.

    Parameters
    ----------
    batch : Batch
        Runs with one value of each varied key.

    Yields
    ------
    tuple of str
        The subject, such as "at rest" or "events", and a statement. A subject may come several times.
    """
    scenario, rest = batch.experiment.scenario, batch.experiment.operating_point
    # The force may jump over zero between cells of a coarse map.
    left = f"; {rest.residual:.0e} of the weight left" if rest.residual > 1e-6 else ""
    x, y, depth = reading_mm(scenario, rest.sensed)
    lean = float(np.degrees(tilt_of(rest.state[TURN : TURN + 4])))
    leans = f", leaning {lean:.1f} degrees" if lean > _UPRIGHT else ""
    amperes = ", ".join(f"{value:.4g}" for value in rest.currents)
    runs = [one.metrics for one in batch.runs]
    speed = sum(one.end_s for one in runs) / max(batch.seconds, 1e-9)
    if batch.label:
        yield "value", batch.label
    yield "at rest", f"x {x:.3f}, y {y:.3f}, depth {depth:.3f} mm{leans}; currents {amperes} A{left}"
    yield (
        "simulated",
        f"{count_of(len(runs), 'run', 'runs')} of {scenario.contents.duration_s:g} s in {batch.seconds:.2f} s of "
        f"one processor: {speed:.0f} times real time",
    )
    for text in _events(runs):
        yield "events", text
    for text in _not_settled(runs):
        yield "settling", text
    lean, current = max(one.largest_lean_deg for one in runs), max(one.largest_current_A for one in runs)
    yield "largest", f"lean {lean:.2f} degrees, current {current:.3f} A"
    for text in _iron(runs):
        yield "iron", text
    for text in _windings(runs):
        yield "windings", text


def _events(runs: list[RunMetrics]) -> Iterator[str]:
    names = dict.fromkeys(one.event for one in runs if one.event)
    for name in names:
        ended = [one for one in runs if one.event == name]
        yield f"{name}: {len(ended)}, {_first(ended)}"
    if not names:
        yield "none"
    words = {"currents": "currents beyond those of the map, where its iron is extrapolated"}
    for name in sorted({name for one in runs for name in one.touched}):
        yield words.get(name, f"touched the {name}")


def _first(ended: list[RunMetrics]) -> str:
    """Time, position, speed and currents at the earliest end of the runs."""
    first = min(ended, key=lambda metrics: metrics.end_s)
    x, y, depth = first.end_mm
    speed, amperes = np.linalg.norm(first.end_mm_per_s), ", ".join(f"{value:.3g}" for value in first.end_A)
    return (
        f"first at {first.end_s:.3f} s: x {x:.2f}, y {y:.2f}, depth {depth:.2f} mm, "
        f"{speed:.3g} mm/s; currents {amperes} A"
    )


def _not_settled(runs: list[RunMetrics]) -> Iterator[str]:
    """A line for each axis that does not settle after its step, in runs that no event ended."""
    whole = [one for one in runs if not one.event]
    for k, axis in enumerate(AXES):
        steps = [step for one in whole if (step := one.axes[k].step) is not None]
        left = [step.steady_rms for step in steps if not np.isfinite(step.settling_time)]
        if left:
            off = f"{over_runs(left):.3g} mm RMS off over the last quarter"
            yield f"{axis} does not settle within 2 % of its step{_of_runs(len(left), len(whole))}: {off}"


def _windings(runs: list[RunMetrics]) -> Iterator[str]:
    """Statements about temperatures of the windings of coupled coils; none if they do not warm up."""
    hottest = [one.hottest_degC for one in runs if one.hottest_degC is not None]
    times = [one.too_hot_s for one in runs if one.too_hot_s is not None]
    if hottest:
        yield f"{max(hottest):.1f} degC at most"
    if times:
        yield f"WARNING: hotter than their limit from {min(times):.3g} s on{_of_runs(len(times), len(runs))}"


def _of_runs(some: int, whole: int) -> str:
    return "" if whole == 1 else f" in {some} of {whole} runs"


def _iron(runs: list[RunMetrics]) -> Iterator[str]:
    """Statements about the solves of saturating iron; none if there were no solves."""
    solves = sum(one.iron.solves for one in runs)
    steps = sum(one.iron.newton_steps for one in runs)
    unsolved = sum(one.iron.unsolved for one in runs)
    if solves:
        each = f"{steps / solves:.2f} Newton steps each"
        yield f"solved at {solves} steps, {each}; {unsolved} did not converge"
    if unsolved:
        yield f"WARNING: at {unsolved} steps the iron stayed as it was at the step before"
