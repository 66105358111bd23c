"""Maps of saturating iron that are less accurate than was asked for: how their reports tell, and the warning."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fieldmap.errors import MapAccuracyWarning
from fieldmap.records import Record

HELD_OUT = 2.0
"""States at which a current model is tried may be off by so many times the accuracy that was asked for."""
GRADIENT = 2.0
"""A gradient may be off by so much more than a flux density, each as a share of its largest."""

# Each time that such a map is opened, not once for each line that opens some. Behind all other rules, so that those of
# the program that imports this hold.
warnings.simplefilter("always", MapAccuracyWarning, append=True)


@dataclass(frozen=True)
class MissedAccuracy(Record):
    """The largest errors of a current model at the states at which it was tried, beyond what was asked for.

    flux_density_share, gradient_share: of the state's largest B and gradient; asked: the accuracy of the recipe, a
    share of B; states: at how many they were looked for.
    """

    flux_density_share: float
    gradient_share: float
    asked: float
    states: int

    @property
    def largest_share(self) -> float:
        """`largest_share` of both."""
        return largest_share(self.flux_density_share, self.gradient_share)

    @property
    def text(self) -> str:
        """What a person reads: the errors found and what was asked for."""
        found = f"{percent(self.flux_density_share)} of B and {percent(self.gradient_share)} of the gradient"
        return f"current model off by up to {found} ({percent(self.asked)} of B asked for)"


def missed_accuracy(report: Mapping[str, Any]) -> MissedAccuracy | None:
    """What the report of a map says of its current model, if its largest error is more than twice what was asked for:
    `HELD_OUT` times the accuracy of B, and `GRADIENT` times that of the gradient. None where it is within that, where
    nothing was tried, and for reports that do not say what was asked for or found, as those of other programs."""
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
    """Warn (MapAccuracyWarning) if a map, by its report, is less accurate than was asked for. stacklevel: as of
    `warnings.warn` in the function that calls this."""
    missed = missed_accuracy(report)
    if missed is not None:
        warnings.warn(f"{path}: {missed.text}", MapAccuracyWarning, stacklevel=stacklevel + 1)


def largest_share(of_flux_density: float, of_gradient: float) -> float:
    """That of B, or that of the gradient over `GRADIENT`, whichever is larger: to compare with the accuracy."""
    return max(of_flux_density, of_gradient / GRADIENT)


def percent(share: float) -> str:
    """A share with two digits.

    >>> percent(0.6149), percent(0.002), percent(12.0)
    ('61 %', '0.2 %', '1200 %')
    """
    return f"{float(f'{100 * share:.2g}'):g} %"
