"""Map recipes: what a file may hold, how it is read, and the grid and the currents that it asks for."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, model_validator

from fieldmap.currents import CoilGroups, CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device import Device, read_device
from fieldmap.device.parts import WorkspaceBox
from fieldmap.device.placement import in_unit
from fieldmap.device.toml_text import toml_text
from fieldmap.errors import RecipeError
from fieldmap.inputs.declared import table_of
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import closest, one_of, shown
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, Format, Positive, Table, Text, broken, is_number
from fieldmap.records import Record
from fieldmap.shipped import is_file, shipped_file, shipped_names
from fieldmap.store import Grid
from fieldmap.typing import Array

LARGEST_CURRENT_A = 1e6
FEWEST_NODES = 5
"""Per axis: the differences that the interpolant needs span five nodes."""
MOST_NODES = 2_000_000
"""A map of six coils then takes about 2 GB."""
MILLI = 1e-3


def _three_spacings(value: Any) -> Any:
    """One number for all axes, or three."""
    numbers = value if isinstance(value, list) else [value] * 3
    good = len(numbers) == 3 and all(is_number(n) and 0 < n <= LARGEST_LENGTH_MM for n in numbers)
    if not good:
        must_hold = "one positive number, or three for x, y and z"
        raise broken(must_hold, shown(value), "write for example spacing_mm = 4.0 or [4.0, 4.0, 2.0]")
    return [float(n) for n in numbers]


def _permeability(value: Any) -> Any:
    """The word "initial", or a number."""
    if value == "initial" or (is_number(value) and value > 0):
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
    if not numbers or not all(is_number(n) and abs(n) <= LARGEST_CURRENT_A for n in numbers):
        must_hold = f"a current in A of at most {LARGEST_CURRENT_A:g}, or a list of one per coil"
        raise broken(must_hold, shown(value), "write for example lower_A = 1.0")
    return value


_CORNERS: Any = table_of(WorkspaceBox, name="CornerKeys")


class BoxKeys(_CORNERS):
    """The box of the map, where it is not the device's workspace."""


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
    good = isinstance(value, list) and len(value) == 2 and all(map(is_number, value))
    if not good or not -LARGEST_CURRENT_A <= value[0] < value[1] <= LARGEST_CURRENT_A:
        raise broken(
            f"a range [smallest, largest] of at most {LARGEST_CURRENT_A:g}",
            shown(value),
            "write for example x = [-0.4, 0.4]",
        )
    return [float(n) for n in value]


Range = Annotated[list[float], BeforeValidator(_range)]


class LiftAndDirectionsKeys(Table):
    """Six currents from one lift and two direction signals: `fieldmap.currents.LiftAndDirections`."""

    u_A: Range = Field(description="range of the mean current")
    x: Range = Field(description="range of the direction signal along x")
    y: Range = Field(description="range of the direction signal along y")
    n: Positive = Field(default=1.0, description="how much more the two coils on the x axis follow x")
    limit_A: Positive | None = Field(
        default=None, description="largest current of a coil: u ends where one reaches it"
    )

    @model_validator(mode="after")
    def _room_below_the_limit(self) -> "LiftAndDirectionsKeys":
        if self.limit_A is None:
            return self
        corners = itertools.product([self.u_A[0]], self.x, self.y)
        largest = float(np.abs(LiftAndDirections(self.n).currents(list(corners))).max())
        if largest >= self.limit_A:
            raise broken(
                "the smallest u must leave every coil below limit_A",
                f"a coil at {largest:.4g} A with limit_A = {self.limit_A:g}",
                "lower u_A, narrow x and y, or raise limit_A",
            )
        return self


