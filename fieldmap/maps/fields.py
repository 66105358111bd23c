"""The fields of a map, stored in its checkpoint: solutions of linear iron, and trained models of saturating iron.

Results are stored as plain arrays and always read back, so that a resumed run gives the same bits. Of the iron only
the charged faces and their densities are stored, which give its field in air. Without the mesh, a solution that was
read back does not refuse points inside the iron; the geometry check has excluded them already.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from time import monotonic, process_time
from typing import Any, TypeAlias

import numpy as np

from fieldmap.constants import MU0
from fieldmap.currents import CurrentDomain, parametrisation_from_json
from fieldmap.device.model import Background, Coil, Device
from fieldmap.iron import LinearSolution, NonlinearSolver, SolverReport
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.reaction import DipoleAnswers, ReactionFields
from fieldmap.iron.solvers.shared import SharedSolves, windings
from fieldmap.maps.forecast import expect_fields
from fieldmap.maps.training.currents import corner_signals
from fieldmap.maps.training.hysteresis import train_along_paths
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.solved_paths import PathSolver, SolvedPaths
from fieldmap.maps.training.states import SolvedStates
from fieldmap.maps.training.training import train
from fieldmap.parallel import Common, Workers
from fieldmap.progress import Forecast
from fieldmap.records import Record
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.sources.inductance import background_linkage, bare_inductance
from fieldmap.store import Checkpoint, FieldError, Grid, ReducedModel, StoredLinkage
from fieldmap.store.reduced_model import ARRAYS
from fieldmap.store.stated_accuracy import HELD_OUT
from fieldmap.typing import Array, Progress

# Points along each edge of the box. Fields are compared on its surface, where harmonic differences are largest.
PROBES_PER_EDGE = 7
# Keys in a map's report for the time that the map took, s.
SPENT = ("generation_seconds", "generation_processor_seconds")
_FACES = [field.name for field in fields(ChargedFaces)]

REACTION, ANSWERS = "reaction", "answers to sensors"
"""Keys in the checkpoint: the iron's reaction to magnets, and its response to dipoles at the sensors."""

Kept: TypeAlias = tuple[Mapping[str, Array], Mapping[str, Any]]


def kept(checkpoint: Checkpoint, key: str, make: Callable[..., Kept], *arguments: Any) -> Kept:
    """Arrays and plain JSON of a key in the checkpoint, made first by make(*arguments) if the key is missing."""
    if key not in checkpoint:
        checkpoint.put(key, *make(*arguments))
    piece = checkpoint.get(key)
    assert piece is not None
    return piece


def _faces_to(faces: ChargedFaces, charge: Array) -> dict[str, Array]:
    return {f"face_{name}": getattr(faces, name) for name in _FACES} | {"charge": charge}


def _faces_from(arrays: Mapping[str, Array]) -> tuple[ChargedFaces, Array]:
    faces = ChargedFaces(**{name: np.ascontiguousarray(arrays[f"face_{name}"]) for name in _FACES})
    return faces, np.ascontiguousarray(arrays["charge"])


def of_single_turns(device: Device) -> Device:
    """The device with one turn in every coil. Devices that differ only in turns share its solution."""
    return Device.unchecked(**vars(device) | {"coils": single_turns(device.coils)})


def single_turns(coils: tuple[Coil, ...]) -> tuple[Coil, ...]:
    """The coils with one turn each."""
    return tuple(replace(coil, turns=1.0) for coil in coils)  # zuban: ignore[misc]


def to_arrays(solution: LinearSolution, turns: Array) -> Kept:
    """Arrays and plain JSON of a solution of linear iron, scaled from coils of one turn to coils of turns (c,)."""
    state = solution.state
    about = {"has_remanence": solution.has_remanence, "report": asdict(solution.report)}
    if state is None or solution.iron_linkage is None:
        return {}, about
    # Sources without current have a column, but no turns.
    of_sources = np.append(turns, 1.0)[: len(state.density)]
    charge = of_sources[:, None] * state.density
    linkage = turns[:, None] * solution.iron_linkage * of_sources
    return _faces_to(state.faces, charge) | {"iron_linkage": linkage}, about


def reaction_arrays(reaction: ReactionFields | None) -> Kept:
    """Arrays and plain JSON of the iron's reaction; empty for None."""
    if reaction is None:
        return {}, {}
    names = ("repelled", "dipoles", "asymmetry", "error", "width", "change")
    return _faces_to(reaction.faces, reaction.charge), {name: getattr(reaction, name) for name in names}


