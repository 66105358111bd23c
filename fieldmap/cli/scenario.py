"""Machines in closed loop: `fieldmap simulate` runs a scenario, `fieldmap linearise` gives its linear model, and
`fieldmap tune` its PID controllers."""

from __future__ import annotations

import runpy
import shlex
import sys
from collections.abc import Iterator, Mapping
from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from fieldmap.arguments import raise_all
from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_pairs, parse_settings, parse_variations
from fieldmap.cli.options import option
from fieldmap.errors import InputError, Problem
from fieldmap.progress import Progress
from fieldmap.shipped import is_file

if TYPE_CHECKING:
    from fieldmap.control import FunctionController
    from fieldmap.dynamics.scenario import Batch, LaidLog, Linearisation, LinearPoint, Simulation, Tuning
    from fieldmap.plot.runs import DrawnRun

_EXAMPLE = "control.z.Kc=0.2"


def simulate(
    scenario: options.ScenarioArgument,
    map_file: options.ScenarioMap = None,
    target: Annotated[
        Path | None,
        options.output("Write the runs: .h5, or .csv of a single run."),
        options.writes("recorded runs", "recorded run"),
    ] = None,
    save: Annotated[Path | None, options.SAVE, options.writes("figure")] = None,
    runs: Annotated[int, option("--runs", "N")] = 1,
    seed: Annotated[int | None, option("--seed", "N")] = None,
    threads: Annotated[int, option("--threads", "N")] = 0,
    changes: options.ScenarioChanges = None,
    vary: Annotated[list[str] | None, option("--vary", "KEY=A,B,...")] = None,
    controller: Annotated[str | None, option("--controller", "FILE.py:NAME")] = None,
    log: Annotated[Path | None, option("--measured", "LOG.csv")] = None,
    log_columns: Annotated[list[str] | None, option("--column", "ROLE=NAME")] = None,
    units: options.Units = None,
    log_begins: Annotated[float | None, option("--begins", "S")] = None,
    json: options.Json = False,
) -> None:
    """Run a scenario: a levitated magnet with coils, sensors and controllers in closed loop on a map.

    --save draws the runs: .png, .svg or .pdf. A run that fails (leaves the map, hits a wall, saturates) names the event
    that ended it. The exit code is 1 if all runs fail.

    Example: fieldmap simulate hold --map square.h5 --save held.png

    Parameters
    ----------
    runs
        Number of runs, each with its own noise.
    seed
        Seed of the noise, in place of the scenario's.
    threads
        Number of threads; 0: one per processor.
    vary
        Repeat the runs for each value of a key; given several times, for all combinations of their values.
    controller
        A function of your own in the place of the controllers: outputs = NAME(time, measured, reference, state), or a
        FunctionController.
    log
        A measured log to lay over the run: columns time, x, y, depth or z, and currents of coils.
    log_columns
        Name of the log's column time, x, y, depth, z or of a coil.
    log_begins
        Time of the run at the log's first sample. Default: its own time.
    """
    from fieldmap.dynamics.scenario import simulate_batches, write_simulation

    several = runs > 1 or bool(vary)
    problems = []
    if runs < 1:
        problems.append(Problem("--runs", "must be 1 or more", str(runs), "give a whole number"))
    if several and target is not None and target.suffix == ".csv":
        problems.append(Problem("--output", "a .csv file holds one run", "several runs", "take .h5"))
    if several and log is not None:
        remedy = "leave out --runs and --vary"
        problems.append(Problem("--measured", "is laid over one run", "several runs", remedy))
    raise_all(problems)
    fixed = parse_settings(changes, _EXAMPLE)
    varied = parse_variations(vary, fixed)
    own = None if controller is None else _function_in(controller)
    kept = target is not None or save is not None or log is not None
    field, device = options.field_of_option(map_file)
    with Progress("simulate", timed=True) as progress:
        simulation = simulate_batches(
            scenario, field, fixed, varied, runs, seed, threads, kept, progress, device, own
        )
    laid = None if log is None else _laid(simulation, log, log_columns, units, log_begins)
    files = [] if target is None else [write_simulation(target, simulation)]
    if save is not None:
        from fieldmap.plot.runs import save_run_figure

        title = simulation.first.scenario.contents.title
        files.append(save_run_figure(save, title, _drawn(simulation, laid)))
    about = {} if laid is None else {"log": {"file": log, **laid.to_dict()}}
    page.print_result(simulation, partial(_run_page, scenario, files, laid), json, written=files, **about)
    if simulation.all_ended_early:
        raise typer.Exit(1)


