"""What a map recipe may hold: the tables of the TOML file, with their rules."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from fieldmap.device.schema.workspace import above_lower
from fieldmap.errors import RecipeError
from fieldmap.inputs.findings import shown
from fieldmap.inputs.kinds import FileKind, register
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, Format, Point, Positive, Table, Text, broken

LARGEST_CURRENT_A = 1e6


def _three_spacings(value: Any) -> Any:
    """One number for all axes, or three."""
    numbers = value if isinstance(value, list) else [value] * 3
    good = len(numbers) == 3 and all(_is_number(n) and 0 < n <= LARGEST_LENGTH_MM for n in numbers)
    if not good:
        must_hold = "one positive number, or three for x, y and z"
        raise broken(must_hold, shown(value), "write for example spacing_mm = 4.0 or [4.0, 4.0, 2.0]")
    return [float(n) for n in numbers]


def _permeability(value: Any) -> Any:
    """The word "initial", or a number."""
    if value == "initial" or (_is_number(value) and value > 0):
        return value
    must_hold = '"initial" (the initial slope of the device\'s B-H table) or a positive relative permeability'
    raise broken(must_hold, shown(value), 'write for example mu_r = "initial" or mu_r = 4000')


def _map_file_name(value: Any) -> Any:
    """A plain name ending in .h5."""
    text = value if isinstance(value, str) else ""
    if not text.endswith(".h5") or len(text) < 4 or any(c in text for c in "/\\:\0\n"):
        must_hold = "a file name that ends in .h5, without a folder"
        raise broken(must_hold, shown(value), "write only the name; choose the folder when you make the map")
    return value


def _amperes(value: Any) -> Any:
    """One current, or one per coil."""
    if value is None:
        return value
    numbers = value if isinstance(value, list) else [value]
    if not numbers or not all(_is_number(n) and abs(n) <= LARGEST_CURRENT_A for n in numbers):
        must_hold = f"a current in A of at most {LARGEST_CURRENT_A:g}, or a list of one per coil"
        raise broken(must_hold, shown(value), "write for example lower_A = 1.0")
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


class BoxKeys(Table):
    """The box of the map, where it is not the device's workspace."""

    lower_mm: Point = Field(description="[x, y, z] of the corner with the smallest coordinates")
    upper_mm: Point = Field(description="[x, y, z] of the opposite corner")

    _not_empty = field_validator("upper_mm")(above_lower)


class IronKeys(Table):
    """How the iron is modelled."""

    model: Literal["linear", "saturating"] = Field(
        default="linear", description="constant permeability, or the B-H law of the device's materials"
    )
    mu_r: Annotated[str | float | int, BeforeValidator(_permeability)] = Field(
        default="initial", description='relative permeability, or "initial"'
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] = Field(default=1e-3, description="of the solver")
    refinement: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=1.0, description="divides the device's mesh sizes"
    )


def _range(value: Any) -> Any:
    """Two numbers, the first the smaller."""
    good = isinstance(value, list) and len(value) == 2 and all(_is_number(n) for n in value)
    if not good or not value[0] < value[1]:
        raise broken("a range [smallest, largest]", shown(value), "write for example x = [-0.4, 0.4]")
    return [float(n) for n in value]


Range = Annotated[list[float], BeforeValidator(_range)]


class DivisionKeys(Table):
    """Six currents by the division of one lift and two direction signals, thesis (6-2), (6-3)."""

    u_A: Range = Field(description="range of the mean current")
    x: Range = Field(description="range of the direction signal along x")
    y: Range = Field(description="range of the direction signal along y")
    n: Positive = Field(default=1.0, description="how much more the two coils on the x axis follow x")


