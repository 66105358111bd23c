"""The time left that runs state, against the time that they then took.

Every statement from a tenth of a run on counts, but those of less than five seconds. The clock is that of the wall
where nothing else runs, and that of this process's processors otherwise: a forecast does not know of other work.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

from fieldmap import progress
from fieldmap.maps import generate
from fieldmap.studies import Uncertain, analyse_tolerances, generate_many, run_study
from validation.many_maps import RECIPE
from validation.row import Row

FROM, LEAST_SECONDS, BOUND = 0.1, 5.0, 1.5
# Processes that wait or run beside this one, on a machine that does nothing else.
QUIET = 0.5
POLES = """
format = 1
title = "Pole pieces"
{of}

[[vary]]
name = "turns"
key = "coil.1.turns"
values = [100, 120, 140, 160, 180, 200, 220, 240, 260, 280, 300, 320]

[[vary]]
name = "radius"
key = "body.core.radius_mm"
values = [13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0]
"""
RECORDS = """
[iron]
model = "linear"
refinement = 2.0

[record]
quantities = ["field"]
points_mm = [[0.0, 0.0, -40.0]]

[[currents]]
name = "one"
amperes_A = [1.0]
"""
Say = Callable[[str, float], None]


def of_progress() -> Iterator[Row]:
    """Maps of linear and saturating iron, many maps, a study, and tolerances."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = POLES.format(of='device = "single_electromagnet"') + RECORDS
        texts = {"poles.toml": RECIPE, "study.toml": study}
        texts["many.toml"] = POLES.format(of='recipe = "poles.toml"')
        for file, text in texts.items():
            (folder / file).write_text(text)
        uncertain = [Uncertain("coil.1.turns", 1.0), Uncertain("body.core.radius_mm", 0.1)]
        about = {"points": [[0, 0, -0.04]], "currents": 1.0, "refinement": 2.5, "samples": 60}
        runs: dict[str, Callable[[Say], object]] = {
            "main map": lambda say: generate("workspace", folder / "main.h5", progress=say),
            "coarse saturating map": lambda say: generate(
                "division_quick", folder / "coarse.h5", progress=say
            ),
            "linear map": lambda say: generate("linear", folder / "linear.h5", progress=say),
            "many maps": lambda say: generate_many(
                folder / "poles.toml", folder / "many.toml", folder / "many.nc", progress=say
            ),
            "study": lambda say: run_study(folder / "study.toml", folder / "study.nc", progress=say),
            "tolerances": lambda say: analyse_tolerances(
                "single_electromagnet", uncertain, ["flux_density 1 z"], progress=say, **about
            ),
        }
        # What is compiled or loaded once is no measure.
        generate("quick", folder / "first.h5", progress=False)
        for case, run in runs.items():
            yield _row(case, run)


def _row(case: str, run: Callable[[Say], object]) -> Row:
    quiet = not hasattr(os, "getloadavg") or os.getloadavg()[0] < QUIET + 1.0
    clock = time.monotonic if quiet else time.process_time
    before, processor = progress.time, time.process_time()
    told: list[tuple[float, float, str]] = []
    progress.time = SimpleNamespace(monotonic=clock)  # type: ignore[assignment]
    wall, begin = time.monotonic(), clock()
    try:
        run(lambda message, share: told.append((clock() - begin, share, message)))
    finally:
        progress.time = before
    whole = clock() - begin
    # As `Progress` does: a share is one of the time since nothing was done.
    first = max((at for at, share, _ in told if share == 0.0), default=0.0)
    stated = [(at, (at - first) * (1.0 / share - 1.0), message) for at, share, message in told if share > 0.0]
    counted = [
        (max(left / (whole - at), (whole - at) / left), at, left, message)
        for at, left, message in stated
        if at >= FROM * whole and left >= LEAST_SECONDS
    ]
    worst = max(counted, default=(1.0, 0.0, 0.0, "none of five seconds or more"))
    seconds = time.monotonic() - wall, time.process_time() - processor
    kind = "wall" if quiet else "processor"
    figures = {
        "run": case,
        f"s ({kind})": f"{whole:.0f}",
        "statements": f"{len(counted)}",
        "largest ratio": f"{worst[0]:.2f}",
        "at s": f"{worst[1]:.0f}",
        "left, stated": f"{worst[2]:.0f}",
        "left, true": f"{whole - worst[1]:.0f}",
        "at": worst[3],
    }
    note = f"by the {kind} clock, {len(counted)} statements"
    quantity = "time left, stated over true or true over stated"
    return Row(
        case, quantity, worst[0], BOUND, note, seconds=seconds[0], cpu_seconds=seconds[1], figures=figures
    )