def _function_in(text: str) -> FunctionController:
    """The controller NAME of FILE.py, which is imported like a module of a script. Raises InputError."""
    from fieldmap.control import FunctionController

    def refused(must_hold: str, received: str, remedy: str) -> InputError:
        return InputError.of("--controller", must_hold, received, remedy)

    file, sign, name = text.rpartition(":")
    path = Path(file)
    if not (sign and name and path.suffix == ".py" and is_file(path)):
        must_hold = "must be FILE.py:NAME with a file that is there"
        raise refused(must_hold, text, "write for example my_loop.py:control")
    # As with `python FILE.py`, the file can import modules in its folder.
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        defined = runpy.run_path(str(path))
    except Exception as error:
        received = f"{type(error).__name__}: {error}"
        raise refused(f"{path} must run", received, f"see what python {path} says") from error
    finally:
        sys.path.remove(folder)
    if name not in defined:
        functions = [each for each, value in defined.items() if callable(value) and each[0] != "_"]
        choice = f"choose among {', '.join(functions) or 'none: write one'}"
        raise refused(f"must be in {path}", name, choice)
    found = defined[name]
    return found if isinstance(found, FunctionController) else FunctionController(found)


def _laid(
    simulation: Simulation,
    log: Path,
    columns: list[str] | None,
    units: list[str] | None,
    begins: float | None,
) -> LaidLog:
    """The log laid over a single run. Raises InputError with all problems of the options and of the log."""
    from fieldmap.dynamics.scenario import lay_over, read_measured_log

    names, of_names = parse_pairs(columns, "--column", "ROLE=NAME", "depth=ch 1")
    unit_of, of_units = parse_pairs(units, "--unit", "NAME=UNIT", "depth=mm")
    raise_all(of_names + of_units)
    given_by = {"units": "--unit", "names": "--column"}
    experiment, run = simulation.first, simulation.batches[0].runs[0].run
    assert run is not None
    measured = read_measured_log(log, experiment.device.coil_names, names, unit_of, given_by)
    return lay_over(experiment, run, measured, begins)


def _drawn(simulation: Simulation, laid: LaidLog | None) -> list[DrawnRun]:
    from fieldmap.plot.runs import drawn_run

    drawn = [
        drawn_run(one.run, batch.varied)
        for batch in simulation.batches
        for one in batch.runs
        if one.run is not None
    ]
    if laid is not None:
        drawn[0]["measured"] = laid
    return drawn


def _run_page(
    scenario: str, files: list[Path], laid: LaidLog | None, simulation: Simulation
) -> Iterator[page.Section]:
    from fieldmap.control import FunctionController
    from fieldmap.dynamics.scenario.batches import batch_words

    own = simulation.first.controller
    of = f", with {own.name} as its controller" if isinstance(own, FunctionController) else ""
    yield page.heading(simulation.first.scenario.contents.title, f"{scenario}{of}")
    for batch in simulation.batches:
        yield page.facts(batch_words(batch))
        yield _axes(batch)
    for batch in simulation.batches:
        yield _steps(batch)
    yield None if laid is None else _differences(laid)
    yield page.assumed(simulation.assumptions)
    yield page.written(files)


def _differences(laid: LaidLog) -> Table:
    rows = []
    for name, signal in laid.signals.items():
        numbers = signal.to_dict()
        sizes = (f"{numbers[key]:.5g}" for key in ("rms", "mean", "largest"))
        rows.append((f"{name}, {signal.unit}", f"{len(laid.time)}", *sizes))
    return page.table(("log less run", "samples", "RMS", "mean", "largest"), rows)


def _axes(batch: Batch) -> Table:
    from fieldmap.dynamics.scenario.metrics import over_runs

    rows = []
    for k, first in enumerate(batch.runs[0].metrics.axes):
        parts = [one.metrics.axes[k] for one in batch.runs]
        errors = [
            over_runs([getattr(part, name) for part in parts]) for name in ("rms_error_mm", "rms_seen_mm")
        ]
        largest = (max(part.largest_error_mm for part in parts), max(part.travel_mm for part in parts))
        rows.append((first.axis, *page.cells(errors, ".5f"), *page.cells(largest, ".4f")))
    return page.table(("axis", "RMS error mm", "of the reading mm", "largest mm", "travel mm"), rows)


