"""Map recipes: what a file may hold, how it is read, and the grid and the currents that it asks for."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from fieldmap.currents import CoilGroups, CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device import Device, read_device
from fieldmap.device.materials import SaturatingMaterial
from fieldmap.device.parts import WorkspaceBox
from fieldmap.device.toml_text import toml_text
from fieldmap.errors import RecipeError
from fieldmap.field import Bounds
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.document import AtKey, Document
from fieldmap.inputs.findings import meant, one_of, shown
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import (
    LARGEST_LENGTH_MM,
    Positive,
    Text,
    Versioned,
    broken,
    in_unit,
    is_number,
    one_or_each,
)
from fieldmap.maps.training.plan import Plan
from fieldmap.records import Record
from fieldmap.shipped import is_file, shipped_file, shipped_names
from fieldmap.store import Grid
from fieldmap.typing import Array, PathLike

LARGEST_CURRENT_A = 1e6
FEWEST_NODES = 5
"""Least number of nodes along an axis: the finite differences of the interpolant span five."""
MILLI = 1e-3


def _three_spacings(value: Any) -> Any:
    """One number for all axes, or three."""
    numbers = value if isinstance(value, list) else [value] * 3
    good = len(numbers) == 3 and all(is_number(n) and 0 < n <= LARGEST_LENGTH_MM for n in numbers)
    if not good:
        must_hold = "one positive number, or three for x, y and z"
        raise broken(must_hold, shown(value), "write for example spacing_mm = 4.0 or [4.0, 4.0, 2.0]")
    return [float(n) for n in numbers]


_SPACING = {"type": "number", "exclusiveMinimum": 0}
Spacings = Annotated[
    list[float],
    BeforeValidator(_three_spacings),
    WithJsonSchema({"anyOf": [_SPACING, {"type": "array", "items": _SPACING, "minItems": 3, "maxItems": 3}]}),
]


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


Amperes = Annotated[
    float | int | list[float] | None,
    one_or_each(
        lambda n: abs(n) <= LARGEST_CURRENT_A,
        f"a current in A of at most {LARGEST_CURRENT_A:g}, or a list of one per coil",
        "write for example lower_A = 1.0",
    ),
]


Refinement = Annotated[float, Field(ge=0.1, le=10)]
IronLaw = Literal["linear", "saturating"]
IronLawOfMap = Literal["linear", "saturating", "hysteresis"]


@dataclass(frozen=True, repr=False)
class IronModel(Record):
    """How the iron is modelled."""

    model: Annotated[str, Key(IronLaw, "constant permeability, or the B-H law of the device's materials")] = (
        "linear"
    )
    mu_r: Annotated[
        float | None,
        Key(
            Annotated[str | float | int, BeforeValidator(_permeability)],
            'relative permeability of linear iron, or "initial"',
            make=lambda value: None if value == "initial" else float(value),
            written="initial",
        ),
    ] = None
    tolerance: Annotated[float, Key(Annotated[float, Field(gt=0, le=0.1)], "of the solver")] = 1e-3
    refinement: Annotated[float, Key(Refinement, "divides the device's mesh sizes")] = 1.0

    @property
    def saturating(self) -> bool:
        """Whether the iron follows its B-H law."""
        return self.model == "saturating"


@dataclass(frozen=True, repr=False)
class IronOfMap(IronModel):
    """How the iron of a map is modelled."""

    model: Annotated[
        str,
        Key(
            IronLawOfMap,
            "constant permeability, the B-H law of the device's materials, or this law with their coercive fields, so "
            "that the map remembers earlier currents",
        ),
    ] = "linear"
    reaction: Annotated[
        bool, Key(bool, "whether the map holds the iron's reaction to magnets, so that they are drawn to it")
    ] = True


def _range(value: Any) -> Any:
    """Two numbers, the first the smaller."""
    good = isinstance(value, list) and len(value) == 2 and all(map(is_number, value))
    if not good or not -LARGEST_CURRENT_A <= value[0] < value[1] <= LARGEST_CURRENT_A:
        must_hold = f"a range [smallest, largest] of at most {LARGEST_CURRENT_A:g}"
        raise broken(must_hold, shown(value), "write for example x = [-0.4, 0.4]")
    return [float(n) for n in value]


Range = Annotated[list[float], BeforeValidator(_range)]


def _room_below_the_limit(keys: Any) -> None:
    if keys.limit_A is None:
        return
    corners = itertools.product([keys.u_A[0]], keys.x, keys.y)
    largest = float(np.abs(LiftAndDirections(keys.n).currents(list(corners))).max())
    if largest >= keys.limit_A:
        raise broken(
            "the smallest u must leave every coil below limit_A",
            f"a coil at {largest:.4g} A with limit_A = {keys.limit_A:g}",
            "lower u_A, narrow x and y, or raise limit_A",
        )


@dataclass(frozen=True, eq=False, repr=False)
class SignalRanges(Record):
    """Six currents from one lift and two direction signals: `fieldmap.currents.LiftAndDirections`."""

    u: Annotated[Array, Key(Range, "range of the mean current", "A")]
    x: Annotated[Array, Key(Range, "range of the direction signal along x")]
    y: Annotated[Array, Key(Range, "range of the direction signal along y")]
    n: Annotated[float, Key(Positive, "how much more the two coils on the x axis follow x")] = 1.0
    limit: Annotated[
        float | None, Key(Positive | None, "largest current of a coil: u ends where one reaches it", "A")
    ] = None

    def domain(self) -> CurrentDomain:
        """The box of the signals."""
        lower, upper = np.array([self.u, self.x, self.y]).T
        return CurrentDomain(LiftAndDirections(self.n, self.limit), lower, upper)


def _each(amperes: Any) -> Any:
    """One current, or one per coil, as an array."""
    return None if amperes is None else np.atleast_1d(np.array(amperes, float))


@dataclass(frozen=True, eq=False, repr=False)
class CurrentRanges(Record):
    """The currents that a map of saturating iron holds for. lower, upper: of each coil, of each group, or of all."""

    lower: Annotated[
        Array | None,
        Key(Amperes, "smallest current, one number for all coils or one for each", "A", make=_each),
    ] = None
    upper: Annotated[
        Array | None,
        Key(Amperes, "largest current, one number for all coils or one for each", "A", make=_each),
    ] = None
    lift_and_directions: Annotated[
        SignalRanges | None,
        Key(
            table_of(SignalRanges, rules=(_room_below_the_limit,)) | None,
            "instead of lower_A and upper_A: six currents of a lift and two direction signals",
        ),
    ] = None
    groups: Annotated[
        tuple[tuple[str, ...], ...] | None,
        Key(
            Annotated[list[Annotated[list[Text], Field(min_length=1)]], Field(min_length=1)] | None,
            "coils that carry one current, by name: lower_A and upper_A are those of the groups then",
        ),
    ] = None

    def domain(self, coil_names: tuple[str, ...]) -> CurrentDomain:
        """The domain of the currents of a device with these coils. Raises RecipeError if the ranges do not fit."""
        coils = len(coil_names)
        if self.lift_and_directions is not None:
            if coils != 6:
                must_hold = "lift_and_directions is for six coils: two rows of three, as in docs/recipes.md"
                key, remedy = "currents.lift_and_directions", "give lower_A and upper_A"
                raise RecipeError(AtKey(key, must_hold, f"{coils} coils", remedy))
            return self.lift_and_directions.domain()
        assert self.lower is not None
        assert self.upper is not None
        of = IndependentCurrents(coils) if self.groups is None else _coil_groups(self.groups, coil_names)
        count, what = of.signal_count, "coils" if self.groups is None else "groups"
        for key, values in (("lower_A", self.lower), ("upper_A", self.upper)):
            if values.size not in (1, count):
                must_hold = f"one current for all {what}, or one for each of the {count} {what}"
                received = f"{values.size} currents"
                raise RecipeError(AtKey(f"currents.{key}", must_hold, received, "correct the list"))
        lower, upper = (np.broadcast_to(values, count).copy() for values in (self.lower, self.upper))
        return CurrentDomain(of, lower, upper)


def _coil_groups(groups: tuple[tuple[str, ...], ...], coil_names: tuple[str, ...]) -> CoilGroups:
    named = [name for group in groups for name in group]
    if sorted(named) != sorted(coil_names):
        must_hold = f"must name each coil of the device once: {', '.join(coil_names)}"
        raise RecipeError(AtKey("currents.groups", must_hold, ", ".join(named), "correct the names"))
    return CoilGroups(tuple(tuple(coil_names.index(name) for name in group) for group in groups))


@dataclass(frozen=True, eq=False, repr=False)
class CurrentPlan(Plan, CurrentRanges):
    """The currents that a map of saturating iron holds for, and how its reduced model is trained."""


def _not_empty(keys: Any) -> None:
    given = [
        name for name in ("lower_A", "upper_A", "lift_and_directions") if getattr(keys, name) is not None
    ]
    if given not in (["lower_A", "upper_A"], ["lift_and_directions"]):
        must_hold = "[currents] must have lower_A and upper_A, or lift_and_directions"
        raise broken(must_hold, " and ".join(given) or "none of them", "give one or the other")
    if keys.lift_and_directions is not None:
        if keys.groups is not None:
            raise broken("groups or lift_and_directions", "both", "leave one of them out")
        return
    lower, upper = np.atleast_1d(keys.lower_A), np.atleast_1d(keys.upper_A)
    if lower.size != upper.size and 1 not in (lower.size, upper.size):
        received = f"{lower.size} and {upper.size} numbers"
        raise broken("lower_A and upper_A must name the same coils", received, "give as many of each")
    if not (lower < upper).all():
        must_hold = "every current must have a range: lower_A below upper_A"
        received = f"lower_A = {keys.lower_A} with upper_A = {keys.upper_A}"
        raise broken(must_hold, received, "correct the numbers")


@dataclass(frozen=True, repr=False)
class MapOutput(Record):
    """What is written. reference_current: A."""

    file: Annotated[
        str | None, Key(Annotated[str | None, BeforeValidator(_map_file_name)], "name of the map file")
    ] = None
    reference_current: Annotated[
        float | None,
        Key(
            Positive | None,
            "coil current at which the file states its fields; 1 A, or the middle of [currents]",
            "A",
        ),
    ] = None


_CORNERS: Any = table_of(WorkspaceBox, name="CornerKeys")
_IRON: Any = table_of(IronOfMap)
_OUTPUT: Any = table_of(MapOutput)
_CURRENTS: Any = table_of(CurrentPlan, rules=(_not_empty,))


@dataclass(frozen=True, eq=False, repr=False)
class Recipe(Record):
    """A map recipe.

    What map to make, in SI. device: as written, path or shipped name. spacing (3,) in m, an upper limit. lower, upper
    (3,) in m, or None for the device's workspace. mu_r: None for the initial slope of the device's B-H table.
    refinement: divides the device's mesh sizes. model: of the iron. reaction: whether the map holds the iron's reaction
    to magnets. reference_current: A, or None for the default. file_name: of the map. path and text: the file as read.
    currents: the domain and the training for saturating iron, None for linear iron.
    """

    path: Path
    text: str
    title: Annotated[str, Key(Text, "one line about the map")]
    device: Annotated[str, Key(Text, "device file, relative to the recipe, or name of a shipped device")]
    spacing: Annotated[
        Array, Key(Spacings, "largest distance of neighbouring nodes, one number or [x, y, z]", "mm")
    ]
    lower: Array | None
    upper: Array | None
    mu_r: float | None
    tolerance: float
    refinement: float
    reference_current: float | None
    file_name: str
    model: str = "linear"
    reaction: bool = True
    currents: CurrentPlan | None = None

    @property
    def document(self) -> Document:
        """The file, for errors at its keys."""
        return Document(self.path, self.text, {})

    def error(self, key: str, must_hold: str, received: str, remedy: str) -> RecipeError:
        """An error at a key of the file.

        Parameters
        ----------
        key
            The key.
        must_hold
            Requirement at the key.
        received
            Value at the key.
        remedy
            Remedy.

        Returns
        -------
        RecipeError
            The error, to be raised.
        """
        return RecipeError(self.document.problem(key, must_hold, received, remedy))

    def box(self, device: Device) -> Bounds | None:
        """The box of the map: from the recipe, or else around the device's workspace.

        Parameters
        ----------
        device
            The device of the recipe.

        Returns
        -------
        Bounds | None
            Lower and upper corner (3,), m; None if neither states one.
        """
        return device.bounds if self.lower is None or self.upper is None else (self.lower, self.upper)


_RECIPE: Any = table_of(Recipe, bases=(Versioned,))


class BoxKeys(_CORNERS):
    """The box of the map, where it is not the device's workspace."""


