"""Read a map recipe and check all of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.currents import CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device import Device, read_device
from fieldmap.errors import RecipeError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import closest, one_of, shown
from fieldmap.maps.reduction.plan import Plan
from fieldmap.maps.schema import RECIPE, RecipeFile
from fieldmap.shipped import shipped_file, shipped_names
from fieldmap.typing import Array

MILLI = 1e-3


@dataclass(frozen=True, eq=False)
class CurrentPlan:
    """Saturating iron: the ranges of the currents as written, and how the reduced model is trained.

    lower, upper: A, of each coil, or one number for all; or of u, x and y, where division_n is given.
    """

    lower: Array
    upper: Array
    division_n: float | None
    refinement: float
    training: Plan


@dataclass(frozen=True, eq=False)
class Recipe:
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
    path = RECIPE.find(path_or_name)
    document = RECIPE.load(path)
    contents = RECIPE.contents(document)
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
    if keys.division is None:
        lower, upper = (np.atleast_1d(np.array(amperes, float)) for amperes in (keys.lower_A, keys.upper_A))
        return CurrentPlan(lower, upper, None, iron.refinement, training)
    ranges = np.array([keys.division.u_A, keys.division.x, keys.division.y])
    return CurrentPlan(ranges[:, 0], ranges[:, 1], keys.division.n, iron.refinement, training)


def current_domain(recipe: Recipe, plan: CurrentPlan, coils: int) -> CurrentDomain:
    """The domain of the currents for a device of so many coils. Raises RecipeError if it has another number."""
    if plan.division_n is not None:
        if coils != 6:
            must_hold = "a division is for six coils, named in the order of the thesis"
            raise recipe.error("currents.division", must_hold, f"{coils} coils", "give lower_A and upper_A")
        return CurrentDomain(LiftAndDirections(plan.division_n), plan.lower, plan.upper)
    for key, values in (("lower_A", plan.lower), ("upper_A", plan.upper)):
        if values.size not in (1, coils):
            must_hold = f"one current for all coils, or one for each of the {coils} coils"
            raise recipe.error(f"currents.{key}", must_hold, f"{values.size} currents", "correct the list")
    lower, upper = (np.broadcast_to(values, coils).copy() for values in (plan.lower, plan.upper))
    return CurrentDomain(IndependentCurrents(coils), lower, upper)


def read_recipe_device(recipe: Recipe) -> Device:
    """The device that a recipe names: beside the recipe, or a shipped one.

    Raises RecipeError if there is none, and DeviceFileError if its file is wrong.
    """
    beside = recipe.path.parent / recipe.device
    if beside.is_file():
        return read_device(beside)
    shipped = shipped_file("geometry", recipe.device)
    if shipped is not None:
        return read_device(shipped)
    names = shipped_names("geometry")
    guess = closest(recipe.device, names)
    remedy = (
        f'did you mean "{guess}"?'
        if guess
        else f"give a path relative to the recipe, or one of {one_of(names)}"
    )
    must_hold = "a device file relative to the recipe, or the name of a shipped device"
    raise recipe.error("device", must_hold, shown(recipe.device), remedy)
