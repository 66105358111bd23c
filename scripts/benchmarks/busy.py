"""Utilisation of eight local workers by a map of saturating iron, and by a study with the same pieces of work.

The map is made in one process, which records the duration of each piece of work and the time between the calls that
distribute work. Eight workers then sleep for these durations, call by call, through `fieldmap.parallel.Workers`, so
that a machine with fewer processors measures the same. busy: sum of the durations over workers times wall time, for the
calls alone, and together with the time in which the first process works alone. The study has all pieces in one call.
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import fieldmap as fm
from fieldmap.parallel import Outcome, Workers

WORKERS = 8


@dataclass
class Call:
    """One call that distributes work: begin and end, s, and durations of its pieces, s."""

    begin: float
    end: float = 0.0
    pieces: list[float] = field(default_factory=list)


def recorded(recipe: str) -> tuple[list[Call], float]:
    """The calls while a map is made in one process, and the total time, s."""
    calls: list[Call] = []
    mapped = Workers.map

    def recording(workers: Workers, *arguments: Any, **named: Any) -> Iterator[Outcome[Any]]:
        calls.append(Call(time.monotonic()))
        for outcome in mapped(workers, *arguments, **named):
            calls[-1].pieces.append(outcome.seconds)
            yield outcome
        calls[-1].end = time.monotonic()

    Workers.map = recording  # type: ignore[method-assign]
    begin = time.monotonic()
    try:
        with tempfile.TemporaryDirectory() as folder:
            fm.generate(recipe, Path(folder) / "map.h5", accept_error=True)
    finally:
        Workers.map = mapped  # type: ignore[method-assign]
    return calls, time.monotonic() - begin


def replayed(workers: Workers, calls: list[list[float]]) -> float:
    """Time, s, of the workers for pieces of these durations, call by call."""
    begin = time.monotonic()
    for pieces in calls:
        workers.results(time.sleep, pieces)
    return time.monotonic() - begin


def measure(quick: bool) -> dict[str, Any]:
    """Measure the utilisation of eight workers."""
    recipe = "division_quick" if quick else "workspace"
    calls, total = recorded(recipe)
    alone = total - sum(call.end - call.begin for call in calls)
    pieces = [call.pieces for call in calls]
    together = [duration for call in pieces for duration in call]
    with Workers(WORKERS) as workers:
        # A first call waits for the processes to start.
        workers.results(time.sleep, [0.1] * 4 * WORKERS)
        in_calls, at_once = replayed(workers, pieces), replayed(workers, [4 * together])
    work = sum(together)
    return {
        "recipe": recipe,
        "workers": WORKERS,
        "pieces": len(together),
        "piece_seconds": work,
        "first_process_seconds": alone,
        "busy_in_calls": work / (WORKERS * in_calls),
        "busy": work / (WORKERS * (in_calls + alone)),
        "busy_study": 4 * work / (WORKERS * at_once),
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(
        caption=f"{result['workers']} workers, map {result['recipe']}: {result['pieces']} pieces of "
        f"{result['piece_seconds']:.0f} s altogether; the first process works {result['first_process_seconds']:.0f} s "
        "by itself"
    )
    table.add_column("share of the workers' time that is filled")
    table.add_column("%", justify="right")
    for name, text in (
        ("busy_in_calls", "map, while pieces are given out"),
        ("busy", "map, from the beginning to the end"),
        ("busy_study", "study of four times as many pieces of these durations"),
    ):
        table.add_row(text, f"{100 * result[name]:.0f}")
    console.print(table)
