"""Constant permeability."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from fieldmap.device.materials.base import Iron
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Positive


@dataclass(frozen=True, repr=False)
class LinearMaterial(Iron):
    """Constant relative permeability."""

    kind: ClassVar[str] = "linear"

    name: str
    mu_r: Annotated[float, Key(Positive, "relative permeability")]

    @property
    def initial_mu_r(self) -> float:  # type: ignore[override]
        """Relative permeability."""
        return self.mu_r

    @property
    def description(self) -> str:
        """The law in words."""
        return f"linear, mu_r = {self.mu_r:g}"

    @property
    def likeness(self) -> tuple[object, ...]:
        """The permeability."""
        return "linear", self.mu_r


def of_permeability(name: str, mu_r: float) -> LinearMaterial:
    """The law of the material in a joint."""
    return LinearMaterial(name, mu_r)
