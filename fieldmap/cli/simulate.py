"""`fieldmap simulate`: run a scenario, once or many times."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json, ScenarioArgument, ScenarioMap, device_of_option, field_opener

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.table import Table

    from fieldmap.cli.printing import Section
    from fieldmap.control import FunctionController
    from fieldmap.dynamics.scenario import Batch, LaidLog, RunMetrics, Simulation
    from fieldmap.plot.runs import DrawnRun
    from fieldmap.typing import Array

_PICTURES = (".png", ".svg", ".pdf")


def simulate(
    scenario: ScenarioArgument,
    map_file: ScenarioMap = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write the runs: .h5, or .csv of a single run."),
    ] = None,
    save: Annotated[
        Path | None, typer.Option("--save", metavar="FILE", help="Save a plot: .png, .svg or .pdf.")
    ] = None,
    runs: Annotated[
        int, typer.Option("--runs", metavar="N", help="Number of runs, each with its own noise.")
    ] = 1,
    seed: Annotated[
        int | None, typer.Option("--seed", metavar="N", help="Seed of the noise, in place of the scenario's.")
    ] = None,
    threads: Annotated[
        int, typer.Option("--threads", metavar="N", help="Number of threads; 0: one per processor.")
    ] = 0,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change a key, such as control.z.Kc=0.2; may be repeated."
        ),
    ] = None,
    vary: Annotated[
        str | None,
        typer.Option("--vary", metavar="KEY=A,B,...", help="Repeat the runs for each value of a key."),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            "--controller",
            metavar="FILE.py:NAME",
            help="A function of your own in the place of the controllers: outputs = NAME(time, measured, reference, "
            "state), or a FunctionController.",
        ),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            "--measured",
            metavar="LOG.csv",
            help="A measured log to lay over the run: columns time, x, y, depth or z, and currents of coils.",
        ),
    ] = None,
    log_columns: Annotated[
        list[str] | None,
        typer.Option(
            "--column", metavar="ROLE=NAME", help="Name of its column time, x, y, depth, z or of a coil."
        ),
    ] = None,
    log_units: Annotated[
        list[str] | None,
        typer.Option(
            "--unit", metavar="NAME=UNIT", help="Unit of a column of it whose heading does not say."
        ),
    ] = None,
    log_begins: Annotated[
        float | None,
        typer.Option(
            "--begins", metavar="S", help="Time of the run of its first sample. Default: its own time."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Run a scenario: a levitated magnet with coils, sensors and controllers in closed loop on a map.

    A run that fails (leaves the map, hits a wall, saturates) names the event that ended it. The exit code is 1 if all
    runs fail.
    """
    from fieldmap.cli.arguments import parse_setting, parse_variation
    from fieldmap.cli.printing import print_result
    from fieldmap.dynamics.scenario import simulate_batches, write_simulation
    from fieldmap.progress import Progress

    _check_files(output, save, runs, vary, log)
    fixed = dict(parse_setting(text, "--set") for text in changes or [])
    varied = None if vary is None else parse_variation(vary, "--vary")
    own = None if controller is None else _function_in(controller)
    kept = output is not None or save is not None or log is not None
    with Progress("simulate") as progress:
        simulation = simulate_batches(
            scenario,
            field_opener(map_file),
            fixed,
            varied,
            runs,
            seed,
            threads,
            kept,
            progress,
            device_of_option(map_file),
            own,
        )
    laid = None if log is None else _laid(simulation, log, log_columns, log_units, log_begins)
    written = [] if output is None else [write_simulation(output, simulation)]
    if save is not None:
        from fieldmap.plot.runs import save_run_figure

        written.append(
            save_run_figure(save, simulation.first.scenario.contents.title, _drawn(simulation, laid))
        )
    about = {} if laid is None else {"log": {"file": log, **laid.to_dict()}}
    print_result(simulation, partial(_page, scenario, written, laid), json, written=written, **about)
    if simulation.all_ended_early:
        raise typer.Exit(1)


def _check_files(
    output: Path | None, save: Path | None, runs: int, vary: str | None, log: Path | None
) -> None:
    from fieldmap.cli.arguments import output_problems
    from fieldmap.errors import InputError, Problem

    problems = []
    if runs < 1:
        problems.append(Problem("--runs", "must be 1 or more", str(runs), "give a whole number"))
    problems += output_problems("--output", output, (".h5", ".csv"))
    if output is not None and output.suffix == ".csv" and (runs > 1 or vary is not None):
        problems.append(Problem("--output", "a .csv file holds one run", "several runs", "take .h5"))
    problems += output_problems("--save", save, _PICTURES)
    if log is not None and (runs > 1 or vary is not None):
        problems.append(
            Problem("--measured", "is laid over one run", "several runs", "leave out --runs and --vary")
        )
    if problems:
        raise InputError(*problems)


