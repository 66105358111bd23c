"""From a recipe to a map file: check, solve, evaluate part by part, bound the error, write."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import raise_all
from fieldmap.currents import CurrentDomain, LiftAndDirections
from fieldmap.device.model import Device, WorkspaceBox
from fieldmap.errors import FieldmapError, InputError, MapFileError, RecipeError
from fieldmap.inputs.document import AtKey
from fieldmap.iron import LinearSolution, check_geometry
from fieldmap.iron.reaction import DipoleAnswers, ReactionFields
from fieldmap.iron.report import Stages
from fieldmap.iron.solvers.linear import solve_linear_and_reaction
from fieldmap.iron.solvers.shared import SharedSolves, what_is_solved
from fieldmap.maps.acceptance import require_accuracy
from fieldmap.maps.error_bound import certified_bounds, interpolation_error
from fieldmap.maps.fields import (
    ANSWERS,
    REACTION,
    SPENT,
    Kept,
    SaturatingFields,
    Stopwatch,
    answers_arrays,
    answers_from,
    from_arrays,
    kept,
    linkage_in_air,
    linkage_of,
    of_single_turns,
    reaction_arrays,
    reaction_from,
    to_arrays,
    trained_arrays,
    trained_map,
)
from fieldmap.maps.forecast import STAGES, expect_by_assembly, expect_fields
from fieldmap.maps.large import STEPS, before_the_start, certified, make_cells
from fieldmap.maps.near_sources import largest_field, require_distance, require_use
from fieldmap.maps.recipe import (
    Recipe,
    choose_grid,
    read_recipe,
    read_recipe_device,
    recipe_for,
    require_hysteresis,
)
from fieldmap.maps.training.currents import corner_signals
from fieldmap.maps.training.plan import Plan
from fieldmap.parallel import Common, Workers, same_arithmetic
from fieldmap.progress import Forecast, peak_memory, rate, shown_or_silent
from fieldmap.provenance import fingerprint, library_versions
from fieldmap.store import (
    Checkpoint,
    Chunk,
    Grid,
    LargeMap,
    LargeMapWriter,
    MapData,
    MapInfo,
    MapWriter,
    Provenance,
    StoredFields,
    StoredLinkage,
    StoredReaction,
    StoredSensors,
    checkpoint_path,
    read_info,
)
from fieldmap.store.large_map import LARGE, bytes_of_numbers
from fieldmap.store.map_format import chunks_of
from fieldmap.store.map_writer import what_decides
from fieldmap.store.output_formats import output_problems
from fieldmap.store.stated_accuracy import MissedAccuracy
from fieldmap.typing import Array, PathLike, Progress

OUTPUT_FOLDER = Path("maps/out")
# Packages and modules whose code takes part in making a map.
CODE = (
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
# Number of charged faces assumed until the iron is meshed.
_FACES = 10_000
# Stages of every map, after its fields are found.
_FILLING = ("nodes", "certificate")
# Points of one piece of work, about the number of nodes in a part of the file.
_POINTS = 1000
Fields: TypeAlias = LinearSolution | SaturatingFields
Writer: TypeAlias = MapWriter | LargeMapWriter


def generate(
    recipe: PathLike | Device,
    output: PathLike | None = None,
    resume: bool = True,
    progress: Progress | bool | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    *,
    spacing: ArrayLike | None = None,
    box: WorkspaceBox | Sequence[ArrayLike] | None = None,
    currents: Sequence[ArrayLike] | Mapping[str, Any] | None = None,
    iron: Mapping[str, Any] | None = None,
    reference_current: float | None = None,
    changes: Mapping[str, Any] | None = None,
    accept_error: bool = False,
    large: bool | None = None,
) -> Path:
    """Make the map that a recipe asks for, or a map of a device, and return the path of its file.

    The file appears under its name only when it is complete. Errors in recipe, device, geometry or
    output are reported before any long work, and leave no file.

    Parameters
    ----------
    recipe
        Path of a recipe file, or the name of a shipped recipe; or a device, with the arguments spacing, box, currents,
        iron and reference_current. The map is the same as from a recipe with these numbers.
    output
        The file to write; unless given maps/out/NAME.h5, with the file name in the recipe or the recipe's own stem.
    resume
        Continue a stopped run, or keep a finished map, if the inputs that determine its numbers are the same; False
        starts again.
    progress
        Function, called as progress(message, fraction). None prints a bar with the time left if stderr is a terminal,
        True prints the bar or plain lines wherever stderr goes, False prints nothing.
    workers
        Number of processes of this machine, 1 for this process alone. The map is the same for any number, bit for bit.
    scheduler
        Address of a dask scheduler whose workers do the work (docs/cluster.md).
    spacing
        Largest distance of neighbouring nodes, one number or three, m.
    box
        (lower, upper), m, or a WorkspaceBox.
    currents
        (smallest, largest), A, for saturating iron; as in `fieldmap.maps.recipe_for`.
    iron
        Keys of [iron].
    reference_current
        Current of every coil at which the file states its fields, A.
    changes
        Changed keys of the device file that a recipe names, such as {"parameters.gap": 120.0}: see `read_device`.
    accept_error
        Write a map of saturating iron even if the largest error at a state that tests its current model is more than
        twice the accuracy of the recipe. The map then states the error among its assumptions, and opening it warns
        (MapAccuracyWarning). The box may then be close to iron and magnets, but not touch them.
    large
        Make a large map, whose numbers are never in memory as a whole (docs/map_file.md). Unless given, a map with
        more than half a GB of numbers is made as a large one.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RecipeError, DeviceFileError, GeometryError
        For a wrong recipe or device, for a box that cuts iron or a winding or is too near to iron or magnets for the
        wanted accuracy, and for a disk without enough space.
    InputError
        For an output that cannot be written, and workers that cannot be started.
    NotConverged
        If the solver fails; for saturating iron, if it fails at more than half of the states or at all that test the
        model.
    MapErrorTooLarge
        As soon as the error exceeds the accepted one. No map is written, the solved states are kept, and the same call
        with accept_error=True continues.

    Examples
    --------
    >>> import fieldmap as fm
    >>> fm.generate("quick")                                                      # doctest: +SKIP
    PosixPath('maps/out/quick.h5')
    >>> fm.generate("quikc")
    Traceback (most recent call last):
    fieldmap.errors.RecipeError: quikc: must be a recipe file or the name of a shipped recipe; received ...
    """
    said = {
        "spacing": spacing,
        "box": box,
        "currents": currents,
        "iron": iron,
        "reference_current": reference_current,
    }
    given = {name: value for name, value in said.items() if value is not None}
    with shown_or_silent("map", progress, timed=True) as say:
        say("checking recipe, device and geometry", 0.0)
        order, device = _order(recipe, given, changes)
        by = Workers(workers, scheduler)
        return make_map(order, device, output, resume, say, by, accept_error, large=large)


def make_map(
    order: Recipe,
    device: Device,
    output: PathLike | None,
    resume: bool,
    say: Progress,
    workers: Workers,
    accept_error: bool,
    shared: SharedSolves | None = None,
    large: bool | None = None,
) -> Path:
    """Make the map of a recipe that was read, for `device` in place of the device in the recipe: see `generate`.

    Parameters
    ----------
    order, device
        The recipe and the device.
    output, resume, say, accept_error, large
        As for `generate`.
    workers
        Processes for the work, started only if there is work to do.
    shared
        Checks and solutions of earlier maps in this process, which this map extends; for saturating iron only checks.

    Returns
    -------
    Path
        The file.
    """
    target, plan, shared = _target(order.file_name, output), order.currents, shared or SharedSolves()
    # Errors at keys name the lines of the recipe.
    with order.document.placing():
        if not device.coils and (plan is not None or not device.fixed_sources):
            must_hold, remedy = "a device with at least one coil", "add a [[coil]] to the device"
            raise RecipeError(AtKey("device", must_hold, "none", remedy))
        fields = len(device.coils) + bool(device.fixed_sources) + (0 if plan is None else plan.fields)
        grid = choose_grid(order.box(device), order.spacing)
        if large is None:
            large = bytes_of_numbers(grid, fields) > LARGE
        if large:
            grid = choose_grid(order.box(device), order.spacing, STEPS[0])
        domain = None if plan is None else plan.domain(device.coil_names)
        reference = _reference_current(order.reference_current, domain, len(device.coils))
        if order.model == "hysteresis":
            require_hysteresis(device)
        info = _describe(device, grid, reference, order.title, order.text, plan is not None)
        # The geometry checks take the box of the map as the workspace of the device.
        box = WorkspaceBox(grid.lower, grid.upper)
        placed = Device.unchecked(**vars(device) | {"workspace": box})
        single = of_single_turns(placed)
        accuracy = None if plan is None else plan.accuracy

        def require_room() -> None:
            check_geometry(single)
            require_distance(single, grid, accuracy, accept_error)

        shared.once((what_is_solved(single), grid.spacing, accuracy, accept_error), require_room)
        if resume and (report := _finished(target, info)) is not None:
            require_accuracy(report, plan, target, accept_error)
            say("complete already", 1.0)
            return target
        if large:
            say(before_the_start(device, grid, fields, target), 0.0)
        with (
            same_arithmetic(),
            workers as team,
            Checkpoint(
                checkpoint_path(target), what_decides(info) | ({"form": "large"} if large else {}), resume
            ) as checkpoint,
            (LargeMapWriter if large else MapWriter)(target, info, checkpoint) as writer,
        ):
            if checkpoint.note:
                say(f"{checkpoint.path.name}: {checkpoint.note}", 0.0)
            try:
                if plan is None or domain is None:
                    _linear(order, placed, single, writer, team, say, shared)
                else:
                    _saturating(order, placed, domain, plan, writer, team, say, accept_error)
            except FieldmapError as error:
                # An empty checkpoint is no use, and with a field at fault in the box another run ends the same way.
                if not len(checkpoint) or isinstance(error, RecipeError | MapFileError):
                    writer.discard()
                raise
    say("complete", 1.0)
    return target


def _order(
    recipe: PathLike | Device, said: dict[str, Any], changes: Mapping[str, Any] | None
) -> tuple[Recipe, Device]:
    """The recipe and its device. Raises RecipeError for arguments that do not fit."""
    if isinstance(recipe, Device):
        if "spacing" not in said:
            remedy = "give the largest distance of neighbouring nodes, m, such as spacing=4e-3"
            raise RecipeError.of("generate, spacing", "a map of a device needs it", "nothing", remedy)
        if changes:
            must_hold, remedy = "belongs to a recipe, which names a file", "write device.replace(...)"
            raise RecipeError.of("generate, changes", must_hold, "a device", remedy)
        return recipe_for(recipe, **said), recipe
    if not isinstance(recipe, str | os.PathLike):
        must_hold = "must be a recipe file, the name of a shipped recipe, or a device"
        remedy = "give the device: generate(device, spacing=4e-3)"
        raise RecipeError.of("generate", must_hold, type(recipe).__name__, remedy)
    if said:
        names = ", ".join(said)
        remedy = (
            "write it into the recipe, or give a device in its place: generate(fm.read_device(NAME), ...)"
        )
        raise RecipeError.of(f"generate, {names}", "belongs to a device, not a recipe", names, remedy)
    order = read_recipe(Path(recipe))
    return order, read_recipe_device(order, changes)


def _linear(
    order: Recipe,
    device: Device,
    single: Device,
    writer: Writer,
    workers: Workers,
    say: Progress,
    shared: SharedSolves,
) -> None:
    """Make the map of linear iron. single: the device with one turn in every coil, its geometry checked; shared:
    solutions of earlier maps."""
    forecast = Forecast(say, dict.fromkeys(("solving", *_FILLING), 0.0), workers.processes)
    grid, checkpoint = writer.info.grid, writer.checkpoint
    expect_fields(forecast, grid, _FACES, len(device.coils))

    def tell(message: str, share: float) -> None:
        if share > 0.0:
            forecast.expect("solving", forecast.taken() / share)
        forecast.at("solving", message, share)

    def solve() -> Kept:
        box = (grid.lower, grid.upper) if order.reaction else None
        how = (order.mu_r, order.tolerance)
        solution, reaction, answers = shared.once(
            (what_is_solved(single), *how, order.refinement, box),
            lambda: solve_linear_and_reaction(
                single, *how, Stages(tell), order.refinement, box=box, shared=shared
            ),
        )
        checkpoint.put(REACTION, *reaction_arrays(reaction))
        checkpoint.put(ANSWERS, *answers_arrays(answers))
        return to_arrays(solution, np.array([coil.turns for coil in device.coils]))

    solution = from_arrays(device, *kept(checkpoint, "solution", solve))
    linkage = partial(linkage_of, solution, shared)
    _fill(writer, order.tolerance, device, solution, linkage, workers, writer.info.field_scale, forecast)


def _saturating(
    order: Recipe,
    device: Device,
    domain: CurrentDomain,
    plan: Plan,
    writer: Writer,
    workers: Workers,
    say: Progress,
    accept_error: bool,
) -> None:
    """Make the map of saturating iron, with or without hysteresis."""
    forecast = Forecast(say, dict.fromkeys((*STAGES, *_FILLING), 0.0), workers.processes)

    def assembling(message: str, share: float) -> None:
        if share > 0.0:
            expect_by_assembly(forecast, forecast.taken() / share, plan.states, plan.held_out)
        forecast.at("assembling", message, share)

    info, checkpoint = writer.info, writer.checkpoint
    kind = order.model == "hysteresis", order.reaction
    solve = (device, domain, plan, order.refinement, info.reference_current, info.grid, *kind)
    by = (checkpoint, workers, assembling, forecast)
    trained = trained_map(device, *kept(checkpoint, "trained model", trained_arrays, *solve, *by))
    accepted = require_accuracy(trained.about, plan, writer.target, accept_error)
    spent = Stopwatch(workers, *(trained.about[name] for name in SPENT))
    writer.info = replace(info, reduced_model=trained.model, current_error=trained.error)
    linkage = partial(linkage_in_air, device, trained.remanent)
    weights, about = trained.largest_weights, trained.about
    _fill(
        writer,
        order.tolerance,
        device,
        trained.fields,
        linkage,
        workers,
        weights,
        forecast,
        about,
        spent,
        accepted,
    )


def _fill(
    writer: Writer,
    tolerance: float,
    device: Device,
    fields: Fields,
    linkage: Callable[[], StoredLinkage],
    workers: Workers,
    largest_weights: Array,
    forecast: Forecast,
    about: Mapping[str, Any] = MappingProxyType({}),
    spent: Stopwatch | None = None,
    accepted: MissedAccuracy | None = None,
) -> None:
    """Evaluate the fields at the nodes, measure their error, and write the file. tolerance: of the solver; about:
    further entries of the report; spent: time of the map so far; accepted: an error for the assumptions to state."""
    if writer.resumed:
        forecast.note(f"resumed with {writer.resumed} of {len(writer.chunks)} parts")
    expect_fields(forecast, writer.info.grid, fields.report.surface_faces, len(largest_weights))
    forecast.expect("nodes", forecast.expected("nodes") * len(writer.missing) / len(writer.chunks))
    common = Common.of(fields)
    _evaluate(common, workers, writer, forecast)
    forecast.at("certificate", "certifying the lookup against the solver")

    def unit_fields(points: Array) -> tuple[Array, Array]:
        # The pieces depend on the points alone, so that the number of workers changes no bit.
        parts = [points[first : first + _POINTS] for first in range(0, len(points), _POINTS)]
        pairs = workers.results(_unit_fields, parts, common)
        flux, gradient = (np.concatenate(arrays, axis=1) for arrays in zip(*pairs, strict=True))
        return flux, gradient

    reaction = reaction_from(*kept(writer.checkpoint, REACTION, reaction_arrays, None))
    linkages, lacking = _known_linkage(linkage)
    grid, every, cells = writer.info.grid, 1, None
    if isinstance(writer, LargeMapWriter):
        every, cells = make_cells(writer, tolerance, forecast.note)
        grid = grid.every(every)
    of_iron: dict[str, Any] = {"reaction": None, "linkage": linkages}
    if reaction is not None:
        of_iron["reaction"] = StoredReaction(*_at_nodes(reaction, grid, workers), reaction.repelled)
    of_iron["sensors"] = _sensors(device, fields, writer.checkpoint, grid, workers)
    if isinstance(writer, LargeMapWriter):
        assert cells is not None
        data: MapData | LargeMap
        data, error, bounds = certified(writer, every, cells, of_iron, unit_fields, largest_weights)
        largest = float(writer.largest[0])
    else:
        data = replace(writer.data(), **of_iron)
        read = data.as_read()
        error = interpolation_error(read, unit_fields)
        bounds, largest = certified_bounds(read, unit_fields, largest_weights), largest_field(read)
    require_use(largest, error, bounds)
    report: dict[str, Any] = asdict(fields.report) | dict(about)
    assumptions = report.pop("assumptions")
    if reaction is not None:
        report["reaction"] = {"fields": len(reaction.charge), **reaction_arrays(reaction)[1]}
    if lacking:
        report["without_linkage"] = lacking
    if device.sensors and not isinstance(fields, LinearSolution):
        assumptions = (
            *assumptions,
            "sensors: saturating iron answers to magnets as it does without currents",
        )
    if spent is not None:
        report |= spent.read()
        if peak := peak_memory():
            report["generation_peak_memory_bytes"] = peak
    if accepted is not None:
        names = ("flux_density_share", "gradient_share", "asked")
        report["accepted_error"] = {name: getattr(accepted, name) for name in names}
        assumptions = (*assumptions, f"{accepted.text}: accepted with --accept-error")
    # The workers and the machine that finished it. They do not affect its numbers if all processors are of one kind.
    report |= {"workers": str(workers), "machine": f"{platform.system()}, {platform.machine()}"}
    writer.finish(report, assumptions, error, bounds, data)  # type: ignore[arg-type]


def _known_linkage(linkage: Callable[[], StoredLinkage]) -> tuple[StoredLinkage | None, str]:
    """The flux linkages, or None and the reason: some coils have no self-inductance."""
    try:
        return linkage(), ""
    except InputError as error:
        return None, str(error)


def _sensors(
    device: Device, fields: Fields, checkpoint: Checkpoint, grid: Grid, workers: Workers
) -> StoredSensors | None:
    """The device's sensors: their readings of the map's fields, and the iron's response to dipoles at the sensors."""
    if not device.sensors:
        return None
    places, axes = (
        np.array([getattr(one, name) for one in device.sensors]) for name in ("position", "direction")
    )
    shares = np.einsum("ksi,si->sk", fields.source_fields(places)[0], axes)
    answers = answers_from(kept(checkpoint, ANSWERS, answers_arrays, None)[0])
    stored = None if answers is None else StoredFields(*_at_nodes(answers, grid, workers))
    return StoredSensors(tuple(one.name for one in device.sensors), places, axes, shares, stored)