class CurrentKeys(Table):
    """The currents that a map of saturating iron holds for, and how its reduced model is trained."""

    lower_A: Annotated[float | int | list[float] | None, BeforeValidator(_amperes)] = Field(
        default=None, description="smallest current, one number for all coils or one for each"
    )
    upper_A: Annotated[float | int | list[float] | None, BeforeValidator(_amperes)] = Field(
        default=None, description="largest current, one number for all coils or one for each"
    )
    division: DivisionKeys | None = Field(
        default=None, description="in the place of lower_A and upper_A: currents of a division"
    )
    states: Annotated[int, Field(ge=4, le=4096)] = Field(
        default=64, description="most states solved to train it"
    )
    accuracy: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=1e-3, description="relative error of B at which training stops; twice that of the gradient"
    )
    modes: Annotated[int, Field(ge=2, le=200)] = Field(default=60, description="most amplitudes of the iron")
    points: Annotated[int, Field(ge=20, le=5000)] = Field(
        default=800, description="about how many points of the iron at which the law is evaluated"
    )
    fields: Annotated[int, Field(ge=1, le=100)] = Field(
        default=20, description="most fields of the iron in the map"
    )
    held_out: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=12, description="states at random solved to measure the error; corners of the domain are too"
    )

    @model_validator(mode="after")
    def _not_empty(self) -> "CurrentKeys":
        given = [self.lower_A is not None, self.upper_A is not None, self.division is not None]
        if given not in ([True, True, False], [False, False, True]):
            names = [n for n, there in zip(("lower_A", "upper_A", "division"), given, strict=True) if there]
            must_hold = "[currents] must have lower_A and upper_A, or a division"
            raise broken(must_hold, " and ".join(names) or "none of them", "give one or the other")
        if self.lower_A is None or self.upper_A is None:
            return self
        lower, upper = np.atleast_1d(self.lower_A), np.atleast_1d(self.upper_A)
        if lower.size != upper.size and 1 not in (lower.size, upper.size):
            received = f"{lower.size} and {upper.size} numbers"
            raise broken("lower_A and upper_A must name the same coils", received, "give as many of each")
        if not (lower < upper).all():
            received = f"lower_A = {self.lower_A} with upper_A = {self.upper_A}"
            raise broken(
                "every current must have a range: lower_A below upper_A", received, "correct the numbers"
            )
        return self


class OutputKeys(Table):
    """What is written."""

    file: Annotated[str | None, BeforeValidator(_map_file_name)] = Field(
        default=None, description="name of the map file"
    )
    reference_current_A: Positive | None = Field(
        default=None,
        description="coil current at which the file states its fields; 1 A, or the middle of [currents]",
    )


class RecipeFile(Table):
    """A map recipe."""

    format: Format
    title: Text = Field(description="one line about the map")
    device: Text = Field(description="device file, relative to the recipe, or name of a shipped device")
    spacing_mm: Annotated[list[float], BeforeValidator(_three_spacings)] = Field(
        description="largest distance of neighbouring nodes, one number or [x, y, z]"
    )
    box: BoxKeys | None = Field(default=None, description="the box; the device's workspace if left out")
    iron: IronKeys = Field(default=IronKeys(), description="how the iron is modelled")
    currents: CurrentKeys | None = Field(
        default=None, description="domain of the currents, where the iron saturates"
    )
    output: OutputKeys = Field(default=OutputKeys(), description="what is written")

    @model_validator(mode="after")
    def _currents_where_iron_saturates(self) -> "RecipeFile":
        saturating = self.iron.model == "saturating"
        if saturating and self.currents is None:
            raise broken(
                "a map of saturating iron must state the currents that it is for",
                'iron.model = "saturating" without [currents]',
                "add [currents] with lower_A and upper_A",
            )
        if not saturating and self.currents is not None:
            raise broken(
                "[currents] belongs to saturating iron: with linear iron a map holds for all currents",
                f'iron.model = "{self.iron.model}"',
                'write iron.model = "saturating", or leave [currents] out',
            )
        return self


RECIPE = register(
    FileKind(
        "recipe",
        RecipeFile,
        RecipeError,
        "maps",
        keys=frozenset({"spacing_mm", "box"}),
        taken_by="`fieldmap map` takes it",
        refers_to={
            "device": 'a recipe names it (device = "{file}") and how fine the map shall be (spacing_mm)'
        },
    )
)
