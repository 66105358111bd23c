"""Marrocco's reluctivity.

With s = B^(2 alpha) / (B^(2 alpha) + tau) the relative reluctivity is n = eps + (c - eps) s and

    mu0 dH/dB = d(n B)/dB = eps + (c - eps) (s + 2 alpha s (1 - s)),

which reaches 1 at the smaller root s of a quadratic. Beyond it the formula would lose polarisation with rising field.
"""

from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.device.materials.base import (
    LARGEST_POLARISATION_T,
    CoerciveField,
    LawPoints,
    SaturatingMaterial,
)
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Positive, broken

_SAMPLES = 600


def _require_saturation(value: float, info: ValidationInfo) -> None:
    known = info.data
    if not {"eps", "alpha", "tau"} <= set(known):
        return
    law = Marrocco("", known["eps"], value, known["alpha"], known["tau"])
    if not law.end <= 10 * LARGEST_POLARISATION_T:
        raise broken(
            "the slope dB/dH of Marrocco's formula must fall to that of free space, where iron is saturated",
            f"c = {value:g}, with which the iron never saturates",
            "raise c (near 1 is usual) or correct the other constants",
        )
    if law.largest_polarisation > LARGEST_POLARISATION_T:
        raise broken(
            f"the polarisation in saturation must be at most {LARGEST_POLARISATION_T:g} T",
            f"{law.largest_polarisation:.3g} T, from these constants",
            "lower tau: it is B^(2 alpha) at the knee, with B in T",
        )


@dataclass(frozen=True, repr=False)
class Marrocco(SaturatingMaterial):
    """Marrocco's formula for the reluctivity.

    H/B = (eps + (c - eps) B^(2 alpha) / (B^(2 alpha) + tau)) / mu0, B in T.

    The formula holds up to the flux density where its slope dB/dH has fallen to mu0; there the iron is saturated.
    """

    kind: ClassVar[str] = "marrocco"

    name: str
    eps: Annotated[float, Key(Annotated[float, Field(gt=0, lt=1)], "relative reluctivity at B = 0")]
    c: Annotated[
        float, Key(Positive, "relative reluctivity that the formula tends to", check=_require_saturation)
    ]
    alpha: Annotated[float, Key(Annotated[float, Field(ge=1, le=20)], "half the exponent of B")]
    tau: Annotated[float, Key(Positive, "B^(2 alpha) at the middle of the knee, B in T")]
    coercive_field: CoerciveField = 0.0

    @property
    def initial_mu_r(self) -> float:  # type: ignore[override]
        """Relative permeability at H = 0."""
        return 1 / self.eps

    @property
    def end(self) -> float:
        """Flux density in T at which mu0 dH/dB = 1; infinite if the formula never saturates.

        >>> round(Marrocco("sheet", 2e-4, 1.0, 5.5, 5e4).end, 3)
        2.169
        """
        if self.c <= self.eps:
            return inf
        linear, wanted = 1 + 2 * self.alpha, (1 - self.eps) / (self.c - self.eps)
        discriminant = linear**2 - 8 * self.alpha * wanted
        if discriminant < 0:
            return inf
        s = (linear - sqrt(discriminant)) / (4 * self.alpha)
        return (self.tau * s / (1 - s)) ** (0.5 / self.alpha) if s < 1 else inf

    def field_at(self, b: float) -> float:
        """The curve, by flux density.

        Parameters
        ----------
        b
            Flux density, T.

        Returns
        -------
        float
            mu0 H, T.
        """
        power = b ** (2 * self.alpha)
        return (self.eps + (self.c - self.eps) * power / (power + self.tau)) * b

    @property
    def largest_polarisation(self) -> float:
        """The polarisation where the formula ends, T."""
        end = self.end
        return end - self.field_at(end) if isfinite(end) else inf

    @property
    def field_range(self) -> tuple[float, float]:
        """mu0 H where the formula ends, T."""
        return inf, self.field_at(self.end)

    def fault(self) -> tuple[str, str] | None:
        """See `SaturatingMaterial.fault`."""
        positive = 0 < self.eps < 1 and self.alpha >= 1 and self.tau > 0
        if positive and isfinite(self.end):
            return None
        constants = self.eps, self.c, self.alpha, self.tau
        text = "the slope dB/dH must be positive and fall to that of free space"
        return text, f"eps, c, alpha, tau = {constants}"

    def points(self) -> LawPoints:
        """Samples at equal steps of B."""
        b = np.linspace(0.0, self.end, _SAMPLES)
        power = b ** (2 * self.alpha)
        s = power / (power + self.tau)
        span = self.c - self.eps
        field = (self.eps + span * s) * b
        reluctivity = self.eps + span * s * (1 + 2 * self.alpha * (1 - s))
        return LawPoints(field, b - field, 1 / reluctivity - 1)

    @property
    def description(self) -> str:
        """The law in words."""
        return f"Marrocco's formula, initial mu_r {1 / self.eps:g}, up to {self.end:.3g} T, slope mu0 above"