def _function_in(text: str) -> "FunctionController":
    """The controller NAME of FILE.py, which is run as Python runs a script's imports. Raises InputError."""
    import importlib.util
    import sys

    from fieldmap.control import FunctionController
    from fieldmap.errors import InputError, Problem
    from fieldmap.shipped import is_file

    file, sign, name = text.rpartition(":")
    path = Path(file)
    if not (sign and name and path.suffix == ".py" and is_file(path)):
        must, remedy = (
            "must be FILE.py:NAME with a file that is there",
            "write for example my_loop.py:control",
        )
        raise InputError(Problem("--controller", must, text, remedy))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # What lies beside it is found, as it is by `python FILE.py`.
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        received, remedy = f"{type(error).__name__}: {error}", f"see what python {path} says"
        raise InputError(Problem("--controller", f"{path} must run", received, remedy)) from error
    finally:
        sys.path.remove(folder)
    if not hasattr(module, name):
        functions = [each for each, value in vars(module).items() if callable(value) and each[0] != "_"]
        remedy = f"choose among {', '.join(functions) or 'none: write one'}"
        raise InputError(Problem("--controller", f"must be in {path}", name, remedy))
    found = getattr(module, name)
    return found if isinstance(found, FunctionController) else FunctionController(found)


def _laid(
    simulation: "Simulation",
    log: Path,
    columns: list[str] | None,
    units: list[str] | None,
    begins: float | None,
) -> "LaidLog":
    """The log over the one run. Raises InputError with every problem of the options and of the log."""
    from fieldmap.dynamics.scenario import lay_over, read_measured_log
    from fieldmap.errors import InputError, Problem

    pairs: list[dict[str, str]] = []
    problems = []
    for option, texts in (("--column", columns), ("--unit", units)):
        pairs.append({})
        for text in texts or []:
            key, sign, value = (part.strip() for part in text.rpartition("="))
            if not (sign and key and value):
                problems.append(
                    Problem(option, "must be two words around =", text, "write for example depth=ch 1")
                )
            pairs[-1][key] = value
    if problems:
        raise InputError(*problems)
    told = {"units": "--unit", "names": "--column"}
    experiment, run = simulation.first, simulation.batches[0].runs[0].run
    assert run is not None
    measured = read_measured_log(log, experiment.device.coil_names, pairs[0], pairs[1], told)
    return lay_over(experiment, run, measured, begins)


def _drawn(simulation: "Simulation", laid: "LaidLog | None") -> "list[DrawnRun]":
    from fieldmap.plot.runs import drawn_run

    drawn = [
        drawn_run(batch.experiment, one.run, one.metrics.event)
        for batch in simulation.batches
        for one in batch.runs
        if one.run is not None
    ]
    if laid is not None:
        drawn[0]["measured"] = laid
    return drawn


def _page(
    scenario: str, written: list[Path], laid: "LaidLog | None", simulation: "Simulation"
) -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading
    from fieldmap.control import FunctionController

    own = simulation.first.controller
    where = (
        f"{scenario}, with {own.name} as its controller" if isinstance(own, FunctionController) else scenario
    )
    yield heading(simulation.first.scenario.contents.title, where)
    for batch in simulation.batches:
        yield _facts(batch)
        yield _axes(batch)
    for batch in simulation.batches:
        yield _steps(batch)
    yield None if laid is None else _apart(laid)
    yield facts(assumption_lines(simulation.first.assumptions))
    yield facts([("written", str(path)) for path in written]) if written else None


def _apart(laid: "LaidLog") -> "Table":
    from fieldmap.cli.printing import table

    lines = []
    for name, signal in laid.signals.items():
        rms, mean, largest = (f"{signal.to_dict()[key]:.5g}" for key in ("rms", "mean", "largest"))
        lines.append((f"{name}, {signal.unit}", f"{len(laid.time)}", rms, mean, largest))
    return table(("log less run", "samples", "RMS", "mean", "largest"), lines)


def _facts(batch: "Batch") -> "Table":
    from fieldmap.cli.printing import facts
    from fieldmap.records import count_of

    rest, contents = batch.experiment.operating_point, batch.experiment.scenario.contents
    amperes = ", ".join(f"{value:.4g}" for value in rest.currents)
    # A force that steps between cells of a coarse map has no zero.
    left = f"; {rest.residual:.0e} of the weight left" if rest.residual > 1e-6 else ""
    x, y, depth = _reading(batch)
    simulated = sum(one.metrics.end_s for one in batch.runs)
    rows = [("value", batch.label)] if batch.label else []
    rows += [
        ("at rest", f"x {x:.3f}, y {y:.3f}, depth {depth:.3f} mm; currents {amperes} A{left}"),
        (
            "simulated",
            f"{count_of(len(batch.runs), 'run', 'runs')} of {contents.duration_s:g} s in {batch.seconds:.2f} s of "
            f"one processor: {simulated / max(batch.seconds, 1e-9):.0f} times real time",
        ),
    ]
    rows += [("events", text) for text in _events(batch)]
    rows += [("settling", text) for text in _not_settled(batch)]
    lean = max(one.metrics.largest_lean_deg for one in batch.runs)
    current = max(one.metrics.largest_current_A for one in batch.runs)
    rows.append(("largest", f"lean {lean:.2f} degrees, current {current:.3f} A"))
    return facts(rows + [("iron", text) for text in _iron(batch)])