class RecipeFile(_RECIPE):
    """A map recipe."""

    box: BoxKeys | None = Field(default=None, description="the box; the device's workspace if left out")
    iron: _IRON = Field(default=_IRON(), description="how the iron is modelled")
    currents: _CURRENTS | None = Field(
        default=None, description="domain of the currents, where the iron saturates"
    )
    output: _OUTPUT = Field(default=_OUTPUT(), description="what is written")

    @model_validator(mode="after")
    def _currents_where_iron_saturates(self) -> "RecipeFile":
        saturating = self.iron.model != "linear"
        if saturating and self.currents is None:
            raise broken(
                "a map of saturating iron must state the currents that it is for",
                f'iron.model = "{self.iron.model}" without [currents]',
                "add [currents] with lower_A and upper_A",
            )
        if not saturating and self.currents is not None:
            raise broken(
                "[currents] belongs to saturating iron: with linear iron a map holds for all currents",
                f'iron.model = "{self.iron.model}"',
                'write iron.model = "saturating", or leave [currents] out',
            )
        return self

    def also_makes(self) -> Mapping[str, Any]:
        """Attributes of the `Recipe` from the tables, in SI units."""
        iron, output = record_of(self.iron), record_of(self.output)
        corners = (None, None) if self.box is None else record_of(self.box).bounds
        plan = None if self.currents is None else record_of(self.currents, tolerance=iron.tolerance)
        return vars(iron) | vars(output) | {"lower": corners[0], "upper": corners[1], "currents": plan}


