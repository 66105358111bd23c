"""The map of a device whose iron saturates: train a reduced model of the currents, then evaluate its fields."""

import itertools
import sys
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields
from time import monotonic, process_time
from typing import Any

import numpy as np

from fieldmap.currents import CurrentDomain, parametrisation_from_json
from fieldmap.device.model import Background, Coil, Device
from fieldmap.iron import NonlinearSolver, SolverReport
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.maps.forecast import Forecast
from fieldmap.maps.recipe import CurrentPlan
from fieldmap.maps.training.states import SolvedStates
from fieldmap.maps.training.training import Trained, train
from fieldmap.parallel import Common, Workers
from fieldmap.records import Record
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.store import Checkpoint, FieldError, Grid, ReducedModel
from fieldmap.store.reduced_model import ARRAYS
from fieldmap.store.stated_accuracy import HELD_OUT
from fieldmap.typing import Array, Progress

# Nodes along each edge of the box at whose surface the fields are compared: they are harmonic, so largest there.
PROBES_PER_EDGE = 7
# Key of the trained model in the checkpoint.
_TRAINED = "trained model"
_FACES = [field.name for field in fields(ChargedFaces)]
# Names under which a map's report states what it cost.
SPENT = ("generation_seconds", "generation_processor_seconds")


def peak_memory() -> dict[str, int]:
    """The most memory, in bytes, that this process has had so far, as a map's report has it; nothing on Windows."""
    try:
        import resource
    except ImportError:
        return {}
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # In kibibytes but for macOS.
    return {"generation_peak_memory_bytes": most if sys.platform == "darwin" else 1024 * most}


class Stopwatch:
    """Seconds of the clock and of all processors, workers' too, since it was made, and what earlier runs took."""

    def __init__(self, workers: Workers, seconds: float = 0.0, processor_seconds: float = 0.0) -> None:
        self._workers = workers
        self._seconds = seconds - monotonic()
        self._processor_seconds = processor_seconds - self._processors()

    def add(self, seconds: float, processor_seconds: float) -> None:
        """Count what another run took."""
        self._seconds += seconds
        self._processor_seconds += processor_seconds

    def read(self) -> dict[str, float]:
        """The seconds so far, named by `SPENT`."""
        now = (self._seconds + monotonic(), self._processor_seconds + self._processors())
        return dict(zip(SPENT, now, strict=True))

    def _processors(self) -> float:
        return process_time() + self._workers.processor_seconds


@dataclass(frozen=True, eq=False, repr=False)
class SaturatingFields(Record):
    """What the map evaluates: the coils' own fields per ampere, then the iron's at weight 1, then the background's."""

    coils: tuple[Coil, ...]
    faces: ChargedFaces
    charge: Array
    report: SolverReport
    background: Background | None = None

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Flux density (n_fields, n, 3) and gradient (n_fields, n, 3, 3) of every field outside iron and windings."""
        flux, gradient = self.faces.field_and_gradient(points, self.charge)
        own = [unit_flux_density_and_gradient(coil, points) for coil in self.coils]
        fixed = [] if self.background is None else [self.background.field_and_gradient(points)]
        return (
            np.concatenate([np.array([b for b, _ in own]), flux, *(b[None] for b, _ in fixed)]),
            np.concatenate([np.array([g for _, g in own]), gradient, *(g[None] for _, g in fixed)]),
        )


@dataclass(frozen=True, eq=False, repr=False)
class TrainedMap(Record):
    """A trained model, the fields that go with it, their largest weights at the currents of the domain, what
    training found, for the map's record, and what it cost."""

    model: ReducedModel
    fields: SaturatingFields
    largest_weights: Array
    error: FieldError | None
    about: Mapping[str, Any]
    spent: tuple[float, float]


def trained_map(
    device: Device,
    domain: CurrentDomain,
    plan: CurrentPlan,
    reference: Array,
    grid: Grid,
    checkpoint: Checkpoint,
    workers: Workers,
    say: Progress,
    forecast: Forecast,
) -> TrainedMap:
    """Solve the states that are not in the checkpoint yet, and train on all of them. say: told of the assembly;
    forecast: of all that comes after it.

    Raises NotConverged if fewer than half of the states could be solved, or none of those to try the model on.
    """
    if _TRAINED not in checkpoint:
        trained = _train(device, domain, plan, reference, grid, checkpoint, workers, say, forecast)
        checkpoint.put(_TRAINED, *trained)
    # Read back, so that a resumed run gives the same bits.
    kept = checkpoint.get(_TRAINED)
    assert kept is not None
    return _from_arrays(device, *kept)


