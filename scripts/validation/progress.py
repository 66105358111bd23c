"""The time left that runs predict, compared with the time that they then took.

Every prediction after a tenth of a run counts, except predictions of less than five seconds. Run this on a machine that
does nothing else, because a forecast does not know of other work.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from fieldmap.maps import generate
from fieldmap.studies import Uncertain, analyse_tolerances, generate_many, run_study
from validation.many_maps import RECIPE
from validation.row import Row

FROM, LEAST_SECONDS, BOUND = 0.1, 5.0, 1.5
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
        # A first map compiles and loads everything, which would disturb the measurement.
        generate("quick", folder / "first.h5", progress=False)
        for case, run in runs.items():
            yield _row(case, run)


def _row(case: str, run: Callable[[Say], object]) -> Row:
    told: list[tuple[float, float, str]] = []
    begin, processor = time.monotonic(), time.process_time()
    run(lambda message, share: told.append((time.monotonic() - begin, share, message)))
    whole, processor = time.monotonic() - begin, time.process_time() - processor
    # As in `Progress`, the share refers to the time since the last report of 0.
    first = max((at for at, share, _ in told if share == 0.0), default=0.0)
    stated = [(at, (at - first) * (1.0 / share - 1.0), message) for at, share, message in told if share > 0.0]
    counted = [
        (max(left / (whole - at), (whole - at) / left), at, left, message)
        for at, left, message in stated
        if at >= FROM * whole and left >= LEAST_SECONDS
    ]
    worst = max(counted, default=(1.0, 0.0, 0.0, "none of five seconds or more"))
    figures = {
        "run": case,
        "s": f"{whole:.0f}",
        "statements": f"{len(counted)}",
        "largest ratio": f"{worst[0]:.2f}",
        "at s": f"{worst[1]:.0f}",
        "left, stated": f"{worst[2]:.0f}",
        "left, true": f"{whole - worst[1]:.0f}",
        "at": worst[3],
    }
    note = f"{len(counted)} statements"
    quantity = "time left, stated over true or true over stated"
    return Row(case, quantity, worst[0], BOUND, note, seconds=whole, cpu_seconds=processor, figures=figures)
