"""Ideal flux barriers."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import Field

from fieldmap.device.materials.base import NO_REMANENCE, Curves, Material, MaterialKeys, Role


@dataclass(frozen=True, repr=False)
class FluxBarrier(Material):
    """Ideal flux barrier, mu -> 0: no flux passes its surface. Each model puts a small permeability in its place."""

    role: ClassVar[Role] = "flux barrier"
    initial_mu_r = 0.0
    remanence = NO_REMANENCE

    name: str

    @property
    def description(self) -> str:
        """The law in words."""
        return "an ideal flux barrier"


class FluxBarrierKeys(MaterialKeys):
    """Ideal flux barrier."""

    material: ClassVar[type[Material]] = FluxBarrier
    rank: ClassVar[int] = 80

    kind: Literal["flux_barrier"] = Field(description="ideal flux barrier, mu -> 0")

    def to_model(self, name: str, curves: Curves) -> FluxBarrier:
        """In SI."""
        return FluxBarrier(name)
