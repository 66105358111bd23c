"""From a recipe to a map file: check, solve, evaluate part by part, measure the interpolant, finish."""

import platform
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Device
from fieldmap.errors import FieldmapError, MapFileError, Problem, RecipeError
from fieldmap.iron import LinearSolution, check_geometry, solve_linear
from fieldmap.maps.certificate import SOLVER_POINTS, certified_bounds
from fieldmap.maps.evaluation import DividedFields
from fieldmap.maps.interpolation import interpolation_error
from fieldmap.maps.placement import choose_grid, with_box
from fieldmap.maps.recipe import CurrentPlan, Recipe, current_domain, read_recipe, read_recipe_device
from fieldmap.maps.reduction.domain import corners
from fieldmap.maps.saturating import archive_path, trained_map
from fieldmap.maps.solver_state import from_arrays, to_arrays
from fieldmap.maps.stopwatch import Stopwatch
from fieldmap.parallel import Workers, same_arithmetic
from fieldmap.provenance import fingerprint, library_versions
from fieldmap.store import MapData, MapInfo, MapWriter, Provenance, open_writer, read_info

Progress = Callable[[str, float], None]
OUTPUT_FOLDER = Path("maps/out")
# Rooms whose code takes part in making a map.
ROOMS = (
    "kernels",
    "parallel",
    "inputs",
    "device",
    "field",
    "currents",
    "store",
    "interpolants",
    "sources",
    "iron",
    "maps",
)
# Shares of the whole at which a step begins; the fields at the nodes and the certificate share what is left.
SOLVE, EVALUATE, TRAINED = 0.03, 0.6, 0.9


def generate(
    recipe: str | PathLike[str],
    output: str | PathLike[str] | None = None,
    resume: bool = True,
    progress: Progress | None = None,
    workers: int = 1,
    scheduler: str | None = None,
) -> Path:
    """Make the map that a recipe asks for and return the path of its file.

    recipe: path of a recipe file, or the name of a shipped one. output: the file to write, by default
    maps/out/NAME.h5 in the current folder, with the recipe's file name or its stem. resume: go on with a run
    that was stopped, and leave a finished map alone, if everything that decides the numbers is the same;
    False begins anew. progress(message, fraction) is called as the work goes on. workers: how many processes of this
    machine solve and evaluate, 1 for this one alone; scheduler: address of a dask scheduler whose workers do it
    (docs/cluster.md). The numbers are the same bit for bit, whoever computes them.

    The file appears under its name only when it is complete. Raises RecipeError, DeviceFileError,
    GeometryError (a box that cuts iron or a winding) or InputError (an output that cannot be written) before
    any long work and without leaving a file; InputError for workers that cannot be had; NotConverged if the solver
    fails, or where iron saturates at more than half of the states.

    >>> import fieldmap as fm
    >>> fm.generate("quick")                                                      # doctest: +SKIP
    PosixPath('maps/out/quick.h5')
    >>> fm.generate("quikc")
    Traceback (most recent call last):
    fieldmap.errors.RecipeError: quikc: must be a recipe file or the name of a shipped recipe; received ...
    """
    say = progress or _silent
    say("checking recipe, device and geometry", 0.0)
    order = read_recipe(Path(recipe))
    device = read_recipe_device(order)
    target = _target(order, output)
    info = _describe(order, device)
    placed = with_box(device, info.grid)
    check_geometry(placed)
    if resume and _is_done(target, info):
        say("complete already", 1.0)
        return target
    with same_arithmetic(), Workers(workers, scheduler) as team:
        if order.currents is None:
            _generate_linear(order, placed, info, target, resume, team, say)
        else:
            _generate_saturating(order, order.currents, placed, info, target, resume, team, say)
    say("complete", 1.0)
    return target


def _generate_linear(
    recipe: Recipe, device: Device, info: MapInfo, target: Path, resume: bool, workers: Workers, say: Progress
) -> None:
    with open_writer(target, info, resume) as writer:
        _say_resumed(writer, say)
        solution = DividedFields(_solution(device, recipe, writer, say), workers)
        _fill(writer, solution, info.reference_current, dict, say)


def _generate_saturating(
    recipe: Recipe,
    plan: CurrentPlan,
    device: Device,
    info: MapInfo,
    target: Path,
    resume: bool,
    workers: Workers,
    say: Progress,
) -> None:
    if not resume:
        archive_path(target).unlink(missing_ok=True)
    trained = trained_map(
        device,
        current_domain(recipe, plan, len(device.coils)),
        plan,
        info.reference_current,
        info.grid,
        target,
        info.provenance.fingerprint,
        workers,
        lambda message, share: say(message, SOLVE + share * (TRAINED - SOLVE)),
    )
    info = replace(info, reduced_model=trained.model, current_error=trained.error)
    spent = Stopwatch(workers, *trained.spent)
    with open_writer(target, info, resume) as writer:
        _say_resumed(writer, say)
        fields = DividedFields(trained.fields, workers)
        _fill(writer, fields, trained.largest_weights, lambda: {**trained.about, **spent.read()}, say)
    archive_path(target).unlink(missing_ok=True)


def _say_resumed(writer: MapWriter, say: Progress) -> None:
    if writer.note or writer.resumed:
        say(writer.note or f"resumed with {writer.resumed} of {len(writer.chunks)} parts", EVALUATE)


def _fill(
    writer: MapWriter,
    solution: DividedFields,
    largest_weights: NDArray[np.float64],
    about: Callable[[], Mapping[str, Any]],
    say: Progress,
) -> None:
    """Fields at the nodes, and the rest of the file; about(): what the report says beside the solver's."""
    _evaluate(solution, writer, say)
    say("certifying the lookup against the solver", _certificate_begins(writer.info))
    _finish(solution, largest_weights, about, writer)


