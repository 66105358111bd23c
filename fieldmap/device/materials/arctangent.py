"""The arctangent law."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fieldmap.device.materials.base import TwoConstantLaw
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class Arctangent(TwoConstantLaw):
    """Arctangent law of the polarisation, which saturates more sharply.

    B - mu0 H = (2/pi) saturation arctan(pi chi mu0 H / (2 saturation)), chi = mu_r - 1.

    mu_r: initial relative permeability; saturation: polarisation at large H, T.
    """

    kind: ClassVar[str] = "arctangent"
    title: ClassVar[str] = "arctangent law"

    def polarisation(self, x: Array) -> Array:
        """J, T, at chi h / saturation = x."""
        return self.saturation * 2 / np.pi * np.arctan(0.5 * np.pi * x)

    def susceptibility(self, x: Array) -> Array:
        """dJ/dh at chi h / saturation = x."""
        return (self.mu_r - 1) / (1 + (0.5 * np.pi * x) ** 2)
