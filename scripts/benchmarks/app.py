"""Cost of a moved slider of `fieldmap app`: field on three planes, force and equilibrium, and their picture.

Measured on the maps in maps/out: `linear` and `quick`, and `workspace`, `division` and `saturating` of saturating iron.
One slider at a time is moved by a tenth of its range, up or down. Times are processor milliseconds, so that a busy
machine matters less; the processor also draws the picture, off-screen, which a graphics card does faster.
"""

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from fieldmap.device import recorded_device
from fieldmap.lookup import open_map
from fieldmap.plot.live_window import LiveWindow
from fieldmap.plot.rendering import can_render

FOLDER, MAPS = Path("maps/out"), ("linear", "quick", "workspace", "division", "saturating")
WANTED_MS = 100.0
LIMIT = 12.0
"""Current limit, A; linear maps need more current for the lift than saturating ones."""


@dataclass(frozen=True)
class Row:
    """One map: milliseconds of the answer (median, largest), and of answer and picture together (median, largest)."""

    map: str
    moves: int
    floating: int
    answer: float
    worst_answer: float
    picture: float
    worst_picture: float


def row(path: Path, moves: int) -> Row:
    """Measure one map."""
    opened = open_map(path)
    payload = recorded_device(opened.info.provenance.device_text).payload
    scale = 1.0 if opened.info.reduced_model is None else 2.1
    window = LiveWindow(opened, payload, LIMIT, scale, path.name, off_screen=True)
    window.scene.screenshot(None)
    rng, values, floating = np.random.default_rng(0), window.values.copy(), 0
    answers, pictures = [], []
    for _ in range(moves):
        k = rng.integers(len(values))
        control = window.live.controls[k]
        values[k] += rng.choice([-0.1, 0.1]) * (control.upper - control.lower)
        values[k] = np.clip(values[k], control.lower, control.upper)
        begin = time.process_time()
        answer = window.live.answer_at(values)
        answers.append(time.process_time() - begin)
        begin = time.process_time()
        window.move(values)
        pictures.append(time.process_time() - begin)
        floating += answer.equilibrium is not None
    window.scene.close()
    numbers = (np.median(answers), np.max(answers), np.median(pictures), np.max(pictures))
    return Row(path.stem, moves, floating, *(1e3 * float(value) for value in numbers))


def measure(quick: bool) -> dict[str, Any]:
    """Measure every map that exists."""
    if not can_render():
        return {"rows": [], "missing": "no OpenGL on this machine"}
    there = [FOLDER / f"{name}.h5" for name in MAPS if (FOLDER / f"{name}.h5").is_file()]
    missing = "" if there else f"no map in {FOLDER}: fieldmap map quick"
    return {"rows": [asdict(row(path, 10 if quick else 100)) for path in there], "missing": missing}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(title="A slider of fieldmap app is moved: processor milliseconds (median, largest)")
    for name in (
        "map",
        "moves",
        "with an equilibrium",
        "answer",
        "",
        "answer and picture",
        "",
        "within 100 ms",
    ):
        table.add_column(name, justify="left" if name == "map" else "right")
    for r in result["rows"]:
        cells = (f"{r[name]:.1f}" for name in ("answer", "worst_answer", "picture", "worst_picture"))
        within = "yes" if r["worst_answer"] <= WANTED_MS else "no"
        table.add_row(r["map"], str(r["moves"]), str(r["floating"]), *cells, within)
    console.print(table)
    if result["missing"]:
        console.print(result["missing"], highlight=False)
