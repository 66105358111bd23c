"""The field that nothing in the device drives, [background]."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from fieldmap.device.air_sources import AirSourceKeys
from fieldmap.device.background import Background
from fieldmap.inputs.tables import MILLI, Point, Table, Vector, broken, read_only

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


class BackgroundKeys(Table):
    """A uniform flux density, with a uniform gradient or without."""

    attributes: ClassVar[Mapping[str, str]] = {"source": "sources"}

    flux_density_mT: Vector = Field(
        default=[0.0, 0.0, 0.0], description="[x, y, z] of the flux density at the centre"
    )
    gradient_mT_per_m: list[Any] | None = Field(
        default=None,
        description="[dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz], or all nine as three rows; 0 if left out",
        json_schema_extra=_GRADIENT,  # type: ignore[arg-type]
    )
    centre_mm: Point = Field(
        default=[0.0, 0.0, 0.0], description="[x, y, z] of the point at which the flux density is stated"
    )
    source: list[AirSourceKeys] = Field(
        default=[],
        description="[[background.source]] tables: magnets of fixed magnetisation, and other sources",
    )

    @field_validator("gradient_mT_per_m")
    @classmethod
    def _of_a_field(cls, value: list[Any] | None) -> list[Any] | None:
        if value is None:
            return None
        flat = [one for row in value for one in (row if isinstance(row, list) else [row])]
        shape = [len(row) if isinstance(row, list) else 1 for row in value]
        numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in flat)
        if not numbers or shape not in ([1] * 5, [3] * 3) or not np.isfinite(flat).all():
            raise broken(_SHAPE, str(value)[:120], "write finite numbers in this shape")
        if len(value) == 5:
            return value
        tensor = np.array(value, dtype=float)
        limit = _ROUNDING * np.abs(tensor).max()
        if np.abs(tensor - tensor.T).max() > limit:
            must_hold = "gradient_mT_per_m must be symmetric: dB_i/dx_j = dB_j/dx_i where no current flows"
            raise broken(must_hold, str(value)[:120], "correct it, or give the five independent numbers")
        if abs(np.trace(tensor)) > limit:
            must_hold = "gradient_mT_per_m must have no trace: dBx/dx + dBy/dy + dBz/dz = 0"
            received = f"{np.trace(tensor):g} mT/m"
            raise broken(must_hold, received, "correct it, or give the five independent numbers")
        return value

    def to_model(self) -> Background:
        """In SI."""
        gradient = None if self.gradient_mT_per_m is None else read_only(self.gradient_mT_per_m, MILLI)
        sources = tuple(source.to_model() for source in self.source)
        return Background(
            read_only(self.flux_density_mT, MILLI), gradient, read_only(self.centre_mm, MILLI), sources
        )
