"""What a study file may hold: the tables of the TOML file, with their rules."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, StringConstraints, model_validator

from fieldmap.currents import divide_currents
from fieldmap.errors import StudyError
from fieldmap.inputs.findings import one_of, shown
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import Format, Name, Point, Positive, Table, Text, broken, is_number
from fieldmap.studies.quantities import GROUPS, TAKEN

LARGEST_CURRENT_A = 1e6

AxisName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_]*$")]


def _value(value: Any) -> Any:
    """A number or a text: what a key of a device file can be set to."""
    if not is_number(value) and not (isinstance(value, str) and value):
        raise broken("must be a finite number or a text", shown(value), "list plain values of the key")
    return value


def _amperes(value: Any) -> Any:
    """One number for all coils, or one per coil, not all of them zero."""
    if value is None:
        return value
    numbers = value if isinstance(value, list) else [value]
    good = bool(numbers) and all(is_number(n) and abs(n) <= LARGEST_CURRENT_A for n in numbers)
    if not good or not any(numbers):
        must_hold = "one number for all coils, or a list of one per coil, not all of them 0"
        raise broken(must_hold, shown(value), "write for example amperes_A = 1.5")
    return value


def _permeability(value: Any) -> Any:
    if value == "initial" or (is_number(value) and value > 0):
        return value
    must_hold = '"initial" (the initial slope of the device\'s B-H table) or a positive relative permeability'
    raise broken(must_hold, shown(value), 'write for example mu_r = "initial" or mu_r = 4000')


def _quantity(value: Any) -> Any:
    if value not in GROUPS:
        raise broken(f"must be one of {one_of(list(GROUPS))}", shown(value), "choose from these")
    return value


Value = Annotated[Any, BeforeValidator(_value)]
Amperes = Annotated[Any, BeforeValidator(_amperes)]
MOST_AMPERES = 1e9


class LinkedKeys(Table):
    """Keys that follow a varied one: offset + factor * value."""

    keys: Annotated[list[Text], Field(min_length=1)] = Field(description="key paths of the device file")
    factor: float = Field(default=1.0, description="factor of the value")
    offset: float = Field(default=0.0, description="offset, in the unit of the key")


class VaryKeys(Table):
    """One axis of the grid of variants."""

    name: AxisName = Field(description="name of the axis in tables and in the data set")
    key: Text = Field(description='key path of the device file, for example "body.disk.radius_mm"')
    values: Annotated[list[Value], Field(min_length=1)] = Field(description="the values that it takes")
    linked: list[LinkedKeys] = Field(default=[], description="[[vary.linked]]: keys that follow")

    @model_validator(mode="after")
    def _one_kind_of_value(self) -> "VaryKeys":
        texts = [isinstance(value, str) for value in self.values]
        if any(texts) and not all(texts):
            raise broken("values must be all numbers or all texts", shown(self.values), "separate them")
        if len(set(self.values)) < len(self.values):
            raise broken("every value must be listed once", shown(self.values), "remove the second one")
        if self.linked and any(texts):
            remedy = "leave [[vary.linked]] out, or write [[variant]] tables"
            raise broken("keys can only follow numbers", shown(self.values), remedy)
        return self


class VariantKeys(Table):
    """One variant by itself."""

    name: Name = Field(description="name of the variant")
    set: Annotated[dict[str, Value], Field(min_length=1)] = Field(description='"key.path" = value')


class LiftAndDirectionsKeys(Table):
    """Six currents from one lift and two direction signals: `fieldmap.currents.LiftAndDirections`."""

    u_A: Positive | None = Field(default=None, description="mean current; left out where it is looked for")
    x: float = Field(default=0.0, description="direction signal along x")
    y: float = Field(default=0.0, description="direction signal along y")
    n: Positive = Field(default=1.0, description="how much more the two coils on the x axis follow x")

    @model_validator(mode="after")
    def _of_some_size(self) -> "LiftAndDirectionsKeys":
        with np.errstate(over="ignore", invalid="ignore"):
            largest = float(np.abs(divide_currents(self.u_A or 1.0, self.x, self.y, self.n)).max())
        if not largest <= MOST_AMPERES:
            must_hold = f"the signals must leave every coil below {MOST_AMPERES:g} A"
            raise broken(must_hold, f"a coil at {largest:.3g}", "narrow x, y and n, or lower u_A")
        return self


class CurrentKeys(Table):
    """One set of currents: given, or those that carry the payload at a place."""

    name: Text = Field(description="name of the set")
    amperes_A: Amperes = Field(default=None, description="one current for all coils, or one per coil")
    shares: Amperes = Field(default=None, description="of each coil, where the currents are looked for")
    lift_and_directions: LiftAndDirectionsKeys | None = Field(
        default=None, description="six currents of a lift and two direction signals"
    )
    carries_at_mm: Point | None = Field(default=None, description="where the currents carry the payload")

    @model_validator(mode="after")
    def _given_or_looked_for(self) -> "CurrentKeys":
        divided = None if self.lift_and_directions is None else self.lift_and_directions.u_A
        if self.carries_at_mm is None:
            given = [self.amperes_A is not None, divided is not None]
            if sum(given) != 1 or self.shares is not None:
                must_hold = (
                    "a set of currents has amperes_A or lift_and_directions with u_A, or carries_at_mm"
                )
                raise broken(must_hold, self._received(), "give one of them")
        elif self.amperes_A is not None or divided is not None:
            must_hold = "currents that carry the payload are looked for: only their shares can be given"
            raise broken(must_hold, self._received(), "write shares, or lift_and_directions without u_A")
        elif self.shares is not None and self.lift_and_directions is not None:
            raise broken("shares or lift_and_directions", self._received(), "leave one of them out")
        return self

    def _received(self) -> str:
        names = [key for key in type(self).model_fields if key != "name" and getattr(self, key) is not None]
        return ", ".join(names) or "none of them"


class IronKeys(Table):
    """How the iron is modelled and how well it is solved."""

    model: Literal["linear", "saturating"] = Field(
        default="linear", description="constant permeability, or the B-H law of the device's materials"
    )
    mu_r: Annotated[Any, BeforeValidator(_permeability)] = Field(
        default="initial", description='relative permeability of linear iron, or "initial"'
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] = Field(default=1e-3, description="of the solver")
    refinement: Annotated[float, Field(ge=0.1, le=10)] | None = Field(
        default=None, description="divides the device's mesh sizes; 1 unless given"
    )
    accuracy: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="estimated error of B in the workspace at which refining stops"
    )

    @model_validator(mode="after")
    def _one_that_chooses_the_mesh(self) -> "IronKeys":
        if self.model == "saturating" and self.mu_r != "initial":
            received = f"mu_r = {shown(self.mu_r)}"
            raise broken("saturating iron follows its B-H law", received, "leave mu_r out")
        if self.model == "linear" and self.accuracy is not None and self.refinement is not None:
            must_hold = "with accuracy, the meshes of linear iron are chosen by their errors"
            raise broken(must_hold, "accuracy and refinement", "leave one of them out")
        return self


class RecordKeys(Table):
    """What is recorded of every variant at every set of currents."""

    quantities: list[Annotated[str, BeforeValidator(_quantity)]] | None = Field(
        default=None,
        description=f"of {', '.join(GROUPS)}; what the device allows, without inductance and power, if left out",
        examples=[["currents", "equilibrium"]],
    )
    points_mm: list[Point] = Field(default=[], description="where field and force are recorded")
    force_share: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.01, description="share of the weight that bounds the equilibrium area"
    )
    current_limit_A: Positive | None = Field(
        default=None, description="of every coil; the driver's if left out"
    )
    box_mm: Annotated[list[Point], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="lower and upper corner of the box whose homogeneity is recorded",
        examples=[[[-5.0, -5.0, -110.0], [5.0, 5.0, -100.0]]],
    )

    @model_validator(mode="after")
    def _corners_in_order(self) -> "RecordKeys":
        if self.box_mm is not None and not all(low < high for low, high in zip(*self.box_mm, strict=True)):
            must_hold = "the lower corner of box_mm must lie below the upper one, along x, y and z"
            raise broken(must_hold, shown(self.box_mm), "write [[lower x, y, z], [upper x, y, z]]")
        return self


class VariableKeys(Table):
    """A key that an optimisation may change."""

    key: Text = Field(
        description='key path of the device file, "parameters.NAME", or "current.NAME" of a coil',
        examples=["body.disk.radius_mm"],
    )
    lower: float = Field(description="lower bound, in the unit of the key")
    upper: float = Field(description="upper bound")
    start: float | None = Field(
        default=None,
        description="where the search begins; the device's own value if left out",
        examples=[60.0],
    )
    step: Positive | None = Field(
        default=None,
        description="of differences, for derivatives without an exact one; a fiftieth of the range if left out",
        examples=[0.5],
    )
    linked: list[LinkedKeys] = Field(default=[], description="[[optimise.variable.linked]]: keys that follow")


class NumberKeys(Table):
    """A number that studies record."""

    number: Text = Field(
        description="name of its column in the CSV of a study, without the unit",
        examples=["flux_density 1 z"],
    )
    currents: Text | None = Field(
        default=None,
        description="name of the set of currents; the only one if left out",
        examples=["equal"],
    )
    minus: Text | None = Field(
        default=None, description="set of currents whose number is subtracted", examples=["x = 0.2"]
    )


class ConstraintKeys(NumberKeys):
    """Bounds of a number."""

    lower: float | None = Field(
        default=None, description="lower bound, in the number's SI unit", examples=[1e-3]
    )
    upper: float | None = Field(
        default=None, description="upper bound, in the number's SI unit", examples=[3.3]
    )


class OptimiseKeys(Table):
    """What is optimised, within which limits: `fieldmap optimise`."""

    minimise: NumberKeys | None = Field(default=None, description="the number that is to be smallest")
    maximise: NumberKeys | None = Field(default=None, description="or the number that is to be largest")
    variable: Annotated[list[VariableKeys], Field(min_length=1)] = Field(
        description="[[optimise.variable]]: a key that may change"
    )
    constraint: list[ConstraintKeys] = Field(
        default=[], description="[[optimise.constraint]]: a limited number"
    )
    method: Literal["SLSQP", "trust-constr", "COBYQA", "optuna"] = Field(
        default="SLSQP", description="by derivatives (the first two), without them, or by Optuna's sampler"
    )
    solves: Annotated[int, Field(ge=1)] = Field(default=200, description="designs that are solved at most")
    tolerance: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=1e-4,
        description="relative change at which the search ends, and violation of a limit that counts as none",
    )
    check_refinement: Annotated[float, Field(gt=1, le=10)] = Field(
        default=1.4, description="how much finer the mesh is on which the best design is checked"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="of Optuna's sampler")

    @model_validator(mode="after")
    def _one_objective(self) -> "OptimiseKeys":
        there = [name for name in ("minimise", "maximise") if getattr(self, name) is not None]
        if len(there) != 1:
            received = " and ".join(there) or "neither"
            raise broken("an optimisation has minimise or maximise", received, "give one of them")
        return self


class StudyFile(Table):
    """A study file."""

    format: Format
    title: Text = Field(description="one line about the study")
    device: Text | None = Field(default=None, description="device file or name of a shipped device")
    recipe: Text | None = Field(default=None, description="map recipe, whose device and iron are taken")
    iron: IronKeys | None = Field(default=None, description="how the iron is modelled")
    vary: list[VaryKeys] = Field(default=[], description="[[vary]]: all combinations of these values")
    variant: list[VariantKeys] = Field(default=[], description="[[variant]]: one by one")
    currents: Annotated[list[CurrentKeys], Field(min_length=1)] = Field(description="[[currents]] tables")
    record: RecordKeys = Field(default=RecordKeys(), description="the recorded quantities")
    optimise: OptimiseKeys | None = Field(
        default=None, description="instead of variants: a search for the best values"
    )

    @model_validator(mode="after")
    def _one_of_each(self) -> "StudyFile":
        for names in (("device", "recipe"), ("vary", "variant", "optimise")):
            there = [name for name in names if getattr(self, name)]
            if len(there) != 1:
                received = " and ".join(there) or "none of them"
                raise broken(f"a study has {' or '.join(names)}", received, "give one of them")
        if self.recipe is not None and self.iron is not None:
            raise broken(
                "iron is that of the recipe", "recipe and [iron]", "leave [iron] out, or name the device"
            )
        return self

    @model_validator(mode="after")
    def _names_of_their_own(self) -> "StudyFile":
        for what in ("vary", "variant", "currents"):
            names = [entry.name for entry in getattr(self, what)]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise broken(f"every {what} needs a name of its own", one_of(twice), "rename one")
        taken = [entry.name for entry in self.vary if entry.name in TAKEN]
        if taken:
            must_hold = "the names of the data set's own axes and variables are taken"
            raise broken(must_hold, one_of(taken), "rename it")
        return self


STUDY = FileKind(
    "study",
    StudyFile,
    StudyError,
    "maps",
    "studies",
)
