"""S19: circles on the map under PID, 7.3."""

from typing import Any, NamedTuple

import numpy as np

from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import DEPTH, Readings, X, Y, in_the_plane, ours, over_time, run_of


class Followed(NamedTuple):
    """How a circle is followed: radius over the reference's, angle behind it, deg, and RMS of what is left, mm."""

    share: float
    lag_deg: float
    rest_mm: float

    @property
    def growth(self) -> float:
        """Of the radius: share - 1."""
        return self.share - 1.0


def circles(inputs: dict[str, Any]) -> Answers:
    """RMS of the height on each circle, at rest, and what becomes of radius and phase."""
    radii, rates, settled = inputs["radii_mm"], inputs["rates_rad_per_s"], float(inputs["settled_s"])
    rest = run_of(inputs, "circle", {"reference": [], "duration_s": 12.0})
    runs = {}
    for r, rate, turns in zip(radii, rates, inputs["turns"], strict=True):
        end = np.ceil(8.0 + 2 * np.pi * turns / rate)
        changes = {
            "reference.0.radius_mm": float(r),
            "reference.0.rate_rad_per_s": float(rate),
            "duration_s": float(end),
        }
        runs[f"{r:g} mm, {rate:g} rad/s"] = run_of(inputs, "circle", changes)
    every = tuple(runs.values())
    rms = [run.rms(DEPTH, settled) for run in every]
    numbers = {
        "vertical_rms": ours(rms, *every),
        "rms_at_rest": ours(rest.rms(DEPTH, 2.0), rest),
        "growth": ours(rms[1] / rms[0], *every[:2]),
        "speed": [float(r * w) for r, w in zip(radii[:2], rates[:2], strict=True)],
    }
    followed = [follows(run, float(rate), settled) for run, rate in zip(every, rates, strict=True)]
    return Answers(numbers, _figures(runs, settled), {"followed": followed})


def follows(run: Readings, rate: float, begin: float) -> Followed:
    """The turning part of the true path against that of the reference, by least squares."""
    rows = run.during(begin)
    turning = np.exp(1j * rate * run.time[rows])
    basis = np.column_stack([turning, turning.conj(), np.ones(rows.sum())])
    path, wanted = ((p[rows, X] + 1j * p[rows, Y]) for p in (run.true, run.wanted))
    found = np.linalg.lstsq(basis, path, rcond=None)[0]
    ratio = found[0] / np.linalg.lstsq(basis, wanted, rcond=None)[0][0]
    rest = np.sqrt(np.mean(np.abs(path - found[0] * turning) ** 2))
    return Followed(float(abs(ratio)), float(-np.rad2deg(np.angle(ratio))), float(rest))


def _figures(runs: dict[str, Readings], settled: float) -> tuple[Any, ...]:
    paths = [
        in_the_plane(f"Fig. {figure}: circle of {name}", {"path": run}, settled)
        for figure, (name, run) in zip(("7-24", "7-27", "7-29"), runs.items(), strict=False)
    ]
    name, first = next(iter(runs.items()))
    in_time = [
        over_time(f"Fig. 7-25: {letter} over time, {name}", axis, {letter: first}, begin=settled)
        for letter, axis in (("x", X), ("y", Y))
    ]
    height = over_time("Figs 7-26, 7-28, 7-30: the height meanwhile", DEPTH, runs, begin=settled)
    return (*paths, *in_time, height)
