"""Coils made of magpylib sources: loops, polylines, sheets, strips, and any other class."""

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field

from fieldmap.device.air_sources import AirSource, AirSourceKeys, per_ampere, sources_of
from fieldmap.device.coils.base import Coil, Inductance, Named, Polarity, Resistance
from fieldmap.device.coils.winding import WindingPath
from fieldmap.device.placement import Placement
from fieldmap.errors import InputError
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, Positive
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class MagpylibCoil(Coil):
    """Currents of magpylib's kinds, driven together.

    B is current x turns x polarity times the sum of the fields of `sources`.

    sources: with their currents for 1 A in the coil. nominal_current: current of the coil in its original model, A, if
    known. wire_diameter: of loops and polylines, m; without it they have no self-inductance. Filaments and sheets have
    no winding of rectangular section. The force on them can be computed, their resistance cannot.
    """

    kind: ClassVar[str] = "magpylib"

    name: Named
    sources: Annotated[
        tuple[AirSource, ...],
        Key(
            Annotated[list[AirSourceKeys], Field(min_length=1)],
            "[[coil.source]] tables: with their currents for 1 A in the coil",
            name="source",
        ),
    ]
    turns: Annotated[float, Key(Positive, "number of turns: factor of the sources' currents")] = 1.0
    polarity: Polarity = 1
    placement: Placement = field(default_factory=Placement)
    nominal_current: Annotated[
        float | None, Key(float | None, "the coil's current in the original model", "A")
    ] = None
    resistance: Resistance = None
    inductance: Inductance = None
    wire_diameter: Annotated[
        float | None,
        Key(
            Length | None,
            "diameter of the round wire of loops and polylines, for their self-inductance",
            "mm",
        ),
    ] = None

    def __post_init__(self) -> None:
        given = (self.sources,) if isinstance(self.sources, AirSource) else tuple(self.sources)
        object.__setattr__(self, "sources", given)

    @classmethod
    def from_magpylib(cls, name: str, model: Any, **options: Any) -> Self:
        """A coil of magpylib sources that are driven together.

        Currents are divided by the first current that is not zero: of two strands that carry 2 A and 3 A, the second
        has 1.5 A per ampere of the coil. At the nominal current the coil has the field of the model: it is the first
        current over turns and polarity, so that ampere-turns of the model become the current of a winding. The field of
        a magnet or any other source counts as its field at 1 A.

        Parameters
        ----------
        name
            Of the coil.
        model
            A magpylib source, a Collection or a sequence of them.
        **options
            The other arguments of the class.

        Returns
        -------
        Self
            The coil.

        Raises
        ------
        InputError
            For an object that is no source.
        """
        sources = sources_of(model)
        first = next((source.current for source in sources if source.current), None)
        shares = tuple(per_ampere(source, first) for source in sources)
        coil = cls(name, shares, **options)
        if first is None or "nominal_current" in options:
            return coil
        return replace(coil, nominal_current=first / (coil.turns * coil.polarity))

    @property
    def filaments(self) -> tuple[AirSource, ...]:
        """The sources."""
        return self.sources

    @property
    def unwritten(self) -> bool:
        """Whether a file cannot hold it, because a source is of the kind "other"."""
        return any(source.live is not None for source in self.sources)

    @property
    def height(self) -> float:  # type: ignore[override]
        """Zero, since there is no winding."""
        return 0.0

    def winding(self) -> WindingPath:
        """Raises InputError, since there is no winding."""
        must_hold, remedy = "a winding of rectangular section is needed", "give a coil of another kind"
        raise InputError.of(f"coil {self.name!r}", must_hold, "magpylib sources", remedy)

    def reflected(self, axis: int) -> Self:
        """Raises InputError: mirror the model in magpylib."""
        remedy = "mirror the sources in magpylib"
        raise InputError.of("mirrored", "a coil that can be mirrored", f"coil {self.name!r}", remedy)

    def unit_flux_density(self, points: Array, digits: float) -> Array:
        """As `Coil.unit_flux_density`; exact, whatever the digits."""
        from fieldmap.device.air_fields import flux_density

        return np.sum([flux_density(source, points) for source in self.sources], axis=0)

    def unit_flux_density_and_gradient(self, points: Array, digits: float) -> tuple[Array, Array]:
        """As `Coil.unit_flux_density_and_gradient`; see `fieldmap.device.air_fields` for the gradient."""
        from fieldmap.device.air_fields import flux_density_and_gradient

        pairs = [flux_density_and_gradient(source, points) for source in self.sources]
        return np.sum([pair[0] for pair in pairs], axis=0), np.sum([pair[1] for pair in pairs], axis=0)
