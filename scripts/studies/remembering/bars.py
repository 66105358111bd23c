"""Uncertainty of the predictions, by linear propagation from the three numbers that were fitted to Table 6-4."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.thesis.printed import shared_value
from fieldmap.typing import Array

from .experiments import FIGURES, STEPS, step_figures
from .places import branch, gain, gain_of_lift
from .unit import Unit, unit

FITTED = {"joint, mm": (0.105, 0.137), "coercive field, A/m": (367.0, 477.0), "h, mm": (9.87, 13.97)}
"""Value of the device, and a value about one standard deviation of the fit away, for difference quotients."""
DEVIATION, PRIOR_OF_H, MISFIT = 0.5, 4.3, 0.53
"""Standard deviation of a reading, of h before the fit, and misfit in Table 6-4, mm: scripts/studies/joint_study.py."""


@dataclass(frozen=True)
class Covariance:
    """Covariance (3, 3) of the fitted numbers; misfit in Table 6-4, mm, on the map's mesh, not the mesh of the fit."""

    matrix: Array
    misfit: float

    @property
    def deviations(self) -> Array:
        """Standard deviations (3,)."""
        return np.sqrt(np.diag(self.matrix))

    @property
    def correlation(self) -> Array:
        """Correlation matrix (3, 3)."""
        return self.matrix / np.outer(self.deviations, self.deviations)


def units(path: str, joint_path: str) -> dict[str, Unit]:
    """Units as fitted, and with each of the numbers changed. Each unit has its own force factor, which is defined by
    the lift at 10 mm."""
    coercive, h = (FITTED[name][1] for name in ("coercive field, A/m", "h, mm"))
    return {
        "as fitted": unit(path),
        "joint, mm": unit(joint_path),
        "coercive field, A/m": unit(path, coercive / FITTED["coercive field, A/m"][0]),
        "h, mm": unit(path, h_mm=h),
    }


def derivatives(numbers: Mapping[str, Array]) -> Array:
    """Derivatives (..., 3) by the fitted numbers, from the results of all units."""
    steps = {name: after - before for name, (before, after) in FITTED.items()}
    # The settling time of a run that does not settle is infinite, and its derivative NaN.
    with np.errstate(invalid="ignore"):
        return np.stack([(numbers[name] - numbers["as fitted"]) / steps[name] for name in FITTED], axis=-1)


def covariance(each: Mapping[str, Unit]) -> Covariance:
    """Covariance of the fit with derivatives on the map, from the readings and the prior of h."""
    places = {name: branch(one, "x", "positive")[1:] for name, one in each.items()}
    out, back = (
        np.asarray(shared_value(f"table_6_4.{what}"), dtype=float) for what in ("outward_mm", "back_mm")
    )
    measured = np.concatenate([out[1:], back[-2::-1]]) - out[0]
    misfit = float(np.sqrt(np.mean((places["as fitted"] - measured) ** 2)))
    slopes = derivatives(places) / DEVIATION
    information = slopes.T @ slopes + np.diag([0.0, 0.0, PRIOR_OF_H**-2])
    return Covariance((MISFIT / DEVIATION) ** 2 * np.linalg.inv(information), misfit)


def bar(found: Covariance, numbers: Mapping[str, Array]) -> Array:
    """Standard deviations of numbers."""
    slopes = derivatives(numbers)
    return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", slopes, found.matrix, slopes)))


GAINS: dict[str, Callable[[Unit], float]] = {
    "x, loop of 0.005, mm per unit": lambda one: gain(one, "x", 0.005),
    "x, loop of 0.1": lambda one: gain(one, "x", 0.1),
    "x, loop of 0.2": lambda one: gain(one, "x", 0.2),
    "y, loop of 0.005": lambda one: gain(one, "y", 0.005),
    "y, loop of 0.1": lambda one: gain(one, "y", 0.1),
    "lift, loop of 2 %": lambda one: gain_of_lift(one, 0.02),
}


def gains(each: Mapping[str, Unit]) -> dict[str, dict[str, Array]]:
    """The values of GAINS, by unit."""
    return {words: {name: np.array(of(one)) for name, one in each.items()} for words, of in GAINS.items()}


def steps(each: Mapping[str, Unit], derivative: str) -> dict[str, dict[str, Array]]:
    """Means of the figures of Tables 7-1 and 7-2, by unit."""
    found: dict[str, dict[str, Array]] = {}
    for step in STEPS:
        rows = {
            name: step_figures(replace(one, derivative=derivative), step).mean(axis=0)
            for name, one in each.items()
        }
        for k, figure in enumerate(FIGURES):
            found[f"{step.name}, {figure}"] = {name: row[k] for name, row in rows.items()}
    return found
