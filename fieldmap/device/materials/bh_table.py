"""Measured B-H curves: a table in the device file, or in a material file that it names."""

import contextlib
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.constants import MU0
from fieldmap.device.materials.base import SAMPLES, CoerciveField, LawPoints, Polarisation, SaturatingMaterial
from fieldmap.inputs.declared import Key, table_of
from fieldmap.inputs.tables import Positive, Text, broken
from fieldmap.typing import Array

# Rounding of printed tables may put a saturated slope a little below mu0; a slope below this is unphysical.
SMALLEST_SLOPE = 0.99 * MU0
# Device files keep to the slope of free space. The solver accepts smaller slopes: formulas in B, such as the law of
# tests/reference/axisymmetric_saturated.csv, dip to 0.62 of it.
_SMALLEST_SLOPE_OF_A_LAW = 0.5 * MU0
STRAIGHT_LINE = "straight line to the origin"
TOWARDS_SATURATION = "towards saturation"


Curve = Annotated[list[Positive], Field(min_length=2)]


def _require_increasing(values: list[float], info: ValidationInfo) -> None:
    steps = np.flatnonzero(np.diff(values) <= 0)
    if steps.size:
        k = int(steps[0])
        raise broken(
            f"{info.field_name} must be strictly increasing",
            f"{values[k + 1]:g} after {values[k]:g} (points {k + 1} and {k + 2})",
            "sort the points, and remove repeated ones and the falling branch of a hysteresis loop",
        )


def _require_physical(b: list[float], info: ValidationInfo) -> None:
    _require_increasing(b, info)
    h = info.data.get("H_A_per_m")
    if h is None:
        return
    if len(h) != len(b):
        raise broken(
            "H_A_per_m and B_T must have the same number of values",
            f"{len(h)} and {len(b)} values",
            "give one B for each H",
        )
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


def _require_what_goes_with_above(value: float | None, info: ValidationInfo) -> None:
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


def require_room_to_saturate(h: list[float], b: list[float], saturation: float) -> None:
    """Raise unless the polarisation still rises at the table's end, and ends below its saturation."""
    before, end = (b[k] - MU0 * h[k] for k in (-2, -1))
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


