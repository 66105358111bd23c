"""Rows S16 to S18 of the thesis with and without the electrical side: the table of docs/thesis_dynamics.md.

Both use the same scenarios on the same map. Without: current sources, with R and L of Table 3-1 for each coil alone.
With: coils coupled by the map's flux linkages, the thesis's resistances, and its amplifier as a current controller with
a limited supply voltage.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from fieldmap.dynamics import simulate
from fieldmap.thesis.coupled_runs import DEPTH, Readings, X, Y, run_of
from fieldmap.thesis.detail import available_map
from fieldmap.thesis.horizontal import fitted_times
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.vertical_records import identified
from validation.row import Row, timed
from validation.thesis_dynamics import printed

HEADING = "The electrical side"
BANDWIDTHS = (100.0, 1000.0)
"""Bandwidths of the amplifier's controller, Hz, which the thesis does not state; the results are nearly the same."""
LOWEST = {"-40 to 40 V": -40.0, "0 to 40 V": 0.0}
"""Lowest voltage, V, by column. The thesis does not state whether the amplifier reverses the supply."""
Inputs = dict[str, Any]


def with_drive(lowest: float, bandwidth: float = BANDWIDTHS[0]) -> Callable[..., Any]:
    """`simulate` with coupled coils."""
    electrical = {"coils.drive": "current_controller", "coils.controller.bandwidth_Hz": bandwidth}
    electrical["coils.lowest_voltage_V"] = lowest

    def run(scenario: str, changes: dict[str, Any], field_map: Any) -> Any:
        return simulate(scenario, {**changes, **electrical}, field_map=field_map)

    return run


def vertical(inputs: Inputs) -> dict[str, float]:
    """Table 7-1."""
    run = run_of(inputs, "vertical_step")
    peak, rise, settling, overshoot = run.column(DEPTH)
    return {
        "Table 7-1, peak time, s": peak,
        "Table 7-1, rise time, 10 to 90 %, s": rise,
        "Table 7-1, until the reference is reached, s": run.time_to_reference(DEPTH, 1.0),
        "Table 7-1, settling time, s": settling,
        "Table 7-1, overshoot, %": overshoot,
        "Table 7-1, RMS at rest, mm": run.rms(DEPTH, 0.75 * run.time[-1]),
    }


def horizontal(inputs: Inputs) -> dict[str, float]:
    """Table 7-2."""
    found = {}
    for axis, name in ((X, "x"), (Y, "y")):
        run = run_of(inputs, "horizontal_pid", {"reference.0.axis": name})
        found[f"Table 7-2, rise time of {name}, s"] = run.column(axis)[1]
        found[f"Table 7-2, overshoot of {name}, %"] = run.column(axis)[3]
    return found


def records(inputs: Inputs) -> dict[str, float]:
    """Table 5-2, and the integral times of 6.7."""
    found: dict[str, float] = {}
    steps, pairs, _ = identified(read_part("S16_records").inputs | inputs)
    for gain, pair in zip(steps, pairs, strict=True):
        found[f"Table 5-2, pole at {gain:g} V/mm, real"] = pair.real
        found[f"Table 5-2, pole at {gain:g} V/mm, imaginary"] = pair.imag
    *_, times = fitted_times(read_part("S17_records").inputs | inputs)
    return found | {f"6.7, integral time {k + 1} of the model, s": t for k, t in enumerate(times)}


def regulated(inputs: Inputs) -> dict[str, float]:
    """Table 7-3."""
    run = run_of(inputs, "regulator", {"noise.off": True})
    names = ("peak time, s", "rise time, 10 to 90 %, s", "settling time, s", "overshoot, %")
    return {f"Table 7-3, {name}": value for name, value in zip(names, run.column(DEPTH), strict=True)}


def spikes(inputs: Inputs) -> dict[str, float]:
    """7.1.2."""
    run: Readings = run_of(inputs, "spikes")
    return {"7.1.2, spike of the height, mm": run.departure(DEPTH, 1.0)}


EXPERIMENTS = (vertical, horizontal, records, regulated, spikes)


def electrical_side() -> Iterator[Row]:
    """Needs the map of `fieldmap map division_electrical`."""
    opened = available_map("division_electrical")
    drives = {"without": simulate} | {name: with_drive(volts) for name, volts in LOWEST.items()}
    found: dict[str, dict[str, float]] = {}
    spent = 0.0
    for name, run in drives.items():
        given = {"map": opened, "simulate": run}
        found[name], _, cpu = timed(lambda given=given: _all(given))
        spent += cpu
    columns = list(found)
    worst = 0.0
    for quantity in found["without"]:
        ours = [found[name][quantity] for name in columns]
        rig, *texts = printed(HEADING, quantity, (1, 2, 3, 4))
        worst = max(worst, *(_distance(text, value) for text, value in zip(texts, ours, strict=True)))
        figures = {"": quantity, "rig": rig}
        figures |= {name: _written(v, text) for name, v, text in zip(columns, ours, texts, strict=True)}
        yield Row(quantity, f"{columns[1]} less without", ours[1] - ours[0], None, "", figures=figures)
    what = "largest distance of the page's numbers from the run, units of the last digit"
    yield Row(
        "rows S16 to S18, electrical side", what, worst, 1.0, "docs/thesis_dynamics.md", cpu_seconds=spent
    )
    again = vertical({"map": opened, "simulate": with_drive(LOWEST[columns[1]], BANDWIDTHS[1])})
    off = [abs(again[name] / found[columns[1]][name] - 1.0) for name in again]
    what = f"Table 7-1, amplifier of {BANDWIDTHS[1]:g} against {BANDWIDTHS[0]:g} Hz, largest relative change"
    yield Row("rows S16 to S18, electrical side", what, float(np.max(off)), 0.02, "")


def _all(inputs: Inputs) -> dict[str, float]:
    found: dict[str, float] = {}
    for experiment in EXPERIMENTS:
        found |= experiment(inputs)
    return found


def _distance(text: str, value: float) -> float:
    """Distance of a printed number from a value, in units of its last digit."""
    return abs(float(text) - value) * 10.0 ** len(text.partition(".")[2])


def _written(value: float, text: str) -> str:
    return f"{value:.{len(text.partition('.')[2])}f}"
