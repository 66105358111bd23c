"""Hard magnetic material."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import Field

from fieldmap.device.materials.base import Curves, Material, MaterialKeys, Role
from fieldmap.inputs.tables import Positive, Vector, read_only
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class PermanentMagnet(Material):
    """Remanence (3,) in T, in the global frame, and recoil permeability."""

    role: ClassVar[Role] = "magnet"

    name: str
    remanence: Array
    mu_r: float

    @property
    def initial_mu_r(self) -> float:  # type: ignore[override]
        """The recoil permeability."""
        return self.mu_r

    @property
    def description(self) -> str:
        """The law in words."""
        return f"constant mu_r = {self.mu_r:g}"

    @property
    def likeness(self) -> tuple[object, ...]:
        """The recoil permeability."""
        return "magnet", self.mu_r


class PermanentMagnetKeys(MaterialKeys):
    """Hard magnetic material of constant remanence."""

    material: ClassVar[type[Material]] = PermanentMagnet
    rank: ClassVar[int] = 90

    kind: Literal["permanent_magnet"] = Field(description="constant remanence and recoil permeability")
    remanence_T: Vector = Field(description="[x, y, z] remanence in the device's frame")
    mu_r: Positive = Field(description="recoil permeability, 1.05 is usual for NdFeB")

    def to_model(self, name: str, curves: Curves) -> PermanentMagnet:
        """In SI."""
        return PermanentMagnet(name, read_only(self.remanence_T), self.mu_r)
