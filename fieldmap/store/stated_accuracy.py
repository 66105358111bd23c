"""Maps of saturating iron that missed the accuracy of their recipe: the errors in their reports, and the warning."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fieldmap.curves import percent
from fieldmap.errors import MapAccuracyWarning
from fieldmap.records import Record

HELD_OUT = 2.0
"""Allowed error at a tested state, as a multiple of the accuracy of the recipe."""
GRADIENT = 2.0
"""Allowed relative error of the gradient, as a multiple of the allowed relative error of the flux density."""

# Python shows a warning once for each line of code. This filter shows it each time that such a map is opened. It is the
# last filter, so that those of the importing program have priority.
warnings.simplefilter("always", MapAccuracyWarning, append=True)


@dataclass(frozen=True)
class MissedAccuracy(Record):
    """The largest errors of a current model that missed its accuracy.

    Attributes
    ----------
    flux_density_share, gradient_share : largest errors, as shares of the largest B and gradient of the same state.
    asked : accuracy of the recipe, a share of B.
    states : number of tested states.
    """

    flux_density_share: float
    gradient_share: float
    asked: float
    states: int

    @property
    def largest_share(self) -> float:
        """`largest_share` of the two shares."""
        return largest_share(self.flux_density_share, self.gradient_share)

    @property
    def text(self) -> str:
        """The errors found and the accuracy of the recipe, in words."""
        found = f"{percent(self.flux_density_share)} of B and {percent(self.gradient_share)} of the gradient"
        return f"current model off by up to {found} ({percent(self.asked)} of B asked for)"


def missed_accuracy(report: Mapping[str, Any]) -> MissedAccuracy | None:
    """Find out from the report of a map whether it missed its accuracy.

    The allowed error of B is `HELD_OUT` times the accuracy, and the allowed error of the gradient `GRADIENT` times it.

    Parameters
    ----------
    report
        Solver report of the map.

    Returns
    -------
    MissedAccuracy | None
        The errors if they are larger; None if they are not, or if the report does not state accuracy and
        errors, as for maps of linear iron and of other programs.
    """
    try:
        within, tried = float(report["held_out_within"]), list(report["states_tried"].values())
        flux, gradient = (
            max(float(found[name]) for found in tried) for name in ("flux_density_share", "gradient_share")
        )
        states = sum(int(found["states"]) for found in tried)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    if flux <= within and gradient <= GRADIENT * within:
        return None
    return MissedAccuracy(flux, gradient, within / HELD_OUT, states)


def warn_of_missed_accuracy(
    path: str | os.PathLike[str], report: Mapping[str, Any], stacklevel: int = 1
) -> None:
    """Warn (MapAccuracyWarning) if a map missed its accuracy.

    Parameters
    ----------
    path
        Path of the map, for the text.
    report
        Solver report of the map.
    stacklevel
        As of `warnings.warn` in the function that calls this one.
    """
    missed = missed_accuracy(report)
    if missed is not None:
        warnings.warn(f"{path}: {missed.text}", MapAccuracyWarning, stacklevel=stacklevel + 1)


def largest_share(of_flux_density: float, of_gradient: float) -> float:
    """The larger of two relative errors: of B, and of the gradient over `GRADIENT`."""
    return max(of_flux_density, of_gradient / GRADIENT)