def _iron(batch: "Batch") -> list[str]:
    """How the solves of saturating iron went; nothing where there are none."""
    uses = [one.metrics.iron for one in batch.runs]
    solves, steps, unsolved = (
        sum(getattr(use, name) for use in uses) for name in ("solves", "newton_steps", "unsolved")
    )
    if not solves:
        return []
    lines = [f"solved at {solves} steps, {steps / solves:.2f} Newton steps each; {unsolved} did not converge"]
    if unsolved:
        lines.append(f"WARNING: at {unsolved} steps the iron stayed as it was at the step before")
    return lines


def _not_settled(batch: "Batch") -> list[str]:
    """A line for each axis that does not come to rest after its step, of the runs that no event ended."""
    import numpy as np

    lines = []
    whole = [one.metrics for one in batch.runs if not one.metrics.event]
    for k, axis in enumerate(("x", "y", "depth")):
        steps = [step for metrics in whole if (step := metrics.axes[k].step) is not None]
        left = [step.steady_rms for step in steps if not np.isfinite(step.settling_time)]
        if left:
            runs = "" if len(whole) == 1 else f" in {len(left)} of {len(whole)} runs"
            off = f"{float(np.mean(left)):.3g} mm RMS off over the last quarter"
            lines.append(f"{axis} does not settle within 2 % of its step{runs}: {off}")
    return lines


def _reading(batch: "Batch") -> "Array":
    from fieldmap.dynamics.scenario import reading_mm

    return reading_mm(batch.experiment.scenario, batch.experiment.operating_point.sensed)


def _events(batch: "Batch") -> list[str]:
    names: dict[str, list[RunMetrics]] = {}
    for one in batch.runs:
        if one.metrics.event:
            names.setdefault(one.metrics.event, []).append(one.metrics)
    lines = [f"{name}: {len(ended)}, {_first(ended)}" for name, ended in names.items()] or ["none"]
    touched = sorted({name for one in batch.runs for name in one.metrics.touched})
    words = {"currents": "currents beyond those of the map, where its iron is extrapolated"}
    return lines + [words.get(name, f"touched the {name}") for name in touched]


def _first(ended: "list[RunMetrics]") -> str:
    """When, where, how fast and with which currents the first of them ended."""
    import numpy as np

    first = min(ended, key=lambda metrics: metrics.end_s)
    x, y, depth = first.end_mm
    amperes = ", ".join(f"{value:.3g}" for value in first.end_A)
    return (
        f"first at {first.end_s:.3f} s: x {x:.2f}, y {y:.2f}, depth {depth:.2f} mm, "
        f"{np.linalg.norm(first.end_mm_per_s):.3g} mm/s; currents {amperes} A"
    )


def _axes(batch: "Batch") -> "Table":
    import numpy as np

    from fieldmap.cli.printing import table

    columns = ("axis", "RMS error mm", "of the reading mm", "largest mm", "travel mm")
    lines = []
    for k, axis in enumerate(("x", "y", "depth")):
        parts = [one.metrics.axes[k] for one in batch.runs]
        rms = float(np.mean([part.rms_error_mm for part in parts]))
        seen = float(np.mean([part.rms_seen_mm for part in parts]))
        worst = max(part.largest_error_mm for part in parts)
        lines.append(
            (axis, f"{rms:.5f}", f"{seen:.5f}", f"{worst:.4f}", f"{max(p.travel_mm for p in parts):.4f}")
        )
    return table(columns, lines)


def _steps(batch: "Batch") -> "Table | None":
    """Mean over the runs of the metrics of every axis with a step."""
    import numpy as np

    from fieldmap.cli.printing import table

    lines = []
    for k, axis in enumerate(("x", "y", "depth")):
        steps = [one.metrics.axes[k].step for one in batch.runs]
        found = [step for step in steps if step is not None]
        if found:
            mean = [
                float(np.mean([getattr(step, name) for step in found]))
                for name in ("rise_time", "peak_time", "settling_time", "overshoot", "steady_rms")
            ]
            cells = (
                f"{mean[0]:.4f}",
                f"{mean[1]:.4f}",
                f"{mean[2]:.4f}",
                f"{100 * mean[3]:.1f}",
                f"{mean[4]:.5f}",
            )
            lines.append((f"{axis} {batch.label}".strip(), *cells))
    if not lines:
        return None
    return table(("step of", "rise s", "peak s", "settling s", "overshoot %", "steady RMS mm"), lines)