def _describe(recipe: Recipe, device: Device) -> MapInfo:
    """The map to be, checked as far as it can be without its geometry."""
    if not device.coils:
        raise recipe.error(
            "device", "a device with at least one coil", "none", "add a [[coil]] to the device"
        )
    magnets = [b.name for b in device.bodies if device.materials[b.material].role == "magnet"]
    if magnets:
        must_hold = "a device whose field follows the coil currents alone, as a map of unit fields holds it"
        received = f"permanent magnets: {', '.join(magnets)}"
        raise recipe.error("device", must_hold, received, "solve it directly, or make them linear iron")
    return MapInfo(
        grid=choose_grid(recipe, device),
        coil_names=device.coil_names,
        reference_current=_reference_current(recipe, device),
        provenance=Provenance(
            title=recipe.title,
            device_name=device.name,
            recipe_text=recipe.text,
            device_text=device.text,
            fingerprint=fingerprint((recipe.text, *device.texts), ROOMS),
            versions=library_versions(),
            included=dict(device.included),
            created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S +0000"),
        ),
    )


def _reference_current(recipe: Recipe, device: Device) -> NDArray[np.float64]:
    """As the recipe says; else 1 A, or the middle of the domain of the currents, where that is positive."""
    count = len(device.coils)
    if recipe.currents is None:
        return np.full(count, 1.0 if recipe.reference_current is None else recipe.reference_current)
    domain = current_domain(recipe, recipe.currents, count)
    if recipe.reference_current is None:
        middle = domain.middle
        return np.where(middle > 0, middle, np.abs(corners(domain)).max(initial=1.0))
    given = np.full(count, recipe.reference_current)
    # Of a division any equal currents will do: they are signals without directions.
    independent = recipe.currents.division_n is None
    if independent and ((given < domain.lower) | (given > domain.upper)).any():
        raise recipe.error(
            "output.reference_current_A",
            "must lie within [currents]",
            f"{recipe.reference_current:g}",
            "choose a current that the map holds for, or leave it out",
        )
    return given


def _target(recipe: Recipe, output: str | PathLike[str] | None) -> Path:
    target = OUTPUT_FOLDER / recipe.file_name if output is None else Path(output)
    if target.is_dir():
        received = "a folder"
    elif not target.name or target.suffix not in (".h5", ".hdf5"):
        received = f'"{target.name}"'
    else:
        return target
    problem = Problem(str(target), "a file name that ends in .h5", received, "name the file, such as map.h5")
    raise RecipeError(problem)


def _is_done(target: Path, info: MapInfo) -> bool:
    if not target.is_file():
        return False
    try:
        return read_info(target).provenance.fingerprint == info.provenance.fingerprint
    except MapFileError:
        return False


def _solution(device: Device, recipe: Recipe, writer: MapWriter, say: Progress) -> LinearSolution:
    """The solution kept in the partial file, or a new one, which is then kept."""
    kept = writer.state()
    if kept is not None:
        return from_arrays(device, *kept)
    try:
        solution = solve_linear(
            device,
            recipe.mu_r,
            recipe.tolerance,
            lambda message, fraction: say(message, SOLVE + fraction * (EVALUATE - SOLVE)),
            recipe.refinement,
        )
    except FieldmapError:
        writer.discard()
        raise
    arrays, about = to_arrays(solution)
    writer.save_state(arrays, about)
    # Evaluated from what was kept, so that a resumed run gives the same bits.
    return from_arrays(device, arrays, about)


def _evaluate(solution: DividedFields, writer: MapWriter, say: Progress) -> None:
    total, missing = len(writer.chunks), writer.missing
    share = (_certificate_begins(writer.info) - EVALUATE) / total
    _, ny, nz = writer.info.grid.shape
    done = total - len(missing)

    def tell() -> None:
        if done < total:
            say(f"field at the nodes, part {done + 1} of {total}", EVALUATE + done * share)

    tell()
    parts = [writer.info.grid.points(chunk.first, chunk.last) for chunk in missing]
    for index, (flux, gradient) in solution.of_parts(parts):
        chunk = missing[index]
        planes = (len(flux), chunk.last - chunk.first, ny, nz)
        writer.write(chunk, flux.reshape(*planes, 3), gradient.reshape(*planes, 3, 3))
        done += 1
        tell()


def _certificate_begins(info: MapInfo) -> float:
    """As if all that remains were fields of the solver at points: at the nodes, then at those of the certificate."""
    nodes = int(np.prod(info.grid.shape))
    return EVALUATE + (1 - EVALUATE) * nodes / (nodes + SOLVER_POINTS)


def _finish(
    solution: DividedFields,
    largest_weights: NDArray[np.float64],
    about: Callable[[], Mapping[str, Any]],
    writer: MapWriter,
) -> None:
    parts = [writer.read(chunk) for chunk in writer.chunks]
    flux, gradient = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
    data = MapData(**{**vars(writer.info), "flux_density": flux, "gradient": gradient})
    error, bounds = interpolation_error(data, solution), certified_bounds(data, solution, largest_weights)
    report: dict[str, Any] = asdict(solution.report) | dict(about()) | _finished_by(solution.workers)
    assumptions = tuple(report.pop("assumptions"))
    writer.finish(report, assumptions, error, bounds)


def _finished_by(workers: Workers) -> dict[str, str]:
    """Who finished a map: nothing that decides its numbers, as long as the processors are of one kind."""
    return {"workers": str(workers), "machine": f"{platform.system()}, {platform.machine()}"}


def _silent(message: str, fraction: float) -> None:
    """Progress that nobody asked for."""