class CurrentKeys(Table):
    """The currents that a map of saturating iron holds for, and how its reduced model is trained."""

    lower_A: Annotated[float | int | list[float] | None, BeforeValidator(_amperes)] = Field(
        default=None, description="smallest current, one number for all coils or one for each"
    )
    upper_A: Annotated[float | int | list[float] | None, BeforeValidator(_amperes)] = Field(
        default=None, description="largest current, one number for all coils or one for each"
    )
    lift_and_directions: LiftAndDirectionsKeys | None = Field(
        default=None,
        description="instead of lower_A and upper_A: six currents of a lift and two direction signals",
    )
    groups: Annotated[list[Annotated[list[Text], Field(min_length=1)]], Field(min_length=1)] | None = Field(
        default=None,
        description="coils that carry one current, by name: lower_A and upper_A are those of the groups then",
    )
    states: Annotated[int, Field(ge=4, le=4096)] = Field(
        default=64, description="most states solved to train it"
    )
    accuracy: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=1e-3,
        description="relative error of B at new states at which training stops; twice that of the gradient",
    )
    modes: Annotated[int, Field(ge=2, le=200)] = Field(
        default=60,
        description="amplitudes of the iron that are trained at most, unless a state falls short",
    )
    points: Annotated[int, Field(ge=20, le=5000)] = Field(
        default=800,
        description="points of the iron for the law in training at most, unless a state falls short",
    )
    fields: Annotated[int, Field(ge=1, le=100)] = Field(
        default=20, description="most fields of the iron in the map"
    )
    held_out: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=12, description="states at random solved to measure the error; extremes of the domain are too"
    )

    @model_validator(mode="after")
    def _not_empty(self) -> "CurrentKeys":
        given = [self.lower_A is not None, self.upper_A is not None, self.lift_and_directions is not None]
        if given not in ([True, True, False], [False, False, True]):
            names = [
                n
                for n, there in zip(("lower_A", "upper_A", "lift_and_directions"), given, strict=True)
                if there
            ]
            must_hold = "[currents] must have lower_A and upper_A, or lift_and_directions"
            raise broken(must_hold, " and ".join(names) or "none of them", "give one or the other")
        if self.groups is not None and self.lift_and_directions is not None:
            raise broken("groups or lift_and_directions", "both", "leave one of them out")
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


RECIPE = FileKind(
    "recipe",
    RecipeFile,
    RecipeError,
    "maps",
    refers_to={"device": 'a recipe names it (device = "{file}") and how fine the map shall be (spacing_mm)'},
)


@dataclass(frozen=True)
class Plan(Record):
    """How a reduced model is trained.

    states: most that are solved to train it; accuracy: share of the largest flux density in the workspace (of the
    largest gradient: twice that) within which the model must predict the last states that were solved, and within twice
    that those held out, so that no more are; modes: most amplitudes; points: most sample points; fields: most iron
    fields in the map; held_out: states at random solved to measure the error; tolerance: of the solver.
    """

    states: int
    accuracy: float
    modes: int
    points: int
    fields: int
    held_out: int
    tolerance: float


@dataclass(frozen=True, eq=False, repr=False)
class CurrentPlan(Record):
    """Saturating iron: the ranges of the currents as written, and how the reduced model is trained.

    lower, upper: A, of each coil or group of coils, or one number for all; or of u, x and y of lift_and_directions.
    groups: names of the coils that carry one current, or None.
    """

    lower: Array
    upper: Array
    lift_and_directions: LiftAndDirections | None
    refinement: float
    training: Plan
    groups: tuple[tuple[str, ...], ...] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Recipe(Record):
    """What map to make, in SI.

    device: as written, path or shipped name. spacing (3,) in m, an upper limit. lower, upper (3,) in m, or
    None for the device's workspace. mu_r: None for the initial slope of the device's B-H table. refinement:
    divides the device's mesh sizes. reference_current: A, or None for the usual one.
    file_name: of the map. path and text: the file as read. currents: the domain and the training where the iron
    saturates, None where it is linear.
    """

    path: Path
    text: str
    title: str
    device: str
    spacing: Array
    lower: Array | None
    upper: Array | None
    mu_r: float | None
    tolerance: float
    refinement: float
    reference_current: float | None
    file_name: str
    currents: CurrentPlan | None = None

    def error(self, key: str, must_hold: str, received: str, remedy: str) -> RecipeError:
        """An error at a key of the file."""
        return RecipeError(Document(self.path, self.text, {}).problem(key, must_hold, received, remedy))


def read_recipe(path_or_name: str | Path) -> Recipe:
    """Read and check a recipe file: its path, or the name of a shipped recipe ("quick").

    The format is described in docs/recipes.md. Raises RecipeError with one Problem for every error of the
    file: file, line and key path; what must hold; what was received; the remedy.

    >>> read_recipe("quick").device
    'disk_six_cores'
    """
    document = RECIPE.load(RECIPE.find(path_or_name))
    return _recipe(document, RECIPE.contents(document))


