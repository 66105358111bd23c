"""The law of Froehlich and Kennelly."""

from dataclasses import dataclass
from typing import ClassVar

from fieldmap.device.materials.base import TwoConstantLaw
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class Froehlich(TwoConstantLaw):
    """Froehlich-Kennelly law of the polarisation.

    B - mu0 H = chi mu0 H / (1 + chi mu0 H / saturation), chi = mu_r - 1.

    mu_r: initial relative permeability; saturation: polarisation at large H, T.
    """

    kind: ClassVar[str] = "froehlich"
    title: ClassVar[str] = "Froehlich-Kennelly law"

    def polarisation(self, x: Array) -> Array:
        """J, T, at chi h / saturation = x."""
        return self.saturation * x / (1 + x)

    def susceptibility(self, x: Array) -> Array:
        """dJ/dh at chi h / saturation = x."""
        return (self.mu_r - 1) / (1 + x) ** 2
