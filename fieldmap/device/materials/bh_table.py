"""Measured B-H curves, given as a table in the device file or in a material file."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationInfo

from fieldmap.constants import MU0
from fieldmap.device.materials.base import (
    LARGEST_POLARISATION_T,
    SAMPLES,
    CoerciveField,
    LawPoints,
    Polarisation,
    SaturatingMaterial,
)
from fieldmap.inputs.declared import Key, table_of
from fieldmap.inputs.tables import NotNegative, Text, broken, read_only
from fieldmap.typing import Array

# Rounding of printed tables may put a saturated slope a little below mu0; a slope below this is unphysical.
SMALLEST_SLOPE = 0.99 * MU0
# Curves in device files must have at least the slope of free space. The solver accepts smaller slopes: formulas in B,
# such as the law of tests/reference/axisymmetric_saturated.csv, fall to 0.62 mu0.
_SMALLEST_SLOPE_OF_A_LAW = 0.5 * MU0
STRAIGHT_LINE = "straight line to the origin"
TOWARDS_SATURATION = "towards saturation"


Curve = Annotated[list[NotNegative], Field(min_length=2)]


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
    fault = curve_fault(h, b)
    if fault is not None:
        raise broken(*fault)


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


# ---- curves that no iron follows ----

Fault: TypeAlias = tuple[str, str, str]
"""What must hold of a curve, what was received, and the remedy."""

_Points: TypeAlias = tuple[Array, Array]


def _with_free_space(field: Array, flux: Array) -> _Points:
    """J + mu0 H for a curve that may be J, whose slope falls to 0 (the slope of B falls to mu0); others unchanged."""
    flat = (np.diff(flux) / np.diff(field)).min() < 0.5 * MU0
    return field, flux + MU0 * field * flat


# Common mistakes in place of H in A/m and B in T: words, remedy and correction. An error names the first mistake whose
# correction gives a curve of iron.
_MISTAKES: tuple[tuple[str, str, Callable[[Array, Array], _Points]], ...] = (
    ("H and B look exchanged", "exchange them", lambda h, b: (b, h)),
    ("B looks as if it were in mT", "divide B by 1000", lambda h, b: (h, 1e-3 * b)),
    (
        "B looks as if it were in gauss",
        "divide B by 10 000, and multiply H by 79.577 if it is in oersted",
        lambda h, b: (h, 1e-4 * b),
    ),
    ("H looks as if it were in kA/m", "multiply H by 1000", lambda h, b: (1e3 * h, b)),
    ("B looks as if it were the polarisation J = B - mu0 H", "add mu0 H", _with_free_space),
)
# Range of the final polarisation of a corrected curve in which a mistake is likely: soft ferrite to iron-cobalt.
_LIKELY_POLARISATION_T = (0.2, 2.5)


def _largest_mu_r(polarisation: Array) -> Array:
    """Upper bound of B / (mu0 H) of known materials. It is largest below 1 T, for nickel-iron and amorphous ribbon;
    above follow single crystals of iron and oriented silicon iron, and at 2 T iron-cobalt (9e4)."""
    return np.select([polarisation >= 1.6, polarisation >= 1.2], [2e5, 5e5], 2e6)


def curve_fault(h: ArrayLike, b: ArrayLike, smallest_slope: float = SMALLEST_SLOPE) -> Fault | None:
    """The fault of a curve of strictly increasing H, A/m, and B, T, with or without the origin; None for a curve that
    iron can follow."""
    field, flux = np.asarray(h, dtype=float), np.asarray(b, dtype=float)
    if (field[0] == 0) != (flux[0] == 0):
        remedy = "remove the point; a remanence cannot be in a single-valued curve"
        received = f"H = {field[0]:g} A/m, B = {flux[0]:g} T at point 1"
        return "a curve that begins at H = 0 or B = 0 must begin at the origin", received, remedy
    from_origin = int(field[0] == 0)
    field, flux = field[from_origin:], flux[from_origin:]
    if len(field) < 2:
        return "a curve must have two points besides the origin", f"{len(field)}", "add points"
    fault = _unphysical(field, flux, smallest_slope, from_origin)
    if fault is None:
        return None
    must_hold, received, remedy = fault
    for words, mended, mend in _MISTAKES:
        if _likely(*mend(field, flux)):
            return must_hold, received, f"{words}: {mended}; otherwise {remedy}"
    return fault


def _likely(field: Array, flux: Array) -> bool:
    low, high = _LIKELY_POLARISATION_T
    reached = flux[-1] - MU0 * field[-1]
    rises = field[0] > 0 and bool((np.diff(field) > 0).all())
    return rises and low <= reached <= high and _unphysical(field, flux, SMALLEST_SLOPE, 0) is None


def _unphysical(field: Array, flux: Array, smallest_slope: float, before: int) -> Fault | None:
    """The fault of the first point that iron cannot have. before: number of points that the user gave before these."""

    def at(k: int) -> str:
        return f"at point {k + 1 + before} (H = {field[k]:g} A/m, B = {flux[k]:g} T)"

    polarisation = flux - MU0 * field
    if (polarisation > LARGEST_POLARISATION_T).any():
        k = int(np.argmax(polarisation > LARGEST_POLARISATION_T))
        must_hold = f"the polarisation B - mu0 H must be at most {LARGEST_POLARISATION_T:g} T"
        return must_hold, f"{polarisation[k]:.4g} T {at(k)}", "correct the point; H is in A/m and B in T"
    mu_r = flux / (MU0 * field)
    if (mu_r > _largest_mu_r(polarisation)).any():
        k = int(np.argmax(mu_r > _largest_mu_r(polarisation)))
        must_hold = f"B / (mu0 H) must be one that a material has: at most {_largest_mu_r(polarisation)[k]:g}"
        return must_hold, f"{mu_r[k]:.3g} {at(k)}", "correct the point; H is in A/m and B in T"
    slopes = np.diff(flux, prepend=0.0) / np.diff(field, prepend=0.0)
    flat = slopes < smallest_slope
    if not flat.any():
        return None
    k = int(np.argmax(flat))
    start = "the origin" if k == 0 else f"point {k + before}"
    received = f"{slopes[k]:.4g} T m/A from {start} {at(k).replace('at', 'to', 1)}"
    remedy = f"correct point {k + 1 + before}"
    if k >= 2 and flat[k:].all():
        remedy = f'end the table at point {k + before}; above = "slope mu0" continues it'
    return "the slope dB/dH must be at least that of free space, mu0 = 1.2566e-6 T m/A", received, remedy


@dataclass(frozen=True, eq=False, repr=False)
class BHTable(SaturatingMaterial):
    """B-H table.

    Single-valued curve: strictly increasing H (n,) in A/m and B (n,) in T. A first point (0, 0) is left out: the curve
    passes through the origin anyway.

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
            "field strengths, strictly increasing",
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
    ] = STRAIGHT_LINE
    above: Annotated[
        str,
        Key(
            Literal["slope mu0", "towards saturation"],
            'law past the last point: "slope mu0" (saturated) or "towards saturation"',
        ),
    ] = "slope mu0"
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
        with contextlib.suppress(TypeError, ValueError, LookupError):
            if self.h[0] == 0 == self.b[0]:
                object.__setattr__(self, "h", read_only(self.h[1:]))
                object.__setattr__(self, "b", read_only(self.b[1:]))
        if self.initial_mu_r == 0.0:
            with contextlib.suppress(TypeError, ValueError, LookupError, ArithmeticError):
                slope = float(self.b[0]) / (MU0 * float(self.h[0]))
                object.__setattr__(self, "initial_mu_r", slope)

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
        falls = np.flatnonzero(np.diff(h, prepend=-1e-300) <= 0)
        if falls.size:
            return "H must be strictly increasing from 0 on", f"{h[falls[0]]:g} A/m out of order"
        wrong = curve_fault(h, b, _SMALLEST_SLOPE_OF_A_LAW)
        if wrong is not None:
            return wrong[:2]
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
    """Slopes at the inner points of a monotone cubic interpolation: weighted harmonic means of the two secants, or 0 if
    they differ in sign (F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300)."""
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

    file: Text = Field(
        description="material file, or data sheet (CSV), relative to the device file or among the shipped ones"
    )