def _at_nodes(of_iron: ReactionFields | DipoleAnswers, grid: Grid, workers: Workers) -> tuple[Array, Array]:
    """Flux density and gradient of fields of the iron at the nodes, rounded to the float32 of the file."""
    chunks = [grid.points(chunk.first, chunk.last) for chunk in chunks_of(grid)]
    pairs = workers.results(_fields_of_iron, chunks, Common.of(of_iron))
    arrays = (
        np.concatenate(parts, axis=1).astype(np.float32).astype(float) for parts in zip(*pairs, strict=True)
    )
    flux, gradient = (values.reshape(len(values), *grid.shape, *values.shape[2:]) for values in arrays)
    return flux, gradient


def _fields_of_iron(of_iron: ReactionFields | DipoleAnswers, points: Array) -> tuple[Array, Array]:
    return of_iron.fields(points)


def _unit_fields(fields: Fields, points: Array) -> tuple[Array, Array]:
    return fields.source_fields(points)


def _fields_at_nodes(fields: Fields, nodes: tuple[Grid, Chunk]) -> tuple[Array, Array]:
    """The fields at the nodes of a part, evaluated at up to _POINTS nodes at a time."""
    grid, chunk = nodes
    points = grid.points(chunk.first, chunk.last)
    if len(points) <= _POINTS:
        return fields.source_fields(points)
    parts = [
        fields.source_fields(points[first : first + _POINTS]) for first in range(0, len(points), _POINTS)
    ]
    flux, gradient = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
    return flux, gradient


