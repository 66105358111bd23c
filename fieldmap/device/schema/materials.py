"""Materials: [material.NAME] tables and the files of measured B-H curves."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, Tag, ValidationInfo, field_validator
from scipy.constants import mu_0

from fieldmap.device import model
from fieldmap.device.schema.base import Positive, Table, Text, Vector, broken, chosen_with, read_only

# Rounding of printed tables may put a saturated slope a little below mu0; more than this is unphysical.
SMALLEST_SLOPE = 0.99 * mu_0
FROM_A_FILE = "bh_table from a file"

Curve = Annotated[list[Positive], Field(min_length=2)]
Curves = Mapping[str, tuple[list[float], list[float]]]


class CurveKeys(Table):
    """The points of a single-valued B-H curve, origin left out."""

    H_A_per_m: Curve = Field(description="field strengths, strictly increasing, without the origin")
    B_T: Curve = Field(description="flux densities, one for each field strength, strictly increasing")

    @field_validator("H_A_per_m")
    @classmethod
    def _increasing(cls, value: list[float]) -> list[float]:
        _require_increasing("H_A_per_m", value)
        return value

    @field_validator("B_T")
    @classmethod
    def _physical(cls, value: list[float], info: ValidationInfo) -> list[float]:
        _require_increasing("B_T", value)
        h = info.data.get("H_A_per_m")
        if h is not None:
            _require_same_length(h, value)
            _require_slope(h, value)
        return value


def _require_increasing(key: str, values: list[float]) -> None:
    steps = np.flatnonzero(np.diff(values) <= 0)
    if steps.size:
        k = int(steps[0])
        raise broken(
            f"{key} must be strictly increasing",
            f"{values[k + 1]:g} after {values[k]:g} (points {k + 1} and {k + 2})",
            "sort the points, and remove repeated ones and the falling branch of a hysteresis loop",
        )


def _require_same_length(h: list[float], b: list[float]) -> None:
    if len(h) != len(b):
        raise broken(
            "H_A_per_m and B_T must have the same number of values",
            f"{len(h)} and {len(b)} values",
            "give one B for each H",
        )


def _require_slope(h: list[float], b: list[float]) -> None:
    slopes = np.diff(b, prepend=0.0) / np.diff(h, prepend=0.0)
    flat = np.flatnonzero(slopes < SMALLEST_SLOPE)
    if flat.size:
        k = int(flat[0])
        before = "the origin" if k == 0 else f"point {k}"
        raise broken(
            "the slope dB/dH must nowhere be below that of free space, mu0 = 1.2566e-6 T m/A",
            f"slope {slopes[k]:.4g} T m/A from {before} to point {k + 1}",
            "check the unit of H (A/m, not kA/m or Oe) and that B is the flux density, not mu0 M",
        )


class LinearKeys(Table):
    """Constant permeability."""

    kind: Literal["linear"] = Field(description="constant relative permeability")
    mu_r: Positive = Field(description="relative permeability")

    def to_model(self, name: str, curves: Curves) -> model.LinearMaterial:
        """In SI."""
        return model.LinearMaterial(name, self.mu_r)


class _ExtensionKeys(Table):
    kind: Literal["bh_table"] = Field(description="B-H table")
    below: Literal["straight line to the origin"] = Field(
        description='law below the first point: "straight line to the origin"'
    )
    above: Literal["slope mu0"] = Field(description='law past the last point: "slope mu0" (saturated)')

    def _table(self, name: str, h: list[float], b: list[float]) -> model.BHTable:
        initial_mu_r = b[0] / (mu_0 * h[0])
        return model.BHTable(name, read_only(h), read_only(b), self.below, self.above, initial_mu_r)


class BHTableKeys(_ExtensionKeys, CurveKeys):
    """B-H table in the device file."""

    def to_model(self, name: str, curves: Curves) -> model.BHTable:
        """In SI."""
        return self._table(name, self.H_A_per_m, self.B_T)


class BHTableFromFileKeys(_ExtensionKeys):
    """B-H table in a file of its own."""

    file: Text = Field(description="material file, relative to the device file or among the shipped ones")

    def to_model(self, name: str, curves: Curves) -> model.BHTable:
        """In SI; `curves` holds what the named file contains."""
        return self._table(name, *curves[self.file])


class FluxBarrierKeys(Table):
    """Ideal flux barrier."""

    kind: Literal["flux_barrier"] = Field(description="ideal flux barrier, mu -> 0")

    def to_model(self, name: str, curves: Curves) -> model.FluxBarrier:
        """In SI."""
        return model.FluxBarrier(name)


class PermanentMagnetKeys(Table):
    """Hard magnetic material of constant remanence."""

    kind: Literal["permanent_magnet"] = Field(description="constant remanence and recoil permeability")
    remanence_T: Vector = Field(description="[x, y, z] remanence in the device's frame")
    mu_r: Positive = Field(description="recoil permeability, 1.05 is usual for NdFeB")

    def to_model(self, name: str, curves: Curves) -> model.PermanentMagnet:
        """In SI."""
        return model.PermanentMagnet(name, read_only(self.remanence_T), self.mu_r)


def _kind_of_material(table: dict[str, Any]) -> Any:
    kind = table.get("kind")
    return FROM_A_FILE if kind == "bh_table" and "file" in table else kind


AnyMaterial = Annotated[
    Annotated[LinearKeys, Tag("linear")]
    | Annotated[BHTableKeys, Tag("bh_table")]
    | Annotated[BHTableFromFileKeys, Tag(FROM_A_FILE)]
    | Annotated[FluxBarrierKeys, Tag("flux_barrier")]
    | Annotated[PermanentMagnetKeys, Tag("permanent_magnet")],
    chosen_with(_kind_of_material),
]