def _steps(batch: Batch) -> Table | None:
    """Means over the runs of the step metrics of every axis with a step, and the RMS over all runs."""
    from fieldmap.dynamics.scenario.metrics import over_runs

    rows = []
    for k, first in enumerate(batch.runs[0].metrics.axes):
        steps = [step for one in batch.runs if (step := one.metrics.axes[k].step) is not None]
        if not steps:
            continue
        names = ("rise_time", "peak_time", "settling_time", "overshoot")
        *times, overshoot = (np.mean([getattr(step, name) for step in steps]) for name in names)
        steady = over_runs([step.steady_rms for step in steps])
        numbers = (*(f"{time:.4f}" for time in times), f"{100 * overshoot:.1f}", f"{steady:.5f}")
        rows.append((f"{first.axis} {batch.label}".strip(), *numbers))
    columns = ("step of", "rise s", "peak s", "settling s", "overshoot %", "steady RMS mm")
    return page.table(columns, rows) if rows else None


def linearise(
    scenario: options.ScenarioArgument,
    map_file: options.ScenarioMap = None,
    depths: Annotated[str | None, option("--depths", "A,B,...")] = None,
    changes: options.ScenarioChanges = None,
    target: Annotated[
        Path | None, options.output("Write the models: .json or .npz."), options.writes("linear models")
    ] = None,
    json: options.Json = False,
) -> None:
    """Linearise the machine of a scenario about its operating point: poles, coupling, margins.

    The exit code is 1 if the loop is unstable at any depth.

    Example: fieldmap linearise hold --map square.h5 --depths 40,50,60

    Parameters
    ----------
    depths
        Readings of the vertical sensor, mm. Default: the one at the start.
    """
    from fieldmap.dynamics.scenario import Linearisation, linear_points, prepare, read_scenario

    problems, readings = list[Problem](), None
    try:
        readings = None if depths is None else [float(part) for part in depths.split(",")]
    except ValueError:
        remedy = "write for example 0,10,20"
        problems.append(Problem("--depths", "must be numbers A,B,...", str(depths), remedy))
    raise_all(problems)
    read = read_scenario(scenario, parse_settings(changes, _EXAMPLE))
    opener, device = options.field_of_option(map_file)
    field = None if opener is None else opener()
    experiment = prepare(read, field, device if read.contents.device is None else None)
    found = Linearisation(experiment, tuple(linear_points(experiment, readings)))
    if target is not None:
        found.write(target)
    page.print_result(found, partial(_linear_page, scenario, target), json, written=target)
    if not found.stable:
        raise typer.Exit(1)


def _linear_page(scenario: str, target: Path | None, found: Linearisation) -> Iterator[page.Section]:
    yield page.heading(found.experiment.scenario.contents.title, scenario)
    tables = {
        ("pole 1/s", "Hz", "damping", "moves", "input gain", "output gain"): _modes,
        ("from", "to x mm", "to y mm", "to z mm", "relative gain"): _coupling,
        ("loop", "slowest pole 1/s", "least damping", "at Hz"): _loop,
        ("loop at", "phase deg", "at Hz", "gain up", "gain down", "modulus", "unstable part"): _margins,
    }
    for columns, rows_at in tables.items():
        rows = [(f"{point.depth_mm:g}", *row) for point in found.points for row in rows_at(point)]
        yield page.table(("depth mm", *columns), rows)
    yield page.assumed(found.assumptions)
    yield page.written([target]) if target else None


def _modes(point: LinearPoint) -> Iterator[tuple[str, ...]]:
    reached = page.without_noise([mode.input_gains.max() for mode in point.modes])
    seen = page.without_noise([mode.output_gains.max() for mode in point.modes])
    for mode, *gains in zip(point.modes, reached, seen, strict=True):
        # A complex pair has one line.
        if mode.pole.imag < -1e-9:
            continue
        shares = mode.named_shares(point.linear)
        moves = ", ".join(sorted(shares, key=lambda name: -shares[name]))
        numbers = page.cells((mode.frequency, mode.damping), ".3f")
        yield _complex(mode.pole), *numbers, moves, *page.cells(gains, ".3g")


def _complex(value: complex) -> str:
    return f"{value.real:.3f}" + (f" ± {abs(value.imag):.3f}i" if abs(value.imag) > 1e-9 else "")


def _coupling(point: LinearPoint) -> Iterator[tuple[str, ...]]:
    """Direction in which each signal moves the body in open loop; and its relative gain with its own axis."""
    from fieldmap.dynamics.scenario.linear_points import coupling_signals

    gain, relative = page.without_noise(1e3 * point.coupling.gain), point.coupling.relative
    for k, name in enumerate(coupling_signals(point)):
        yield name, *page.cells(gain[:, k], ".4g"), f"{relative[k, k]:.3f}"


