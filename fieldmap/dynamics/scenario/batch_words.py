"""A batch of runs in words: its equilibrium, its speed, the events that ended runs, and axes that did not settle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fieldmap.dynamics.scenario.batches import Batch
from fieldmap.dynamics.scenario.metrics import RunMetrics, reading_mm
from fieldmap.dynamics.scenario.references import AXES
from fieldmap.records import count_of


def batch_words(batch: Batch) -> Iterator[tuple[str, str]]:
    """Statements about a batch.

    Parameters
    ----------
    batch : Batch
        Runs with one value of the varied key.

    Yields
    ------
    tuple of str
        The subject, such as "at rest" or "events", and a statement. A subject may come several times.
    """
    scenario, rest = batch.experiment.scenario, batch.experiment.operating_point
    # The force may jump over zero between cells of a coarse map.
    left = f"; {rest.residual:.0e} of the weight left" if rest.residual > 1e-6 else ""
    x, y, depth = reading_mm(scenario, rest.sensed)
    amperes = ", ".join(f"{value:.4g}" for value in rest.currents)
    runs = [one.metrics for one in batch.runs]
    speed = sum(one.end_s for one in runs) / max(batch.seconds, 1e-9)
    if batch.label:
        yield "value", batch.label
    yield "at rest", f"x {x:.3f}, y {y:.3f}, depth {depth:.3f} mm; currents {amperes} A{left}"
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
            of = "" if len(whole) == 1 else f" in {len(left)} of {len(whole)} runs"
            off = f"{float(np.mean(left)):.3g} mm RMS off over the last quarter"
            yield f"{axis} does not settle within 2 % of its step{of}: {off}"


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
