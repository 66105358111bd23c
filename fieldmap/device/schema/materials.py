"""Materials: [material.NAME] tables and the files of measured B-H curves."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, Tag, ValidationInfo, field_validator
from scipy.constants import mu_0

from fieldmap.device import model
from fieldmap.device.marrocco import marrocco_end, marrocco_field
from fieldmap.inputs.tables import Positive, Table, Text, Vector, broken, chosen_with, read_only

# Rounding of printed tables may put a saturated slope a little below mu0; more than this is unphysical.
SMALLEST_SLOPE = 0.99 * mu_0
FROM_A_FILE = "bh_table from a file"

TOWARDS_SATURATION = "towards saturation"
# Iron-cobalt, the strongest material known, saturates at 2.45 T.
LARGEST_POLARISATION_T = 3.0

Curve = Annotated[list[Positive], Field(min_length=2)]
Polarisation = Annotated[float, Field(gt=0, le=LARGEST_POLARISATION_T)]
InitialMuR = Annotated[float, Field(gt=1)]
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
    above: Literal["slope mu0", "towards saturation"] = Field(
        description='law past the last point: "slope mu0" (saturated) or "towards saturation"'
    )
    saturation_polarisation_T: Polarisation | None = Field(
        default=None,
        validate_default=True,
        description='with "towards saturation": what B - mu0 H rises to past the last point',
    )

    @field_validator("saturation_polarisation_T")
    @classmethod
    def _goes_with_above(cls, value: float | None, info: ValidationInfo) -> float | None:
        above = info.data.get("above")
        if above == TOWARDS_SATURATION and value is None:
            raise broken(
                f'above = "{TOWARDS_SATURATION}" needs the polarisation that it rises to',
                "no saturation_polarisation_T",
                'add it (about 2.15 for iron), or choose "slope mu0"',
            )
        if above == "slope mu0" and value is not None:
            raise broken(
                f'saturation_polarisation_T belongs to above = "{TOWARDS_SATURATION}"',
                f'{value:g} with above = "slope mu0"',
                f'remove it, or choose "{TOWARDS_SATURATION}"',
            )
        h, b = info.data.get("H_A_per_m"), info.data.get("B_T")
        if value is not None and h is not None and b is not None:
            require_room_to_saturate(h, b, value)
        return value

    def _table(self, name: str, h: list[float], b: list[float]) -> model.BHTable:
        initial_mu_r = b[0] / (mu_0 * h[0])
        saturation = self.saturation_polarisation_T
        return model.BHTable(
            name, read_only(h), read_only(b), self.below, self.above, initial_mu_r, saturation
        )


def require_room_to_saturate(h: list[float], b: list[float], saturation: float) -> None:
    """Raise unless the polarisation still rises at the table's end, and ends below its saturation."""
    before, end = (b[k] - mu_0 * h[k] for k in (-2, -1))
    if end >= saturation:
        raise broken(
            f"saturation_polarisation_T must be above B - mu0 H of the table's last point, {end:.4g} T",
            f"{saturation:g}",
            'correct it, or choose above = "slope mu0": the table is saturated already',
        )
    if end <= before:
        raise broken(
            "B - mu0 H must still rise between the table's last two points, to be continued towards saturation",
            f"{before:.4g} T, then {end:.4g} T",
            'choose above = "slope mu0": the table is saturated already',
        )


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


class FroehlichKeys(Table):
    """Froehlich-Kennelly law."""

    kind: Literal["froehlich"] = Field(description="Froehlich-Kennelly law of the polarisation")
    mu_r: InitialMuR = Field(description="initial relative permeability")
    saturation_polarisation_T: Polarisation = Field(description="B - mu0 H in saturation")

    def to_model(self, name: str, curves: Curves) -> model.Froehlich:
        """In SI."""
        return model.Froehlich(name, self.mu_r, self.saturation_polarisation_T)


class ArctangentKeys(Table):
    """Arctangent law, which saturates more sharply."""

    kind: Literal["arctangent"] = Field(description="arctangent law of the polarisation")
    mu_r: InitialMuR = Field(description="initial relative permeability")
    saturation_polarisation_T: Polarisation = Field(description="B - mu0 H in saturation")

    def to_model(self, name: str, curves: Curves) -> model.Arctangent:
        """In SI."""
        return model.Arctangent(name, self.mu_r, self.saturation_polarisation_T)


class MarroccoKeys(Table):
    """Marrocco's reluctivity, (eps + (c - eps) B^(2 alpha) / (B^(2 alpha) + tau)) / mu0."""

    kind: Literal["marrocco"] = Field(description="Marrocco's formula for the reluctivity")
    eps: Annotated[float, Field(gt=0, lt=1)] = Field(description="relative reluctivity at B = 0")
    alpha: Annotated[float, Field(ge=1, le=20)] = Field(description="half the exponent of B")
    tau: Positive = Field(description="B^(2 alpha) at the middle of the knee, B in T")
    c: Positive = Field(description="relative reluctivity that the formula tends to")

    @field_validator("c")
    @classmethod
    def _saturates(cls, value: float, info: ValidationInfo) -> float:
        known = info.data
        if not {"eps", "alpha", "tau"} <= set(known):
            return value
        end = marrocco_end(known["eps"], value, known["alpha"], known["tau"])
        if not end <= 10 * LARGEST_POLARISATION_T:
            raise broken(
                "the slope dB/dH of Marrocco's formula must fall to that of free space, where iron is saturated",
                f"c = {value:g}, with which the iron never saturates",
                "raise c (near 1 is usual) or correct the other constants",
            )
        polarisation = end - marrocco_field(end, known["eps"], value, known["alpha"], known["tau"])
        if polarisation > LARGEST_POLARISATION_T:
            raise broken(
                f"the polarisation in saturation must be at most {LARGEST_POLARISATION_T:g} T",
                f"{polarisation:.3g} T, from these constants",
                "lower tau: it is B^(2 alpha) at the knee, with B in T",
            )
        return value

    def to_model(self, name: str, curves: Curves) -> model.Marrocco:
        """In SI."""
        return model.Marrocco(name, self.eps, self.c, self.alpha, self.tau)


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
    | Annotated[FroehlichKeys, Tag("froehlich")]
    | Annotated[ArctangentKeys, Tag("arctangent")]
    | Annotated[MarroccoKeys, Tag("marrocco")]
    | Annotated[FluxBarrierKeys, Tag("flux_barrier")]
    | Annotated[PermanentMagnetKeys, Tag("permanent_magnet")],
    chosen_with(_kind_of_material),
]