def answers_arrays(answers: DipoleAnswers | None) -> Kept:
    """Arrays of the iron's response to dipoles at the sensors; empty for None."""
    return ({} if answers is None else _faces_to(answers.faces, answers.charge)), {}


def answers_from(arrays: Mapping[str, Array]) -> DipoleAnswers | None:
    """The inverse of `answers_arrays`."""
    return DipoleAnswers(*_faces_from(arrays)) if arrays else None


def reaction_from(arrays: Mapping[str, Array], about: Mapping[str, Any]) -> ReactionFields | None:
    """The inverse of `reaction_arrays`."""
    return ReactionFields(*_faces_from(arrays), **about) if arrays else None


def from_arrays(device: Device, arrays: Mapping[str, Array], about: Mapping[str, Any]) -> LinearSolution:
    """The inverse of `to_arrays`. Raises KeyError or TypeError if the arrays are from another solver."""
    report, state, linkage = SolverReport.from_dict(about["report"]), None, None
    if arrays:
        faces, density = _faces_from(arrays)
        unknown = np.empty((len(density), 0, 3))
        state = IronState(faces, density, unknown, report.iterations, (report.residual,))
        linkage = arrays["iron_linkage"]
    remanence, more = bool(about["has_remanence"]), (device.sections, device.bounds, device.background)
    return LinearSolution(device.coils, None, state, remanence, report, linkage, *more)


def linkage_of(solution: LinearSolution, shared: SharedSolves) -> StoredLinkage:
    """The flux linkages of the coils in linear iron. The inductance of single turns in air is shared by maps.
    Raises InputError for coils without a self-inductance."""
    coils = solution.coils
    single, turns = single_turns(coils), np.array([coil.turns for coil in coils])
    air = shared.once(("inductance", windings(single)), lambda: bare_inductance(single))
    iron = 0.0 if solution.iron_linkage is None else solution.iron_linkage[:, : len(coils)]
    matrix = turns[:, None] * air * turns + iron
    return StoredLinkage(0.5 * (matrix + matrix.T), solution.flux_linkage(0.0))


def linkage_in_air(device: Device, remanent: Array) -> StoredLinkage:
    """The part of the flux linkages that the model of saturating iron leaves out: coils in air, background, and
    `remanent` (c,) as in `GalerkinModel`. Raises InputError for coils without a self-inductance."""
    of_background = background_linkage(device.coils, device.background)
    return StoredLinkage(bare_inductance(device.coils), remanent / MU0 + of_background)


@dataclass(frozen=True, eq=False, repr=False)
class SaturatingFields(Record):
    """The fields of a map: of the coils in air per ampere, then of the iron at weight 1, then of the background."""

    coils: tuple[Coil, ...]
    faces: ChargedFaces
    charge: Array
    report: SolverReport
    background: Background | None = None

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Flux density (n_fields, n, 3) and gradient (n_fields, n, 3, 3) at points outside iron and windings."""
        own = [unit_flux_density_and_gradient(coil, points) for coil in self.coils]
        iron = self.faces.field_and_gradient(points, self.charge)
        fixed = [] if self.background is None else [self.background.field_and_gradient(points)]
        flux, gradient = (
            np.concatenate([np.array([pair[j] for pair in own]), iron[j], *(pair[j][None] for pair in fixed)])
            for j in (0, 1)
        )
        return flux, gradient


@dataclass(frozen=True, eq=False, repr=False)
class TrainedMap(Record):
    """A trained model, its fields, their largest weights in the domain of the currents, its largest error, and the
    results and the cost of training for the map's report. remanent (c,): as in `GalerkinModel`."""

    model: ReducedModel
    remanent: Array
    fields: SaturatingFields
    largest_weights: Array
    error: FieldError | None
    about: Mapping[str, Any]


def trained_map(device: Device, arrays: Mapping[str, Array], about: Mapping[str, Any]) -> TrainedMap:
    """The inverse of `trained_arrays`."""
    tried = about["states_tried"].values()
    names = "flux_density", "gradient"
    largest = about.get("current_error") or {name: max(errors[name] for errors in tried) for name in names}
    parametrisation = parametrisation_from_json(about["parametrisation"])
    report, background = SolverReport.from_dict(about["report"]), device.background
    return TrainedMap(
        ReducedModel(
            **{name: arrays[name] for name in ARRAYS},  # type: ignore[arg-type]
            parametrisation=parametrisation,
        ),
        arrays["remanent"],
        SaturatingFields(device.coils, *_faces_from(arrays), report, background),
        np.array(about["largest_weights"] + ([] if background is None else [1.0])),
        FieldError(**largest) if tried else None,
        {key: value for key, value in about.items() if key not in ("report", "parametrisation")},
    )