def recipe_for(
    device: Device,
    spacing: ArrayLike | None,
    box: WorkspaceBox | Sequence[ArrayLike] | None = None,
    currents: Sequence[ArrayLike] | Mapping[str, Any] | None = None,
    iron: Mapping[str, Any] | None = None,
    reference_current: float | None = None,
) -> Recipe:
    """The recipe of a map of a device, without a file: as if one had been written, with a text of its own.

    spacing: largest distance of nodes, one number or three, m. box: (lower, upper), m, or a WorkspaceBox; the device's
    workspace if None. currents: None for linear iron; for saturating iron the smallest and the largest current, A, each
    one number or one per coil, or a mapping with the keys of [currents]. iron: keys of [iron], such as
    {"refinement": 0.7}. reference_current: A. Raises RecipeError with one Problem for everything that is wrong.

    >>> import fieldmap as fm
    >>> recipe_for(fm.read_device("disk_six_cores"), 8e-3, currents=(0.5, 2.0)).file_name
    'disk_six_cores.h5'
    """
    corners = None if box is None else (box.lower, box.upper) if isinstance(box, WorkspaceBox) else box
    data: dict[str, Any] = {"format": 1, "title": device.title or device.name, "device": device.name}
    data["spacing_mm"] = _plain(spacing, MILLI)
    if corners is not None:
        pair = list(corners)
        data["box"] = {"lower_mm": _plain(pair[0], MILLI), "upper_mm": _plain(pair[-1], MILLI)}
    data["iron"] = {"model": "linear" if currents is None else "saturating", **(iron or {})}
    if isinstance(currents, Mapping):
        data["currents"] = {key: _plain(value, 1.0) for key, value in currents.items()}
    elif currents is not None:
        pair = list(currents)
        data["currents"] = {"lower_A": _plain(pair[0], 1.0), "upper_A": _plain(pair[-1], 1.0)}
    if reference_current is not None:
        data["output"] = {"reference_current_A": _plain(reference_current, 1.0)}
    contents = RECIPE.contents(Document(Path("generate"), "", data))
    text = "# Made by fieldmap.generate of a device made in Python.\n" + toml_text(data)
    return _recipe(Document(Path(f"{device.name}.toml"), text, data), contents)


