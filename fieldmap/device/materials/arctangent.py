"""The arctangent law."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from fieldmap.device.materials.base import (
    Curves,
    InitialMuR,
    Material,
    Polarisation,
    SaturatingKeys,
    TwoConstantLaw,
)
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class Arctangent(TwoConstantLaw):
    """Polarisation (2/pi) saturation arctan(pi chi mu0 H / (2 saturation)), chi = mu_r - 1.

    mu_r: initial relative permeability; saturation: polarisation at large H, T.
    """

    title: ClassVar[str] = "arctangent law"

    def polarisation(self, x: Array) -> Array:
        """J, T, at chi h / saturation = x."""
        return self.saturation * 2 / np.pi * np.arctan(0.5 * np.pi * x)

    def susceptibility(self, x: Array) -> Array:
        """dJ/dh at chi h / saturation = x."""
        return (self.mu_r - 1) / (1 + (0.5 * np.pi * x) ** 2)


class ArctangentKeys(SaturatingKeys):
    """Arctangent law, which saturates more sharply."""

    attributes: ClassVar[Mapping[str, str]] = {"saturation_polarisation_T": "saturation"}

    material: ClassVar[type[Material]] = Arctangent
    rank: ClassVar[int] = 30

    kind: Literal["arctangent"] = Field(description="arctangent law of the polarisation")
    mu_r: InitialMuR = Field(description="initial relative permeability")
    saturation_polarisation_T: Polarisation = Field(description="B - mu0 H in saturation")

    def to_model(self, name: str, curves: Curves) -> Arctangent:
        """In SI."""
        return Arctangent(name, self.mu_r, self.saturation_polarisation_T, self.coercive_field_A_per_m)