def _train(
    device: Device,
    domain: CurrentDomain,
    plan: CurrentPlan,
    reference: Array,
    grid: Grid,
    checkpoint: Checkpoint,
    workers: Workers,
    say: Progress,
    forecast: Forecast,
) -> tuple[dict[str, Array], dict[str, Any]]:
    spent = Stopwatch(workers)
    # An assembled solver is large: every process assembles its own, while this one does.
    common = Common(_solver, device, plan.refinement)
    workers.prepare(common)
    assembled = False

    def assembling(message: str, share: float) -> None:
        # The solver goes on to speak of every state that it solves.
        if not assembled:
            say(message, share)

    solver = common.use(_solver(device, plan.refinement, assembling))
    assembled = True
    states = SolvedStates(checkpoint, common, workers)
    trained = train(solver, domain, plan.training, box_surface(grid), reference, states, forecast)
    spent.add(states.earlier_seconds, states.earlier_processor_seconds)
    middle = solver.solve(domain.middle, plan.training.tolerance, trained.snapshots.nearest(domain.middle))
    arrays = dict(trained.model.arrays)
    arrays |= {f"face_{name}": getattr(solver.surface, name) for name in _FACES}
    asked = {"held_out_within": HELD_OUT * plan.training.accuracy}
    about = asked | _about(trained, states, middle.report) | spent.read()
    return arrays | {"charge": trained.charge}, about


def _solver(device: Device, refinement: float, say: Progress | None = None) -> NonlinearSolver:
    return NonlinearSolver(device, refinement, say, "auto")


def _about(trained: Trained, states: SolvedStates, report: SolverReport) -> dict[str, Any]:
    return {
        "report": asdict(report),
        "parametrisation": trained.model.parametrisation.to_json(),
        "states_solved": states.count,
        "states_trained_on": len(trained.model.known_currents),
        "states_trained_on_solved": trained.snapshots.solved,
        "corners_trained_on": trained.extremes.trained_on,
        "extremes": asdict(trained.extremes),
        "error_parts": asdict(trained.parts),
        "states_failed": {str(number): reason for number, reason in states.failed.items()},
        "states_tried": {name: asdict(errors) for name, errors in trained.errors.items()},
        "rounds": [asdict(found) for found in trained.rounds],
        "largest_weights": trained.largest_weights.tolist(),
        "modes": len(trained.model.constant),
        "sample_points": len(trained.model.weights),
        "condensed_from": asdict(trained.condensation),
    }


def _from_arrays(device: Device, arrays: Mapping[str, Array], about: Mapping[str, Any]) -> TrainedMap:
    report = SolverReport.from_dict(about["report"])
    faces = ChargedFaces(**{name: np.ascontiguousarray(arrays[f"face_{name}"]) for name in _FACES})
    charge = np.ascontiguousarray(arrays["charge"])
    largest = np.array(about["largest_weights"] + ([] if device.background is None else [1.0]))
    return TrainedMap(
        ReducedModel(
            **{name: arrays[name] for name in ARRAYS},  # type: ignore[arg-type]
            parametrisation=parametrisation_from_json(about["parametrisation"]),
        ),
        SaturatingFields(device.coils, faces, charge, report, device.background),
        largest,
        _largest_error(about["states_tried"].values()),
        {key: value for key, value in about.items() if key not in ("report", "parametrisation", *SPENT)},
        (about[SPENT[0]], about[SPENT[1]]),
    )


def _largest_error(tried: Collection[Mapping[str, float]]) -> FieldError | None:
    if not tried:
        return None
    return FieldError(*(max(errors[name] for errors in tried) for name in ("flux_density", "gradient")))


def box_surface(grid: Grid) -> Array:
    """Points (n, 3) on the surface of the grid's box."""
    shares = np.linspace(0.0, 1.0, PROBES_PER_EDGE)
    triples = [t for t in itertools.product(shares, repeat=3) if any(share in (0.0, 1.0) for share in t)]
    return np.asarray(grid.lower + np.array(triples) * (grid.upper - grid.lower))
