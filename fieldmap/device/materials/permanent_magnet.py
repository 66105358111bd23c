"""Hard magnetic material."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from fieldmap.device.materials.base import LARGEST_POLARISATION_T, Material, Role
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Positive
from fieldmap.typing import Array

_Component = Annotated[float, Field(ge=-LARGEST_POLARISATION_T, le=LARGEST_POLARISATION_T)]
_Remanence = Annotated[list[_Component], Field(min_length=3, max_length=3)]


@dataclass(frozen=True, eq=False, repr=False)
class PermanentMagnet(Material):
    """Constant remanence and recoil permeability.

    remanence (3,) in T, in the global frame.
    """

    kind: ClassVar[str] = "permanent_magnet"
    role: ClassVar[Role] = "magnet"

    name: str
    remanence: Annotated[Array, Key(_Remanence, "[x, y, z] remanence in the device's frame", "T")]
    mu_r: Annotated[float, Key(Positive, "recoil permeability, 1.05 is usual for NdFeB")]

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
