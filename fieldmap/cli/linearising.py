"""What `fieldmap linearise` does: scenario, points, file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.cli.arguments import output_problems
from fieldmap.cli.simulating import opened_map, pair
from fieldmap.dynamics.scenario import Experiment, LinearPoint, linear_points, prepare, read_scenario
from fieldmap.errors import InputError, Problem


@dataclass(frozen=True)
class Wanted:
    """The command line."""

    scenario: str
    map_file: Path | None
    depths: str | None
    changes: tuple[str, ...]
    output: Path | None


@dataclass(frozen=True, eq=False)
class Outcome:
    """The points, and the file that was written."""

    wanted: Wanted
    experiment: Experiment
    points: tuple[LinearPoint, ...]
    written: Path | None


def check_wanted(wanted: Wanted) -> None:
    """What can be wrong with the command line, before any work. Raises InputError."""
    problems = output_problems("--output", wanted.output, (".json", ".npz"))
    if wanted.depths is not None:
        try:
            _depths(wanted.depths)
        except ValueError:
            problems.append(
                Problem("--depths", "must be numbers A,B,...", wanted.depths, "write for example 0,10,20")
            )
    if problems:
        raise InputError(*problems)


def _depths(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


def linearise_all(wanted: Wanted) -> Outcome:
    """Every point, and the file asked for."""
    from fieldmap.cli.linearise_text import as_json

    scenario = read_scenario(wanted.scenario, dict(pair(text, "--set") for text in wanted.changes))
    experiment = prepare(scenario, None if wanted.map_file is None else opened_map(wanted.map_file))
    depths = None if wanted.depths is None else _depths(wanted.depths)
    points = tuple(linear_points(experiment, depths))
    outcome = Outcome(wanted, experiment, points, wanted.output)
    if wanted.output is not None and wanted.output.suffix == ".npz":
        np.savez(wanted.output, **_arrays(points))  # type: ignore[arg-type]
    elif wanted.output is not None:
        import json

        from fieldmap.plain import plain

        wanted.output.write_text(json.dumps(plain(as_json(outcome)), indent=2, allow_nan=False) + "\n")
    return outcome


def _arrays(points: tuple[LinearPoint, ...]) -> dict[str, object]:
    """Stacks over the depths: A (k, n, n), B, C, D, G; of the loop loop_A, loop_B, loop_C; names."""
    first = points[0].linear
    stacks = {name: np.stack([getattr(p.linear, name) for p in points]) for name in ("A", "B", "C", "D", "G")}
    loops = {f"loop_{name}": np.stack([getattr(p.loop, name) for p in points]) for name in ("A", "B", "C")}
    rests = {
        name: np.stack([getattr(p.linear.operating_point, name) for p in points])
        for name in ("sensed", "currents", "state")
    }
    names = {name: np.array(getattr(first, name)) for name in ("states", "inputs", "outputs")}
    return {
        "depth_mm": np.array([p.depth_mm for p in points]),
        "period_s": points[0].loop.period,
        **stacks,
        **loops,
        **{f"rest_{name}": value for name, value in rests.items()},
        "rest_outputs": np.stack([p.linear.operating_point.outputs for p in points]),
        **names,
    }