def _evaluate(fields: Common[Fields], workers: Workers, writer: Writer, forecast: Forecast) -> None:
    """Evaluate the fields at the nodes of the missing parts, and write them."""
    total, missing, grid = len(writer.chunks), writer.missing, writer.info.grid
    done = before = total - len(missing)

    each = grid.size // grid.shape[0]

    def tell() -> None:
        if done < total:
            now = sum(chunk.last - chunk.first for chunk in missing[: done - before]) * each
            message = f"field at the nodes, part {done + 1} of {total}{rate(now, forecast.taken(), 'node')}"
            forecast.at("nodes", message, done - before, len(missing))

    tell()
    parts = [(grid, chunk) for chunk in missing]
    for outcome in workers.map(_fields_at_nodes, parts, fields):
        flux, gradient = outcome.result()
        chunk = missing[outcome.index]
        planes = (len(flux), chunk.last - chunk.first, *grid.shape[1:])
        writer.write(chunk, flux.reshape(*planes, 3), gradient.reshape(*planes, 3, 3))
        done += 1
        tell()


def _describe(
    device: Device, grid: Grid, reference_current: Array, title: str, recipe_text: str, saturating: bool
) -> MapInfo:
    """The description of the map that will be made."""
    fixed = device.fixed_sources
    return MapInfo(
        grid=grid,
        coil_names=device.coil_names,
        reference_current=reference_current,
        provenance=Provenance(
            title=title,
            device_name=device.name,
            recipe_text=recipe_text,
            device_text=device.text,
            fingerprint=fingerprint((recipe_text, *device.texts), CODE),
            versions=library_versions(),
            included=dict(device.included),
            created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S +0000"),
        ),
        fixed_sources=fixed,
        # The fields of a map of saturating iron contain the field of its magnets.
        constant_field=device.background is not None or (bool(fixed) and not saturating),
    )