RECIPE = FileKind(
    "recipe",
    RecipeFile,
    RecipeError,
    "maps",
    refers_to={"device": 'a recipe names it (device = "{file}") and how fine the map shall be (spacing_mm)'},
)


def read_recipe(path_or_name: PathLike) -> Recipe:
    """Read and check a recipe file, as docs/recipes.md describes it.

    Parameters
    ----------
    path_or_name
        Path of the file, or the name of a shipped recipe ("quick").

    Raises
    ------
    RecipeError
        One Problem for every error of the file: file, line and key path; what must hold; what was received; the remedy.

    Examples
    --------
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
    """The recipe of a map of a device, without a recipe file. Its text is made from the arguments.

    Parameters
    ----------
    device
        The device.
    spacing
        Largest distance of nodes, one number or three, m.
    box
        (lower, upper), m, or a WorkspaceBox; the device's workspace if None.
    currents
        None for linear iron. For saturating iron the smallest and the largest current, A, each one number or one per
        coil, or a mapping with the keys of [currents].
    iron
        Keys of [iron], such as {"refinement": 0.7}.
    reference_current
        Current of every coil at which the file states its fields, A.

    Raises
    ------
    RecipeError
        One Problem for everything that is wrong.

    Examples
    --------
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
    """Numbers in a unit, as lists. Other values stay as they are: the schema refuses them."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one, unit) for one in value]
    return in_unit(float(value), unit) if is_number(value) and unit != 1.0 else value


def _recipe(document: Document, contents: Any) -> Recipe:
    path = document.path
    name = contents.output.file or f"{path.stem}.h5"
    recipe: Recipe = record_of(contents, path=path, text=document.text, file_name=name)
    return recipe


def read_recipe_device(recipe: Recipe, changes: Mapping[str, Any] | None = None) -> Device:
    """The device that a recipe names: a file relative to the recipe, or a shipped device. changes: see `read_device`.

    Raises RecipeError if there is no such device, and DeviceFileError if its file is wrong.
    """
    beside = recipe.path.parent / recipe.device
    if is_file(beside):
        return read_device(beside, changes)
    shipped = shipped_file("geometry", recipe.device)
    if shipped is not None:
        return read_device(shipped, changes)
    names = shipped_names("geometry")
    remedy = meant(recipe.device, names, f"give a path relative to the recipe, or one of {one_of(names)}")
    must_hold = "a device file relative to the recipe, or the name of a shipped device"
    raise recipe.error("device", must_hold, shown(recipe.device), remedy)


def require_hysteresis(device: Device) -> None:
    """Raise RecipeError unless some of a device's iron has a coercive field, and there is no background field."""
    materials = [device.materials[body.material] for body in device.bodies]
    soft = [one for one in materials if isinstance(one, SaturatingMaterial)]
    problems = []
    if not any(one.coercive_field > 0.0 for one in soft):
        must_hold = "a device with iron that has hysteresis"
        remedy = 'give a material of the device coercive_field_A_per_m, or write model = "saturating"'
        problems.append(AtKey("iron.model", must_hold, "no material with a coercive field", remedy))
    if device.background is not None:
        must_hold, remedy = "a device without [background] for iron with hysteresis", "leave it out"
        problems.append(AtKey("iron.model", must_hold, "a background field", remedy))
    if problems:
        raise RecipeError(*problems)


