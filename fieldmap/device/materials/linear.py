"""Constant permeability."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import Field

from fieldmap.device.materials.base import Curves, Iron, Material, MaterialKeys
from fieldmap.inputs.tables import Positive


@dataclass(frozen=True, repr=False)
class LinearMaterial(Iron):
    """Constant relative permeability."""

    name: str
    mu_r: float

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
    """The law of what fills a joint."""
    return LinearMaterial(name, mu_r)


class LinearKeys(MaterialKeys):
    """Constant permeability."""

    material: ClassVar[type[Material]] = LinearMaterial
    rank: ClassVar[int] = 0

    kind: Literal["linear"] = Field(description="constant relative permeability")
    mu_r: Positive = Field(description="relative permeability")

    def to_model(self, name: str, curves: Curves) -> LinearMaterial:
        """In SI."""
        return LinearMaterial(name, self.mu_r)