def _reference_current(given: float | None, domain: CurrentDomain | None, count: int) -> Array:
    """The given current. If none is given: 1 A for linear iron. For saturating iron each coil's current in the middle
    of the domain, or, if that is not positive, the largest current at the corners of the domain."""
    each = np.full(count, 1.0 if given is None else given)
    if domain is None:
        return each
    if given is None:
        middle, corners = domain.middle, domain.parametrisation.currents(corner_signals(domain))
        return np.where(middle > 0, middle, np.abs(corners).max(initial=1.0))
    # With lift_and_directions any equal currents are accepted: their direction signals are zero.
    if not isinstance(domain.parametrisation, LiftAndDirections) and not domain.holds(each):
        must_hold, remedy = (
            "must lie within [currents]",
            "choose a current that the map holds for, or leave it out",
        )
        raise RecipeError(AtKey("output.reference_current_A", must_hold, f"{given:g}", remedy))
    return each


def _target(file_name: str, output: PathLike | None) -> Path:
    target = OUTPUT_FOLDER / file_name if output is None else Path(output)
    raise_all(output_problems(str(target), target, ["map"]), RecipeError)
    return target


def _finished(target: Path, info: MapInfo) -> Mapping[str, Any] | None:
    """The report of the map that exists already, if it was made from the same inputs; otherwise None."""
    if not target.is_file():
        return None
    try:
        there = read_info(target).provenance
    except MapFileError:
        return None
    return there.solver_report if there.fingerprint == info.provenance.fingerprint else None