def trained_arrays(
    device: Device,
    domain: CurrentDomain,
    plan: Plan,
    refinement: float,
    reference: Array,
    grid: Grid,
    hysteresis: bool,
    reaction: bool,
    checkpoint: Checkpoint,
    workers: Workers,
    say: Progress,
    forecast: Forecast,
) -> Kept:
    """Solve the states that the checkpoint lacks, and train on all states. hysteresis: the states lie on paths of the
    currents. reaction: also find the iron's reaction to magnets. `say` shows the progress of the assembly, `forecast`
    the progress after it.

    Raises NotConverged if more than half of the states fail, or all that test the model; on paths if any state fails.
    """
    spent, points = Stopwatch(workers), box_surface(grid)
    assembled = False

    def assembling(message: str, share: float) -> None:
        # The solver would also report every state that it solves.
        if not assembled:
            say(message, share)

    # An assembled solver is too large to send: every process assembles its own, at the same time.
    solved: SolvedPaths | SolvedStates
    if hysteresis:
        say("assembling", 0.0)
        along = Common(PathSolver, device, refinement, reference)
        workers.prepare(along)
        path_solver = along.use(PathSolver(device, refinement, reference))
        solved = SolvedPaths(checkpoint, along, workers, plan.tolerance, forecast)
        trained = train_along_paths(path_solver, domain, plan, points, solved, forecast)
        surface = path_solver.solver.surface
    else:
        common = Common(_solver, device, refinement)
        workers.prepare(common)
        solver = common.use(_solver(device, refinement, assembling))
        assembled = True
        expect_fields(forecast, grid, len(solver.surface.areas), len(device.coils) + plan.fields)
        solved = SolvedStates(checkpoint, common, workers)
        trained = train(solver, domain, plan, points, reference, solved, forecast)
        surface = solver.surface
    if device.sensors:
        assembled_iron = path_solver.solver if hysteresis else solver
        checkpoint.put(ANSWERS, *answers_arrays(assembled_iron.answers_to_sensors()))
    if reaction:
        box, corners = (grid.lower, grid.upper), domain.parametrisation.currents(corner_signals(domain))
        strongest = corners[np.linalg.norm(corners, axis=1).argmax()]
        found = (
            path_solver.solver.reaction_in(box) if hysteresis else solver.reaction_in(box, others=[strongest])
        )
        checkpoint.put(REACTION, *reaction_arrays(found))
    spent.add(solved.earlier_seconds, solved.earlier_processor_seconds)
    about = {
        "held_out_within": HELD_OUT * plan.accuracy,
        "parametrisation": trained.model.parametrisation.to_json(),
        "states_solved": solved.count,
        "largest_weights": trained.largest_weights.tolist(),
        **trained.about,
        **spent.read(),
    }
    arrays = trained.model.arrays | {"remanent": trained.remanent}
    return arrays | _faces_to(surface, trained.charge), about


def _solver(device: Device, refinement: float, say: Progress | None = None) -> NonlinearSolver:
    return NonlinearSolver(device, refinement, say, "auto")


def box_surface(grid: Grid) -> Array:
    """Points (n, 3) on the surface of the grid's box."""
    shares = np.linspace(0.0, 1.0, PROBES_PER_EDGE)
    triples = [t for t in itertools.product(shares, repeat=3) if any(share in (0.0, 1.0) for share in t)]
    return np.asarray(grid.lower + np.array(triples) * (grid.upper - grid.lower))


class Stopwatch:
    """Wall-clock and processor seconds since construction, workers included, and those of earlier runs."""

    def __init__(self, workers: Workers, seconds: float = 0.0, processor_seconds: float = 0.0) -> None:
        self._workers = workers
        self._spent = np.array([seconds, processor_seconds]) - self._now()

    def add(self, seconds: float, processor_seconds: float) -> None:
        """Add the seconds of another run."""
        self._spent += [seconds, processor_seconds]

    def read(self) -> dict[str, float]:
        """The seconds so far, named by `SPENT`."""
        return dict(zip(SPENT, (self._spent + self._now()).tolist(), strict=True))

    def _now(self) -> Array:
        return np.array([monotonic(), process_time() + self._workers.processor_seconds])
