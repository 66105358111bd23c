"""Ideal flux barriers."""

from dataclasses import dataclass
from typing import ClassVar

from fieldmap.device.materials.base import NO_REMANENCE, Material, Role


@dataclass(frozen=True, repr=False)
class FluxBarrier(Material):
    """Ideal flux barrier, mu -> 0.

    No flux passes its surface. Each model replaces it by a small permeability.
    """

    kind: ClassVar[str] = "flux_barrier"
    role: ClassVar[Role] = "flux barrier"
    initial_mu_r = 0.0
    remanence = NO_REMANENCE

    name: str

    @property
    def description(self) -> str:
        """The law in words."""
        return "an ideal flux barrier"
