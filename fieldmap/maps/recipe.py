"""Read a map recipe and check all of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.device import Device, read_device
from fieldmap.errors import Problem, RecipeError
from fieldmap.inputs.document import find_input_file, load_input_file, schema_findings
from fieldmap.inputs.findings import closest, one_of, shown
from fieldmap.inputs.toml_lines import line_numbers, nearest_line
from fieldmap.maps.reduction.domain import CurrentDomain
from fieldmap.maps.reduction.plan import Plan
from fieldmap.maps.schema import RecipeFile
from fieldmap.shipped import shipped_file, shipped_names
from fieldmap.typing import Array

MILLI = 1e-3


@dataclass(frozen=True, eq=False)
class CurrentPlan:
    """Saturating iron: the domain of the currents (one number may stand for all coils), and how the reduced model is
    trained."""

    domain: CurrentDomain
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
        line = nearest_line(line_numbers(self.text), tuple(key.split("."))) if key else None
        place = f"{self.path}:{line}" if line else str(self.path)
        return RecipeError(Problem(f"{place}: {key}" if key else place, must_hold, received, remedy))


def read_recipe(path_or_name: str | Path) -> Recipe:
    """Read and check a recipe file: its path, or the name of a shipped recipe ("quick").

    The format is described in docs/recipes.md. Raises RecipeError with one Problem for every error of the
    file: file, line and key path; what must hold; what was received; the remedy.

    >>> read_recipe("quick").device
    'disk_six_cores'
    """
    path = find_input_file(path_or_name, "recipe", RecipeError, "maps")
    document = load_input_file(path, "recipe", RecipeError)
    findings = schema_findings(RecipeFile, document.data)
    if findings:
        raise RecipeError(*document.problems(findings))
    contents = RecipeFile.model_validate(document.data)
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
        return CurrentPlan(CurrentDomain(lower, upper), iron.refinement, training)
    ranges = np.array([keys.division.u_A, keys.division.x, keys.division.y])
    domain = CurrentDomain(ranges[:, 0], ranges[:, 1], keys.division.n)
    return CurrentPlan(domain, iron.refinement, training)


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
