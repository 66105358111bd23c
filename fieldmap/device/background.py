"""A field that no current of the device drives: uniform, with a uniform gradient, or of sources in air."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.device.air_sources import AirSource, AirSourceKeys, sources_of
from fieldmap.device.made import Made
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Point, Vector, broken
from fieldmap.typing import Array

_FIVE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2))
"""Entries of a gradient that determine it: dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz."""


def gradient_tensor(values: Array) -> Array:
    """dB_i/dx_j (3, 3), given whole or by its five independent entries: dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz.

    >>> gradient_tensor(np.array([1.0, 0.0, 0.0, 1.0, 0.5])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.5, -2.0]]
    """
    if np.shape(values) == (3, 3):
        return np.asarray(values, dtype=float)
    tensor = np.zeros((3, 3))
    for (i, j), value in zip(_FIVE, values, strict=True):
        tensor[i, j] = tensor[j, i] = value
    tensor[2, 2] = -(tensor[0, 0] + tensor[1, 1])
    return tensor


# Rounding of decimal numbers, as a share of the largest entry.
_ROUNDING = 1e-9
_NUMBER = {"type": "number"}
_ROW = {"type": "array", "items": _NUMBER, "minItems": 3, "maxItems": 3}
_GRADIENT = {
    "items": {},
    "anyOf": [
        {"items": _NUMBER, "minItems": 5, "maxItems": 5},
        {"items": _ROW, "minItems": 3, "maxItems": 3},
    ],
}
_SHAPE = "gradient_mT_per_m is five numbers dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz, or three rows of three: dB_i/dx_j"
Gradient = Annotated[list[Any], Field(json_schema_extra=_GRADIENT)]  # type: ignore[arg-type]


def _require_field(value: list[Any] | None, info: ValidationInfo) -> None:
    """Raise unless the gradient is symmetric and without trace, as that of a field in a source-free region."""
    if value is None:
        return
    flat = [one for row in value for one in (row if isinstance(row, list) else [row])]
    shape = [len(row) if isinstance(row, list) else 1 for row in value]
    numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in flat)
    if not numbers or shape not in ([1] * 5, [3] * 3) or not np.isfinite(flat).all():
        raise broken(_SHAPE, str(value)[:120], "write finite numbers in this shape")
    if len(value) == 5:
        return
    tensor = np.array(value, dtype=float)
    limit = _ROUNDING * np.abs(tensor).max()
    if np.abs(tensor - tensor.T).max() > limit:
        must_hold = "gradient_mT_per_m must be symmetric: dB_i/dx_j = dB_j/dx_i where no current flows"
        raise broken(must_hold, str(value)[:120], "correct it, or give the five independent numbers")
    if abs(np.trace(tensor)) > limit:
        must_hold = "gradient_mT_per_m must have no trace: dBx/dx + dBy/dy + dBz/dz = 0"
        received = f"{np.trace(tensor):g} mT/m"
        raise broken(must_hold, received, "correct it, or give the five independent numbers")


@dataclass(frozen=True, eq=False, repr=False)
class Background(Made):
    """A field that no current of the device drives: uniform, with a uniform gradient or without, and sources in air.

    Examples are the fields of the earth and of magnets with fixed magnetisation.

    B(x) = flux_density + gradient (x - centre) + the fields of `sources`: flux_density (3,) in T; gradient dB_i/dx_j in
    T/m, (3, 3), symmetric and without trace as outside of all currents, or its five entries dBx/dx, dBx/dy, dBx/dz,
    dBy/dy, dBy/dz; None for a uniform field; centre (3,) in m; sources: magnets of fixed magnetisation and other
    sources in air (`fieldmap.device.air_sources`). Sources must lie outside of all bodies (a solver checks this), and
    the force on them is not computed. The background magnetises the iron and acts on everything in the device.

    >>> earth = Background([0.0, 20e-6, -44e-6])
    >>> print(earth.field(np.zeros((1, 3)))[0].tolist())
    [0.0, 2e-05, -4.4e-05]
    """

    flux_density: Annotated[Array, Key(Vector, "[x, y, z] of the flux density at the centre", "mT")] = (
        dataclasses.field(default_factory=lambda: np.zeros(3))
    )
    gradient: Annotated[
        Array | None,
        Key(
            Gradient | None,
            "[dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz], or all nine as three rows; 0 if left out",
            "mT_per_m",
            check=_require_field,
        ),
    ] = None
    centre: Annotated[
        Array, Key(Point, "[x, y, z] of the point at which the flux density is stated", "mm")
    ] = dataclasses.field(default_factory=lambda: np.zeros(3))
    sources: Annotated[
        tuple[AirSource, ...],
        Key(
            list[AirSourceKeys],
            "[[background.source]] tables: magnets of fixed magnetisation, and other sources",
            name="source",
        ),
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        given = (self.sources,) if isinstance(self.sources, AirSource) else tuple(self.sources)
        object.__setattr__(self, "sources", given)

    @classmethod
    def from_magpylib(cls, model: Any, **options: Any) -> Self:
        """A background of magpylib sources.

        Parameters
        ----------
        model
            A magpylib source, a Collection or a sequence of them.
        **options
            The other arguments of the class.

        Returns
        -------
        Self
            The background.

        Raises
        ------
        InputError
            For an object that is no source.
        """
        return cls(sources=tuple(sources_of(model)), **options)

    @property
    def unwritten(self) -> bool:
        """Whether a file cannot hold it, because a source is of the kind "other"."""
        return any(source.live is not None for source in self.sources)

    @property
    def description(self) -> str:
        """The field in words.

        >>> Background([0.0, 20e-6, -44e-6]).description
        '(0, 0.02, -0.044) mT'
        """
        flux = ", ".join(f"{1e3 * x:.4g}" for x in self.flux_density)
        count = len(self.sources)
        more = ["a gradient"] * (self.gradient is not None)
        more += [f"{count} source{'s' if count > 1 else ''} in air"] * (count > 0)
        return f"({flux}) mT" + (f", with {' and '.join(more)}" if more else "")

    @property
    def tensor(self) -> Array:
        """dB_i/dx_j (3, 3), T/m."""
        return np.zeros((3, 3)) if self.gradient is None else gradient_tensor(self.gradient)

    def field(self, points: Array) -> Array:
        """Flux density of the background.

        Parameters
        ----------
        points
            Positions (n, 3) in the frame of the device, m.

        Returns
        -------
        Array
            B (n, 3), T.
        """
        field = self.flux_density + (points - self.centre) @ self.tensor.T
        if self.sources:
            from fieldmap.device.air_fields import flux_density

            for source in self.sources:
                field += flux_density(source, points)
        return field

    def field_and_gradient(self, points: Array) -> tuple[Array, Array]:
        """Flux density and gradient of the background.

        Parameters
        ----------
        points
            Positions (n, 3) in the frame of the device, m.

        Returns
        -------
        tuple[Array, Array]
            B (n, 3), T, and dB_i/dx_j (n, 3, 3), T/m.
        """
        field = self.flux_density + (points - self.centre) @ self.tensor.T
        gradient = np.tile(self.tensor, (len(points), 1, 1))
        if self.sources:
            from fieldmap.device.air_fields import flux_density_and_gradient

            for source in self.sources:
                more, slope = flux_density_and_gradient(source, points)
                field, gradient = field + more, gradient + slope
        return field, gradient

    def is_kept_by(self, matrix: Array, offset: Array) -> bool:
        """Whether the background is its own image under x -> matrix x + offset.

        Flux density is an axial vector, B'(M x + t) = det(M) M B(x).

        Parameters
        ----------
        matrix
            Orthogonal matrix (3, 3).
        offset
            (3,), m.

        Returns
        -------
        bool
            True if it is.
        """
        if self.sources:  # their symmetry is not examined: only the identity counts
            return bool(np.array_equal(matrix, np.eye(3)) and not np.any(offset))
        handedness = np.sign(np.linalg.det(matrix))
        # Values at four points determine a linear function.
        places = np.vstack([np.zeros(3), np.eye(3)])
        moved = self.field(places @ matrix.T + offset)
        image = handedness * self.field(places) @ matrix.T
        return bool(np.abs(moved - image).max() <= 1e-6 * np.abs(self.field(places)).max())