def choose_grid(box: Bounds | None, spacing: Array, multiple: int = 1) -> Grid:
    """Nodes that fill a box from face to face.

    Parameters
    ----------
    box
        Corners (3,) and (3,), m; None is refused.
    spacing
        Largest distance (3,) of neighbouring nodes, m. The grid's distance is this or less, so that whole cells fill
        the box.
    multiple
        Divides the number of cells along each axis.

    Raises
    ------
    RecipeError
        If the box is None, or there are too few nodes.
    """
    if box is None:
        must_hold, remedy = "a box, since the device has no workspace", "add [box] with lower_mm and upper_mm"
        raise RecipeError(AtKey("box", must_hold, "nothing", f"{remedy}, each [x, y, z]"))
    lower, upper = box
    extent = upper - lower
    # A part in 1e9 is rounding: a box of 40 mm takes 10 cells of 4 mm, not 11.
    cells = multiple * np.maximum(np.ceil(extent / spacing * (1 - 1e-9) / multiple), 1).astype(np.int64)
    size = f"a box of {_millimetres(extent)} mm and a spacing of {_millimetres(spacing)} mm"
    received = f"{size}, which gives {' x '.join(str(n + 1) for n in cells)} nodes"
    if int(cells.min()) + 1 < FEWEST_NODES:
        must_hold = f"at least {FEWEST_NODES} nodes along each axis"
        remedy = f"divide the box into at least {FEWEST_NODES - 1} cells: a smaller spacing or a larger box"
        raise RecipeError(AtKey("spacing_mm", must_hold, received, remedy))
    nx, ny, nz = (int(n) + 1 for n in cells)
    return Grid(lower, extent / cells, (nx, ny, nz))


def _millimetres(lengths: Array) -> str:
    return " x ".join(f"{length / MILLI:g}" for length in lengths)
