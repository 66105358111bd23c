"""The law of Froehlich and Kennelly."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

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
class Froehlich(TwoConstantLaw):
    """Froehlich-Kennelly: polarisation B - mu0 H = chi mu0 H / (1 + chi mu0 H / saturation), chi = mu_r - 1.

    mu_r: initial relative permeability; saturation: polarisation at large H, T.
    """

    title: ClassVar[str] = "Froehlich-Kennelly law"

    def polarisation(self, x: Array) -> Array:
        """J, T, at chi h / saturation = x."""
        return self.saturation * x / (1 + x)

    def susceptibility(self, x: Array) -> Array:
        """dJ/dh at chi h / saturation = x."""
        return (self.mu_r - 1) / (1 + x) ** 2


class FroehlichKeys(SaturatingKeys):
    """Froehlich-Kennelly law."""

    attributes: ClassVar[Mapping[str, str]] = {"saturation_polarisation_T": "saturation"}

    material: ClassVar[type[Material]] = Froehlich
    rank: ClassVar[int] = 20

    kind: Literal["froehlich"] = Field(description="Froehlich-Kennelly law of the polarisation")
    mu_r: InitialMuR = Field(description="initial relative permeability")
    saturation_polarisation_T: Polarisation = Field(description="B - mu0 H in saturation")

    def to_model(self, name: str, curves: Curves) -> Froehlich:
        """In SI."""
        return Froehlich(name, self.mu_r, self.saturation_polarisation_T, self.coercive_field_A_per_m)
