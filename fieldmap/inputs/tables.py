"""Base of the tables of all files: strict keys, finite numbers, and errors for broken rules."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    StringConstraints,
)
from pydantic_core import PydanticCustomError

from fieldmap.arguments import LARGEST_NUMBER as LARGEST_NUMBER
from fieldmap.inputs.findings import shown
from fieldmap.records import shortened
from fieldmap.typing import Array

MILLI = 1e-3
LARGEST_LENGTH_MM = 100_000.0
UNITS = {
    "mm": 1e-3,
    "mm_per_s": 1e-3,
    "mm_per_V": 1e-3,
    "ms": 1e-3,
    "mN": 1e-3,
    "g": 1e-3,
    "mH": 1e-3,
    "mT": 1e-3,
    "mT_per_m": 1e-3,
    "g_mm2": 1e-9,
    "us": 1e-6,
    "mA": 1e-3,
    "kHz": 1e3,
    **dict.fromkeys(
        ("deg", "ohm", "T", "T_per_m", "A", "A_per_m", "A_per_V", "A_m2", "V", "V_per_T", "N_s_per_m"), 1.0
    ),
    **dict.fromkeys(("s", "Hz", "rad_per_s", "m_per_s2", "N_m_s", "N_m_s2", "N_s2_per_m2", "S_per_m"), 1.0),
    **dict.fromkeys(("V_per_A", "V_per_A_s", "K_per_W", "J_per_K", "per_K", "per_s", "degC"), 1.0),
}
"""SI values of the units that keys end with."""

Length = Annotated[float, Field(gt=0, le=LARGEST_LENGTH_MM)]
Positive = Annotated[float, Field(gt=0, le=LARGEST_NUMBER)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST_NUMBER)]
Coordinate = Annotated[float, Field(ge=-LARGEST_LENGTH_MM, le=LARGEST_LENGTH_MM)]
Point = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
PlanePoint = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
Size = Annotated[list[Length], Field(min_length=3, max_length=3)]
Text = Annotated[str, StringConstraints(min_length=1, strip_whitespace=True)]

Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]

# Pattern of a text -> (what must hold, remedy), for `explain`.
PATTERNS: dict[str, tuple[str, str]] = {}


def text_like(pattern: str, must_hold: str, remedy: str) -> StringConstraints:
    """Annotation of a text that must match a pattern, with the words of the error."""
    PATTERNS[pattern] = must_hold, remedy
    return StringConstraints(pattern=pattern)


# A name is a step of a dotted key path and of a path inside a map file: no dot, no slash, no quote.
Name = Annotated[
    str,
    text_like(
        r"^[A-Za-z0-9][A-Za-z0-9 _+\-]*$",
        "a name begins with a letter or digit and has letters, digits, spaces, _ + - only",
        'rename it, for example "lower plate"',
    ),
]

FORMAT = 1


def _known_format(value: int) -> int:
    if value != FORMAT:
        remedy = (
            f"this version of fieldmap reads format {FORMAT} only: install the version that wrote the file"
        )
        raise broken(f"format must be {FORMAT}", str(value), remedy)
    return value


Format = Annotated[
    int,
    Field(description="version of the file format: 1", json_schema_extra={"const": FORMAT}),
    AfterValidator(_known_format),
]


class Table(BaseModel):
    """One table of the file: unknown keys, numbers in quotes, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    written_as: ClassVar[str | None] = None
    """How a table is written that is not chosen by the value of one key, for errors."""

    makes: ClassVar[type | None] = None
    """The record of a table that `fieldmap.inputs.declared` made. The attributes below belong to such tables, too."""
    declared: ClassVar[Mapping[str, Any]] = {}
    """The fields, `fieldmap.inputs.declared.Declared`, by their keys."""
    beside: ClassVar[Mapping[str, Any]] = {}
    """Attribute -> table of its record. The keys of that table are keys of this one, too."""
    choice: ClassVar[tuple[str, str] | None] = None
    """The key that chooses the table among others, and its value."""
    takes: ClassVar[Callable[[Any], bool] | None] = None
    """Whether a record is written in this table, for several tables that make the same record."""

    def also_makes(self) -> Mapping[str, Any]:
        """Fields of the record that several keys make together."""
        return {}

    def __repr__(self) -> str:
        return shortened(super().__repr__())


class Versioned(Table):
    """The key that every file begins with."""

    format: Format


def broken(must_hold: str, received: str, remedy: str) -> PydanticCustomError:
    """The error to raise when a rule between keys is broken."""
    text = "{must_hold}; received {received}; {remedy}"
    return PydanticCustomError("rule", text, {"must_hold": must_hold, "received": received, "remedy": remedy})


@dataclass(frozen=True, slots=True)
class Choice(Discriminator):
    """Picks the member of a union by a function of the raw table; `key` is the key that usually decides."""

    key: str = "kind"


def in_unit(value: float, unit: float) -> float:
    """The shortest number whose product with a unit is this value to the last bit; else the nearest number.

    >>> in_unit(38.10512e-3, 1e-3), in_unit(0.1 + 0.2, 1e-3)
    (38.10512, 300.00000000000006)
    """
    near = value / unit
    for digits in range(6, 18):
        short = float(f"{near:.{digits}g}")
        if short * unit == value:
            return short
    return next((x for x in np.nextafter(near, [-np.inf, np.inf]).tolist() if x * unit == value), near)


def is_number(value: Any) -> bool:
    """Whether a raw value is a finite number of at most 1e30 in size; booleans are not."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_NUMBER


def whole(least: int, most: int | None = None) -> Any:
    """Annotation of a whole number between bounds."""
    return Annotated[int, Field(ge=least, le=most)]


def one_or_each(
    good: Callable[[float], bool], must_hold: str, remedy: str, some: bool = False
) -> BeforeValidator:
    """Annotation of one number or a list of numbers. `good` must hold for each; some: one must differ from 0. None is
    allowed."""

    def checked(value: Any) -> Any:
        numbers = value if isinstance(value, list) else [value]
        holds = (
            bool(numbers) and all(is_number(n) and good(n) for n in numbers) and (any(numbers) or not some)
        )
        if value is not None and not holds:
            raise broken(must_hold, shown(value), remedy)
        return value

    return BeforeValidator(checked)


def read_only(values: ArrayLike, scale: float = 1.0) -> Array:
    """Read-only array of the scaled values."""
    array = np.ascontiguousarray(np.asarray(values, dtype=np.float64) * scale)
    array.setflags(write=False)
    return array
