"""What either form of the iron problem leaves: charges for the air, flux densities for the inside."""

from dataclasses import dataclass
from typing import Protocol

from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.typing import Array, Index


class ElementField(Protocol):
    """The field inside elements, as exactly as a form knows it."""

    def flux_density(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3) in T of every source at points (n, 4), in barycentric coordinates of elements (n,)."""
        ...

    def polarisation(self, element: Index, barycentric: Array) -> Array:
        """mu0 M (c, n, 3) in T; otherwise as `flux_density`."""
        ...


@dataclass(frozen=True, eq=False)
class IronState:
    """Solved iron for one or several sources (columns c).

    faces: the m charged faces; density (c, m) in T: mu0 times magnetic charge per area; flux_density (c, e, 3):
    mean of every element, T; iterations: steps of the solver; residuals: its history, relative, worst column;
    inside: the field within elements, None for states that were read back from a file.
    """

    faces: ChargedFaces
    density: Array
    flux_density: Array
    iterations: int
    residuals: tuple[float, ...]
    inside: ElementField | None = None

    def flux_density_at(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3) at points (n, 4) of elements (n,), see `ElementField`; where that is not kept, their means."""
        if self.inside is None:
            return self.flux_density[:, element]
        return self.inside.flux_density(element, barycentric)
