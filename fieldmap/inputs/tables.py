"""What every table of a device file shares: strict keys, finite numbers, and how a broken rule is told."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Discriminator, Field, StringConstraints
from pydantic_core import PydanticCustomError

MILLI = 1e-3
LARGEST_LENGTH_MM = 100_000.0

Length = Annotated[float, Field(gt=0, le=LARGEST_LENGTH_MM)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Coordinate = Annotated[float, Field(ge=-LARGEST_LENGTH_MM, le=LARGEST_LENGTH_MM)]
Point = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
PlanePoint = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
Size = Annotated[list[Length], Field(min_length=3, max_length=3)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Text = Annotated[str, StringConstraints(min_length=1, strip_whitespace=True)]

# A name is a step of a dotted key path and of a path inside a map file: no dot, no slash, no quote.
NAME_RULE = r"^[A-Za-z0-9][A-Za-z0-9 _+\-]*$"
Name = Annotated[str, StringConstraints(pattern=NAME_RULE)]
# A coil's name becomes part of a record name in the map file: letters, digits and underscores only.
COIL_NAME_RULE = r"^[A-Za-z0-9_]+$"
CoilName = Annotated[str, StringConstraints(pattern=COIL_NAME_RULE)]


class Table(BaseModel):
    """One table of the file: unknown keys, numbers in quotes, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def broken(must_hold: str, received: str, remedy: str) -> PydanticCustomError:
    """The error to raise when a rule between keys is broken."""
    text = "{must_hold}; received {received}; {remedy}"
    return PydanticCustomError("rule", text, {"must_hold": must_hold, "received": received, "remedy": remedy})


def chosen_by(key: str) -> Discriminator:
    """Pick the member of a union by the value of one key of the table."""

    def value_of(table: Any) -> Any:
        return table.get(key) if isinstance(table, dict) else None

    return Discriminator(value_of)


def chosen_with(choose: Callable[[dict[str, Any]], Any]) -> Discriminator:
    """Pick the member of a union by a function of the raw table."""
    return Discriminator(lambda table: choose(table) if isinstance(table, dict) else None)


def read_only(values: Sequence[float] | Sequence[Sequence[float]], scale: float = 1.0) -> NDArray[np.float64]:
    """Array of the scaled values that nobody can change by accident."""
    array = np.ascontiguousarray(np.asarray(values, dtype=np.float64) * scale)
    array.setflags(write=False)
    return array
