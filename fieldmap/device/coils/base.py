"""Base class of coils.

A shape of coil is a frozen class derived from `Coil`, in a module of its own in `fieldmap.device.coils`; no other code
names it. The annotations of its fields define the keys of a [[coil]] table (`fieldmap.inputs.declared`). Field, forces,
inductance, solids, symmetry and drawings use only its winding as arcs and bars (`Coil.winding`).
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Annotated, ClassVar, Literal, Self

from pydantic import ValidationInfo

from fieldmap.device.air_sources import AirSource
from fieldmap.device.coils.winding import WindingPath
from fieldmap.device.placement import Movable, Placement
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, Positive, broken, text_like
from fieldmap.typing import Array

# A coil's name becomes part of a record name in the map file: letters, digits and underscores only.
CoilName = Annotated[
    str,
    text_like(
        r"^[A-Za-z0-9_]+$",
        "a coil's name has letters, digits and underscores only",
        'rename it, for example "coil_1"',
    ),
]


# Fields that shapes share.
Named = Annotated[str, Key(CoilName, "the coil's name: letters, digits, underscores")]
Turns = Annotated[float, Key(Positive, "number of turns")]
Polarity = Annotated[
    int, Key(Literal[1, -1], "1: positive current runs counter-clockwise seen from local +z; -1: clockwise")
]
Resistance = Annotated[float | None, Key(Positive | None, "resistance of the winding", "ohm")]
Inductance = Annotated[float | None, Key(Positive | None, "inductance, alone in its iron", "mH")]
Thickness = Annotated[float, Key(Length, "width of the winding in the coil's plane", "mm")]
Height = Annotated[float, Key(Length, "length of the winding along its axis", "mm")]


def require_room_for_the_winding(corner_radius: float, info: ValidationInfo) -> None:
    """Refuse a winding thicker than twice its corner radius.

    Parameters
    ----------
    corner_radius
        Of the path, mm.
    info
        The other keys, as pydantic gives them.

    Raises
    ------
    ValueError
        For such a winding.
    """
    thickness = info.data.get("thickness_mm")
    if thickness is not None and corner_radius < thickness / 2:
        raise broken(
            f"corner_radius_mm must be at least thickness_mm/2 = {thickness / 2:g}",
            f"{corner_radius:g}",
            "give the radius of the winding's middle line: inner radius of the corner plus thickness/2",
        )


class Coil(Movable):
    """A coil: axis along local z, winding centred at the local origin, rectangular winding section.

    Positive current runs counter-clockwise seen from local +z at polarity 1. height: length of the winding along its
    axis, m. resistance in ohm and inductance in H, alone in its iron, where known.
    """

    kind: ClassVar[str]
    """The word for the shape in device files."""

    name: str
    height: float
    turns: float
    polarity: int
    placement: Placement
    resistance: float | None
    inductance: float | None

    @property
    def filaments(self) -> tuple[AirSource, ...]:
        """Line and sheet currents of a coil without a winding, local frame, per ampere-turn; empty otherwise."""
        return ()

    @property
    def has_winding(self) -> bool:
        """Whether there is a winding of rectangular section. A coil without one has no solid, and a self-inductance
        only if its wires are round."""
        return not self.filaments

    def reflected(self, axis: int) -> Self:
        """The mirror image of the winding; a symmetric winding is its own image.

        Parameters
        ----------
        axis
            Local axis, 0 or 1, that changes its sign.

        Returns
        -------
        Self
            The winding.
        """
        return self

    def _placed(self, change: Callable[[Placement], Placement], mirror_axis: int | None = None) -> Self:
        coil = self if mirror_axis is None else self.reflected(mirror_axis)
        return replace(coil, placement=change(coil.placement))  # zuban: ignore[misc]

    def _pattern(self) -> str:
        return self.name if "{k}" in self.name else self.name + "_{k}"

    @abstractmethod
    def winding(self) -> WindingPath:
        """Arcs and bars in the local frame, counter-clockwise for positive current at polarity 1.

        Raises InputError for dimensions that make no closed winding.
        """

    @cached_property
    def _path(self) -> WindingPath:
        """`winding()`, cached: it takes as long as the field at one point."""
        return self.winding()

    def unit_flux_density(self, points: Array, digits: float) -> Array:
        """Flux density per ampere-turn.

        Parameters
        ----------
        points
            Positions (n, 3) in the local frame, m.
        digits
            Decimal digits wanted.

        Returns
        -------
        Array
            B (n, 3), T.
        """
        from fieldmap.kernels.coils.path import path_flux_density

        path = self._path
        return path_flux_density(points, path.arcs, path.bars, path.thickness, path.height, digits)

    def unit_flux_density_and_gradient(self, points: Array, digits: float) -> tuple[Array, Array]:
        """Flux density and gradient per ampere-turn.

        Parameters
        ----------
        points
            Positions (n, 3) in the local frame, m.
        digits
            Decimal digits wanted.

        Returns
        -------
        tuple[Array, Array]
            B (n, 3), T, and dB_i/dx_j (n, 3, 3), T/m.
        """
        from fieldmap.kernels.coils.path import path_flux_density_and_gradient

        path = self._path
        return path_flux_density_and_gradient(
            points, path.arcs, path.bars, path.thickness, path.height, digits
        )