def _plain(value: Any, unit: float) -> Any:
    """Numbers in a unit as lists; what is no number stays for the schema to refuse."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one, unit) for one in value]
    return in_unit(float(value), unit) if is_number(value) and unit != 1.0 else value


def _recipe(document: Document, contents: RecipeFile) -> Recipe:
    path = document.path
    iron, output, box = contents.iron, contents.output, contents.box
    return Recipe(
        path=path,
        text=document.text,
        title=contents.title,
        device=contents.device,
        spacing=np.array(contents.spacing_mm) * MILLI,
        lower=np.array(box.lower_mm) * MILLI if box else None,
        upper=np.array(box.upper_mm) * MILLI if box else None,
        mu_r=None if iron.mu_r == "initial" else float(iron.mu_r),
        tolerance=iron.tolerance,
        refinement=iron.refinement,
        reference_current=output.reference_current_A,
        file_name=output.file or f"{path.stem}.h5",
        currents=_current_plan(contents),
    )


def _current_plan(contents: RecipeFile) -> CurrentPlan | None:
    keys, iron = contents.currents, contents.iron
    if keys is None:
        return None
    training = Plan(
        keys.states, keys.accuracy, keys.modes, keys.points, keys.fields, keys.held_out, iron.tolerance
    )
    signals = keys.lift_and_directions
    if signals is None:
        lower, upper = (np.atleast_1d(np.array(amperes, float)) for amperes in (keys.lower_A, keys.upper_A))
        groups = None if keys.groups is None else tuple(map(tuple, keys.groups))
        return CurrentPlan(lower, upper, None, iron.refinement, training, groups)
    ranges = np.array([signals.u_A, signals.x, signals.y])
    of = LiftAndDirections(signals.n, signals.limit_A)
    return CurrentPlan(ranges[:, 0], ranges[:, 1], of, iron.refinement, training)


def current_domain(recipe: Recipe, plan: CurrentPlan, coil_names: tuple[str, ...]) -> CurrentDomain:
    """The domain of the currents of a device with these coils. Raises RecipeError where the recipe names others."""
    coils = len(coil_names)
    if plan.lift_and_directions is not None:
        if coils != 6:
            must_hold = "lift_and_directions is for six coils: two rows of three, as in docs/recipes.md"
            raise recipe.error(
                "currents.lift_and_directions", must_hold, f"{coils} coils", "give lower_A and upper_A"
            )
        return CurrentDomain(plan.lift_and_directions, plan.lower, plan.upper)
    of = IndependentCurrents(coils) if plan.groups is None else _coil_groups(recipe, plan.groups, coil_names)
    count, what = of.signal_count, "coils" if plan.groups is None else "groups"
    for key, values in (("lower_A", plan.lower), ("upper_A", plan.upper)):
        if values.size not in (1, count):
            must_hold = f"one current for all {what}, or one for each of the {count} {what}"
            raise recipe.error(f"currents.{key}", must_hold, f"{values.size} currents", "correct the list")
    lower, upper = (np.broadcast_to(values, count).copy() for values in (plan.lower, plan.upper))
    return CurrentDomain(of, lower, upper)


def _coil_groups(
    recipe: Recipe, groups: tuple[tuple[str, ...], ...], coil_names: tuple[str, ...]
) -> CoilGroups:
    named = [name for group in groups for name in group]
    if sorted(named) != sorted(coil_names):
        must_hold = f"must name each coil of the device once: {', '.join(coil_names)}"
        raise recipe.error("currents.groups", must_hold, ", ".join(named), "correct the names")
    return CoilGroups(tuple(tuple(coil_names.index(name) for name in group) for group in groups))


def read_recipe_device(recipe: Recipe, changes: Mapping[str, Any] | None = None) -> Device:
    """The device that a recipe names: beside the recipe, or a shipped one; changes of keys as `read_device` takes them.

    Raises RecipeError if there is none, and DeviceFileError if its file is wrong.
    """
    beside = recipe.path.parent / recipe.device
    if is_file(beside):
        return read_device(beside, changes)
    shipped = shipped_file("geometry", recipe.device)
    if shipped is not None:
        return read_device(shipped, changes)
    names = shipped_names("geometry")
    guess = closest(recipe.device, names)
    remedy = (
        f'did you mean "{guess}"?'
        if guess
        else f"give a path relative to the recipe, or one of {one_of(names)}"
    )
    must_hold = "a device file relative to the recipe, or the name of a shipped device"
    raise recipe.error("device", must_hold, shown(recipe.device), remedy)


def choose_grid(recipe: Recipe, device: Device) -> Grid:
    """Nodes that fill the recipe's box, or the box around the device's workspace, from face to face.

    The spacing is the recipe's or a little less, so that it divides the box. Raises RecipeError if there is
    no box, or too few or too many nodes.
    """
    lower, upper = _corners(recipe, device)
    extent = upper - lower
    # A part in 1e9 is rounding: a box of 40 mm takes 10 cells of 4 mm, not 11.
    cells = np.maximum(np.ceil(extent / recipe.spacing * (1 - 1e-9)), 1).astype(np.int64)
    size = f"a box of {_millimetres(extent)} mm and a spacing of {_millimetres(recipe.spacing)} mm"
    if int(cells.min()) + 1 < FEWEST_NODES:
        remedy = f"divide the box into at least {FEWEST_NODES - 1} cells: a smaller spacing or a larger box"
        must_hold = f"at least {FEWEST_NODES} nodes along each axis"
        raise recipe.error("spacing_mm", must_hold, f"{size}, which gives {_by(cells + 1)} nodes", remedy)
    if np.prod((cells + 1).astype(np.float64)) > MOST_NODES:
        must_hold = f"at most {MOST_NODES} nodes"
        remedy = "take a larger spacing or a smaller box; lengths are in mm"
        raise recipe.error("spacing_mm", must_hold, f"{size}, which gives {_by(cells + 1)} nodes", remedy)
    nx, ny, nz = (int(n) + 1 for n in cells)
    return Grid(lower, extent / cells, (nx, ny, nz))


def with_box(device: Device, grid: Grid) -> Device:
    """The same device with the map's box as its workspace, so that geometry checks hold them together."""
    return replace(device, workspace=WorkspaceBox(grid.lower, grid.upper))


def _corners(recipe: Recipe, device: Device) -> tuple[Array, Array]:
    if recipe.lower is not None and recipe.upper is not None:
        return recipe.lower, recipe.upper
    if device.bounds is not None:
        return device.bounds
    must_hold = "a box, since the device has no workspace"
    raise recipe.error("box", must_hold, "nothing", "add [box] with lower_mm and upper_mm, each [x, y, z]")


def _millimetres(lengths: Array) -> str:
    return " x ".join(f"{length / MILLI:g}" for length in lengths)


def _by(numbers: NDArray[np.int64]) -> str:
    return " x ".join(str(int(n)) for n in numbers)