@dataclass(frozen=True, eq=False, repr=False)
class BHTable(SaturatingMaterial):
    """B-H table.

    Single-valued curve: strictly increasing H (n,) in A/m and B (n,) in T, origin not included.

    initial_mu_r: if left out, mu_r at the first point. below: law from the origin to the first point ("straight line to
    the origin" is the only one so far); above: law past the last point: "slope mu0" (saturated), or "towards
    saturation": the polarisation B - mu0 H goes on rising to `saturation`, T. Results name `below` and `above` among
    their assumptions. coercive_field: of the hysteresis loop, A/m; only `fieldmap.iron.HysteresisSolver` uses it.
    """

    kind: ClassVar[str] = "bh_table"

    name: str
    h: Annotated[
        Array,
        Key(
            Curve,
            "field strengths, strictly increasing, without the origin",
            "A_per_m",
            name="H",
            check=_require_increasing,
        ),
    ]
    b: Annotated[
        Array,
        Key(
            Curve,
            "flux densities, one for each field strength, strictly increasing",
            "T",
            name="B",
            check=_require_physical,
        ),
    ]
    below: Annotated[
        str,
        Key(
            Literal["straight line to the origin"], 'law below the first point: "straight line to the origin"'
        ),
    ]
    above: Annotated[
        str,
        Key(
            Literal["slope mu0", "towards saturation"],
            'law past the last point: "slope mu0" (saturated) or "towards saturation"',
        ),
    ]
    initial_mu_r: float = 0.0
    saturation: Annotated[
        float | None,
        Key(
            Polarisation | None,
            'with "towards saturation": value to which B - mu0 H rises past the last point',
            "T",
            name="saturation_polarisation",
            check=_require_what_goes_with_above,
        ),
    ] = None
    coercive_field: CoerciveField = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.initial_mu_r == 0.0:
            with contextlib.suppress(TypeError, ValueError, LookupError, ArithmeticError):
                object.__setattr__(self, "initial_mu_r", float(self.b[0] / (MU0 * self.h[0])))

    @property
    def initial_slope(self) -> str:  # type: ignore[override]
        """Words for the permeability that a linear solution uses."""
        return f"the initial slope of its B-H table ({self.below} below the first point)"

    @property
    def largest_polarisation(self) -> float:
        """Largest polarisation of the table and of its continuation, T."""
        reached = float(np.max(self.b - MU0 * self.h))
        return reached if self.saturation is None else max(reached, self.saturation)

    @property
    def field_range(self) -> tuple[float, float]:
        """mu0 H of the first and last point, T."""
        return MU0 * float(self.h[0]), MU0 * float(self.h[-1])

    def fault(self) -> tuple[str, str] | None:
        """See `SaturatingMaterial.fault`."""
        h, b = (np.asarray(values, dtype=float) for values in (self.h, self.b))
        if h.ndim != 1 or h.shape != b.shape or len(h) < 2 or not np.isfinite([h, b]).all():
            return "H and B must be as many finite numbers, two at least", f"shapes {h.shape} and {b.shape}"
        steps = np.diff(h, prepend=0.0)
        if (steps <= 0).any():
            received = f"{h[np.argmax(steps <= 0)]:g} A/m out of order"
            return "H must be strictly increasing from above 0", received
        slope = np.diff(b, prepend=0.0) / steps
        if (slope < _SMALLEST_SLOPE_OF_A_LAW).any():
            k = int(np.argmax(slope < _SMALLEST_SLOPE_OF_A_LAW))
            text = "the slope dB/dH must nowhere be below that of free space, mu0 = 1.2566e-6 T m/A"
            return text, f"{slope[k]:.4g} T m/A up to point {k + 1}"
        if self.saturation is not None:
            polarisation = b[-2:] - MU0 * h[-2:]
            if not polarisation[0] < polarisation[1] < self.saturation:
                text = "B - mu0 H must rise at the table's end and end below the saturation polarisation"
                return text, f"{polarisation[0]:.4g} and {polarisation[1]:.4g} T before {self.saturation:g} T"
        return None

    def points(self) -> LawPoints:
        """Points of the straight line from the origin, of the table, and of the law past its last point."""
        field = MU0 * np.concatenate([[0.0], self.h])
        polarisation = np.concatenate([[0.0], self.b]) - field
        secant = np.diff(polarisation) / np.diff(field)
        end, rest, tail = polarisation[-1], 1.0, 0.0
        if self.saturation is not None:
            rest = self.saturation - end
            tail = secant[-1] * rest / (self.saturation - polarisation[-2])

        def beyond(x: Array) -> Array:
            """J past the last point: a constant, or a hyperbola through the last two points up to `saturation`."""
            return np.asarray(end + tail * x / (1 + tail * x / rest))

        # The continuation gives the slope at the last point: dB/dH has no jump there.
        known = np.append(field, 2 * field[-1]), np.append(polarisation, beyond(field[-1]))
        slope = np.append(secant[0], _monotone_slopes(*known))
        # The straight line to the origin; a smaller slope where the next cubic needs it (Fritsch and Carlson).
        slope[1] = min(secant[0], 3 * secant[1]) if len(secant) > 1 else secant[0]
        if tail == 0:
            return LawPoints(field, polarisation, slope)
        slope[-1] = tail
        x = SAMPLES[1:] * rest / tail
        return LawPoints(
            np.concatenate([field, field[-1] + x]),
            np.concatenate([polarisation, beyond(x)]),
            np.concatenate([slope, tail / (1 + tail * x / rest) ** 2]),
        )

    @property
    def description(self) -> str:
        """The law in words."""
        rises = "" if self.saturation is None else f" ({self.saturation:g} T)"
        return (
            f"single-valued B-H table, {self.below} below {self.b[0]:g} T, "
            f"{self.above}{rises} above {self.b[-1]:g} T"
        )


def _monotone_slopes(x: Array, y: Array) -> Array:
    """Slopes at all points but the first and the last, so that cubics between the points are monotone where the points
    are: weighted harmonic means of the secants on both sides, or 0 if these differ in sign (F. N. Fritsch and
    J. Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300)."""
    width = np.diff(x)
    secant = np.diff(y) / width
    before, after = secant[:-1], secant[1:]
    of_before, of_after = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    alike = before * after > 0.0
    mean = np.zeros(len(before))
    weighted = of_before[alike] / before[alike] + of_after[alike] / after[alike]
    mean[alike] = 1.0 / (weighted / (of_before + of_after)[alike])
    return mean


# ---- tables of files ----

CurveKeys: Any = table_of(
    BHTable, name="CurveKeys", without=("below", "above", "saturation", "coercive_field")
)
_EXTENSION: Any = table_of(BHTable, "kind", "ExtensionKeys", without=("h", "b"))


class BHTableFromFileKeys(_EXTENSION):
    """B-H table in a file of its own."""

    file: Text = Field(description="material file, relative to the device file or among the shipped ones")
