"""How uncertain the predictions are: the three numbers that were fitted to Table 6-4, propagated linearly."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.thesis.printed import shared_value
from fieldmap.typing import Array

from .experiments import FIGURES, STEPS, step_figures
from .places import branch, gain, gain_of_lift
from .unit import Unit, unit

FITTED = {"joint, mm": (0.105, 0.137), "coercive field, A/m": (367.0, 477.0), "h, mm": (9.87, 13.97)}
"""Value of the device, and the value to which derivatives are taken: about a standard deviation of the fit away."""
DEVIATION, PRIOR_OF_H, MISFIT = 0.5, 4.3, 0.53
"""Of a reading, and of h before the fit, and what the fit left of Table 6-4, mm: scripts/studies/joint_study.py."""


@dataclass(frozen=True)
class Covariance:
    """Of the fitted numbers, (3, 3); misfit in Table 6-4 on the mesh of the map, which is not that of the fit, mm."""

    matrix: Array
    misfit: float

    @property
    def deviations(self) -> Array:
        """(3,)."""
        return np.sqrt(np.diag(self.matrix))

    @property
    def correlation(self) -> Array:
        """(3, 3)."""
        return self.matrix / np.outer(self.deviations, self.deviations)


def units(path: str, joint_path: str) -> dict[str, Unit]:
    """As fitted, and with each of the numbers changed. A changed force gets its own factor, as the lift at 10 mm is
    what the factor is for."""
    coercive, h = (FITTED[name][1] for name in ("coercive field, A/m", "h, mm"))
    return {
        "as fitted": unit(path),
        "joint, mm": unit(joint_path),
        "coercive field, A/m": unit(path, coercive / FITTED["coercive field, A/m"][0]),
        "h, mm": unit(path, h_mm=h),
    }


def derivatives(numbers: Mapping[str, Array]) -> Array:
    """(..., 3), from the numbers of all units."""
    steps = {name: after - before for name, (before, after) in FITTED.items()}
    # A run that does not settle has an infinite settling time, and no slope.
    with np.errstate(invalid="ignore"):
        return np.stack([(numbers[name] - numbers["as fitted"]) / steps[name] for name in FITTED], axis=-1)


def covariance(each: Mapping[str, Unit]) -> Covariance:
    """Of the fit, with derivatives on the map: from the readings and from what was known of h before."""
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
    """Of GAINS, by unit."""
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
