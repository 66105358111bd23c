"""What a fit file may hold: unknown keys of a device, and the tables that were measured on the machine."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from fieldmap.errors import FitError
from fieldmap.inputs.findings import one_of, shown
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import (
    LARGEST_NUMBER,
    Format,
    Point,
    Positive,
    Table,
    Text,
    broken,
    is_number,
)

Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]


def _deviation(value: Any) -> Any:
    """One positive number for all readings, or a list of one for each."""
    numbers = value if isinstance(value, list) else [value]
    if not numbers or not all(is_number(n) and n > 0 for n in numbers):
        must_hold = "one number above 0 for all readings, or a list of one for each"
        raise broken(must_hold, shown(value), "state the standard deviation of a reading")
    return value


def _amperes(value: Any) -> Any:
    """One number for all coils, a list of one per coil, or a list of such lists, one for each point."""
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    for row in rows:
        numbers = row if isinstance(row, list) else [row]
        if not numbers or not all(is_number(n) for n in numbers):
            must_hold = "one number for all coils, a list of one per coil, or a list of such lists, one for each point"
            raise broken(must_hold, shown(value), "write for example currents_A = 1.5")
    return value


def _or_lists(number: dict[str, Any], depth: int) -> WithJsonSchema:
    """JSON Schema of a number, or of lists of it, of as many dimensions at most."""
    choices = [number]
    for _ in range(depth):
        choices.append({"type": "array", "items": choices[-1]})
    return WithJsonSchema({"anyOf": choices})


Deviation = Annotated[
    Any, BeforeValidator(_deviation), _or_lists({"type": "number", "exclusiveMinimum": 0}, 1)
]
Amperes = Annotated[Any, BeforeValidator(_amperes), _or_lists({"type": "number"}, 2)]
Rows = Annotated[list[Number], Field(min_length=1)]


class UnknownKeys(Table):
    """A number of the device that is to be found; all values in the unit of its key."""

    key: Text = Field(description='key path of the device file, for example "joint.ends.gap_mm"')
    start: Number = Field(description="where the search begins")
    lower: Number | None = Field(default=None, description="lower bound, if there is one")
    upper: Number | None = Field(default=None, description="upper bound, if there is one")
    prior: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="mean and standard deviation that are known from elsewhere",
        examples=[[1500.0, 300.0]],
    )
    step: Positive | None = Field(
        default=None,
        description="difference for the derivative; a hundredth of start if left out",
        examples=[0.5],
    )

    @model_validator(mode="after")
    def _bounds_in_order(self) -> "UnknownKeys":
        low = -LARGEST_NUMBER if self.lower is None else self.lower
        high = LARGEST_NUMBER if self.upper is None else self.upper
        if not low <= self.start <= high or low == high:
            received = f"lower {self.lower}, start {self.start:g}, upper {self.upper}"
            raise broken("start must lie between lower and upper", received, "correct the numbers")
        if self.prior is not None and not self.prior[1] > 0:
            raise broken(
                "the deviation of the prior must be above 0", shown(self.prior), "write [mean, deviation]"
            )
        return self


class _MeasuredKeys(Table):
    name: Text = Field(description="name of the table", examples=["on the axis"])
    use: Literal["fit", "predict"] = Field(
        default="fit", description="whether the unknowns are fitted to it, or it is predicted with them"
    )


class FluxDensityKeys(_MeasuredKeys):
    """Flux densities at points."""

    points_mm: Annotated[list[Point], Field(min_length=1)] = Field(description="where the probe was")
    currents_A: Amperes = Field(
        description="one for all coils, one per coil, or a list of one per coil for each point"
    )
    components: Annotated[list[Literal["x", "y", "z"]], Field(min_length=1)] = Field(
        default=["x", "y", "z"], description="what was read", examples=[["z"]]
    )
    measured_mT: Annotated[list[Rows], Field(min_length=1)] = Field(
        description="of each point the components that were read", examples=[[[0.24, 0.01, 1.4]]]
    )
    deviation_mT: Deviation = Field(
        description="standard deviation, of all readings or of those of each point", examples=[0.01]
    )

    @model_validator(mode="after")
    def _a_row_for_each_point(self) -> "FluxDensityKeys":
        if len(set(self.components)) < len(self.components):
            raise broken("every component is listed once", shown(self.components), "remove the second one")
        if len(self.measured_mT) != len(self.points_mm):
            received = f"{len(self.measured_mT)} rows for {len(self.points_mm)} points"
            raise broken("measured_mT needs a row for each point", received, "add or remove rows")
        wrong = {len(row) for row in self.measured_mT} - {len(self.components)}
        if wrong:
            must_hold = f"each row of measured_mT holds {', '.join(self.components)}"
            remedy = "complete the rows, or state components"
            raise broken(must_hold, f"{min(wrong)} numbers", remedy)
        return self


class InductanceKeys(_MeasuredKeys):
    """Inductances of coils."""

    coils: Annotated[list[Annotated[list[Text], Field(min_length=2, max_length=2)]], Field(min_length=1)] = (
        Field(
            description="pairs of coils by name; the same twice for a coil's own inductance",
            examples=[[["coil", "coil"]]],
        )
    )
    measured_mH: Rows = Field(description="of each pair", examples=[[6.46]])
    deviation_mH: Deviation = Field(
        description="standard deviation, one or one for each pair", examples=[0.03]
    )


class LiftCurrentKeys(_MeasuredKeys):
    """Currents that carry the payload."""

    positions_mm: Annotated[list[Point], Field(min_length=1)] = Field(
        description="places of the magnet's centre", examples=[[[0.0, 0.0, -95.0]]]
    )
    shares: Rows | None = Field(
        default=None, description="current of each coil per ampere; 1 if left out", examples=[[1.0, 0.5]]
    )
    measured_A: Rows = Field(description="of each place the common current", examples=[[1.56]])
    deviation_A: Deviation = Field(
        description="standard deviation, one or one for each place", examples=[0.02]
    )


class FitIronKeys(Table):
    """How the iron is solved."""

    model: Literal["linear", "saturating"] | None = Field(
        default=None,
        description="saturating where a material of the device does, if left out",
        examples=["linear"],
    )
    refinement: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=1.0, description="divides the device's mesh sizes"
    )


class FitFile(Table):
    """A fit file."""

    format: Format
    title: Text = Field(description="one line about the fit")
    device: Text = Field(description="device file or name of a shipped device")
    iron: FitIronKeys = Field(default=FitIronKeys(), description="how the iron is solved")
    unknown: Annotated[list[UnknownKeys], Field(min_length=1)] = Field(description="[[unknown]] tables")
    flux_density: list[FluxDensityKeys] = Field(
        default=[], description="[[flux_density]]: readings of a probe"
    )
    inductance: list[InductanceKeys] = Field(default=[], description="[[inductance]]: readings of a bridge")
    lift_current: list[LiftCurrentKeys] = Field(
        default=[], description="[[lift_current]]: currents that carry the payload"
    )

    @model_validator(mode="after")
    def _names_of_their_own(self) -> "FitFile":
        names = [table.name for table in (*self.flux_density, *self.inductance, *self.lift_current)]
        for what, all_of_it in (("unknown", [one.key for one in self.unknown]), ("table", names)):
            twice = sorted({one for one in all_of_it if all_of_it.count(one) > 1})
            if twice:
                raise broken(f"every {what} is named once", one_of(twice), "rename or remove one")
        return self


FIT = FileKind(
    "fit",
    FitFile,
    FitError,
    "maps",
    "fits",
)