def _loop(point: LinearPoint) -> Iterator[tuple[str, ...]]:
    from fieldmap.dynamics.scenario.linear_points import loop_poles

    poles = loop_poles(point)
    damping = -poles.real / np.maximum(np.abs(poles), 1e-12)
    least = int(np.argmin(damping))
    frequency = abs(poles[least].imag) / (2 * np.pi)
    state = "stable" if point.loop.stable else "UNSTABLE"
    yield state, _complex(complex(poles[0])), *page.cells((damping[least], frequency), ".3f")


def _margins(point: LinearPoint) -> Iterator[tuple[str, ...]]:
    for found in point.margins:
        # A factor that no gain reaches is "inf".
        numbers = (f"{found.gain_up:.3g}", f"{found.gain_down:.3g}", f"{found.modulus:.3f}")
        yield found.output, f"{found.phase:.1f}", f"{found.crossover:.3f}", *numbers, f"{found.unstable:.2f}"


def tune(
    scenario: options.ScenarioArgument,
    map_file: options.ScenarioMap = None,
    axes: Annotated[list[str] | None, option("--axis", "z|x|y")] = None,
    phase_margin: Annotated[float, option("--phase-margin", "DEG")] = 45.0,
    gain_margin: Annotated[float, option("--gain-margin", "FACTOR")] = 2.0,
    modulus: Annotated[float, option("--modulus", "NUMBER")] = 0.4,
    crossover: Annotated[float | None, option("--crossover", "HZ")] = None,
    filter_number: Annotated[float, option("--filter", "N")] = 10.0,
    changes: options.ScenarioChanges = None,
    json: options.Json = False,
) -> None:
    """Tune PID controllers of a scenario's axes on its linear machine, by margins.

    Each axis is tuned alone. The second table has the margins of the whole machine. The line --set gives simulate these
    controllers. Margins that cannot be had, as of an unstable axis that is sampled slowly, are refused with
    the nearest ones.

    Example: fieldmap tune hold --map square.h5 --crossover 10 --phase-margin 40

    Parameters
    ----------
    axes
        The axis: z (the depth), x or y; may be repeated. Default: all three.
    phase_margin
        Degrees.
    gain_margin
        Factor by which the gain may grow, and shrink where the axis is unstable.
    modulus
        Smallest distance of the loop's curve from -1.
    crossover
        Frequency at which the gain of the loop is 1. Default: as fast as the margins allow.
    filter_number
        Derivative time over the time constant of its filter.
    """
    from fieldmap.dynamics import tune_axes

    opener, device = options.field_of_option(map_file)
    given = parse_settings(changes, _EXAMPLE)
    margins = {"phase_margin": phase_margin, "gain_margin": gain_margin, "modulus": modulus}
    found = tune_axes(
        scenario,
        tuple(dict.fromkeys(axes or "zxy")),
        given,
        field_map=None if opener is None else opener(),
        device=device,
        crossover=crossover,
        N=filter_number,
        **margins,
    )
    page.print_result(found, partial(_tuned_page, scenario), json)


def _tuned_page(scenario: str, found: Tuning) -> Iterator[page.Section]:
    from fieldmap.dynamics.scenario.tuning import pid_table

    yield page.heading("PID controllers by margins", scenario)
    rows = []
    for axis, tuned in found.axes.items():
        pid, m = pid_table(axis, tuned.pid), tuned.margins
        gains = page.cells([pid[name] for name in ("Kc", "Ti_s", "Td_s", "Tf_s")], ".4g")
        reached = page.cells((m.phase, m.crossover), ".3f")
        rows.append((axis, *gains, *reached, f"{m.gain_up:.3g}", f"{m.gain_down:.3g}", f"{m.modulus:.3f}"))
    columns = ("Kc", "Ti s", "Td s", "Tf s", "phase deg", "at Hz", "gain up", "gain down", "modulus")
    yield page.table(("axis alone", *columns), rows)
    state = "stable" if found.point.loop.stable else "UNSTABLE"
    yield page.table((f"all axes, {state}", *columns[4:]), list(_margins(found.point)))
    settings = (shlex.quote(f"{key}={_toml(value)}") for key, value in found.keys.items())
    yield page.command(" ".join(f"--set {setting}" for setting in settings))
    yield page.assumed(found.assumptions)


def _toml(value: object) -> str:
    """A value of TOML on one line."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}={_toml(one)}' for key, one in value.items())}}}"
    return f"{value:.6g}" if isinstance(value, float) else dumps(value)
