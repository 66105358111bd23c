"""The solution of one variant of a study: its numbers at every set of currents, and the reasons for missing ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap import records
from fieldmap.core.least_power import FOUND, least_power
from fieldmap.device.model import Device, Payload
from fieldmap.device.reader import device_of
from fieldmap.errors import FieldmapError, Infeasible, NotConverged, Problem
from fieldmap.field import Field, as_field, require_bounds
from fieldmap.inputs.document import Document
from fieldmap.iron import LinearSolution, NonlinearSolver, solve_linear, solve_to_tolerance
from fieldmap.iron.error import ErrorEstimate, estimate_error, workspace_surface
from fieldmap.iron.summary import FILL, body_fluxes, copper_resistance
from fieldmap.levitation import GRAVITY, Equilibrium, find_equilibrium, lift_current
from fieldmap.levitation.balance import upright_force
from fieldmap.levitation.places import grid_points
from fieldmap.lookup.payload import check_payload
from fieldmap.studies.equilibrium_area import equilibrium_area
from fieldmap.studies.study import CurrentSet, Record, StudyIron
from fieldmap.typing import Array

# Ratio of the mesh sizes of a solution and of its comparison, and of successive refinements.
COARSER = 1.4
MOST_REFINEMENTS = 6
COPPER_WINDINGS = (
    f"windings without a stated resistance are of copper at 20 C that fills {FILL:g} of their section"
)
# Heights of `lowest_lift_height` and cells of `controllable_share` in the workspace.
HEIGHTS = 33
GRID = (7, 7, 9)
BOX_GRID = (5, 5, 5)
"""Points of the box for the homogeneity, along x, y and z."""


class SolvedIron:
    """A variant solved on one mesh. field: its field at any currents, solved once or a state at a time."""

    def __init__(self, device: Device, model: StudyIron) -> None:
        self._device, self._model = device, model
        self.field: LinearSolution | NonlinearSolver
        if model.saturating:
            self.field = NonlinearSolver(device, model.refinement, tolerance=model.tolerance)
        elif model.accuracy is not None and device.bodies:
            self.field = solve_to_tolerance(device, model.accuracy, model.mu_r)
        else:
            self.field = self._linear(model.refinement)

    @property
    def surface_faces(self) -> int:
        """Number of faces on the surface of the mesh."""
        if isinstance(self.field, LinearSolution):
            return self.field.report.surface_faces
        return len(self.field.surface.areas)

    def error(self, currents: Array) -> ErrorEstimate:
        """Estimated error. For linear iron, of the worst coil, from the refinement, or from both forms and a coarser
        mesh; for saturating iron, of the state at these currents."""
        if isinstance(self.field, NonlinearSolver):
            return self.field.estimate_error(self.field.at(currents), self._model.tolerance)
        return self._linear_error if self.field.report.error is None else self.field.report.error

    @cached_property
    def _linear_error(self) -> ErrorEstimate:
        assert isinstance(self.field, LinearSolution)
        form = self.field.report.form
        coarser = self._linear(self._model.refinement / COARSER, form)
        other = self._linear(self._model.refinement, "flux") if form == "potential" else None
        return estimate_error(workspace_surface(self._device), self.field, coarser, other)

    def _linear(self, refinement: float, form: str = "auto") -> LinearSolution:
        return solve_linear(
            self._device, self._model.mu_r, self._model.tolerance, refinement=refinement, form=form
        )


Numbers = dict[str, Any]

# Relative step of central differences in the currents.
_STEP = 0.01


@dataclass(frozen=True, eq=False, repr=False)
class Task(records.Record):
    """All that is needed to solve one variant, as plain data that can be sent to another process."""

    document: Document
    current_sets: tuple[CurrentSet, ...]
    iron: StudyIron
    record: Record


@dataclass(frozen=True, repr=False)
class Row(records.Record):
    """One variant at one set of currents: numbers by the name of their quantity, and reasons for missing ones."""

    numbers: Numbers
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class VariantResult(records.Record):
    """rows: one for each set of currents. assumptions: of the numbers."""

    rows: tuple[Row, ...]
    assumptions: tuple[str, ...] = ()


def solve_variant(task: Task) -> VariantResult:
    """Solve one variant and compute its numbers. A failure is a reason in the result, never an error."""
    try:
        device = device_of(task.document)
        return _accurate(device, task)
    except Exception as error:  # no failure stops the other variants
        why = (reason("variant", error),)
        return VariantResult(tuple(Row({}, why) for _ in task.current_sets))


def reason(what: str, error: Exception) -> str:
    """An error in one line, after the name of the step that failed."""
    if isinstance(error, FieldmapError) and error.problems:
        return f"{what}: {type(error).__name__}: " + " | ".join(str(problem) for problem in error.problems)
    return f"{what}: {type(error).__name__}: {error}"


def _accurate(device: Device, task: Task) -> VariantResult:
    """The variant, with its mesh refined until the estimated errors are within the required accuracy."""
    model, errors = task.iron, []
    for _ in range(MOST_REFINEMENTS):
        iron = SolvedIron(device, model)
        rows = tuple(_row(device, iron, entry, task.record) for entry in task.current_sets)
        # The variables of the study say what differs.
        assumed = tuple(text for text in iron.field.assumptions if text != device.changed)
        if model.accuracy is None or not model.saturating:
            return VariantResult(rows, assumed)
        found = [row.numbers["error_flux_density"] for row in rows if "error_flux_density" in row.numbers]
        if not found or max(found) <= model.accuracy:
            return VariantResult(rows, assumed)
        errors.append(max(found))
        model = replace(model, refinement=COARSER * model.refinement)
    must_hold = (
        f"the estimated error of B must fall to {model.accuracy:g} within {MOST_REFINEMENTS} refinements"
    )
    remedy = "loosen the accuracy, or give the bodies that matter smaller mesh sizes"
    received = ", ".join(f"{error:.2g}" for error in errors)
    raise NotConverged(Problem("iron.accuracy", must_hold, received, remedy), residuals=tuple(errors))


def _row(device: Device, iron: SolvedIron, entry: CurrentSet, record: Record) -> Row:
    try:
        point = OperatingPoint(device, iron, entry, record)
    except FieldmapError as error:
        return Row({}, (reason("currents", error),))
    numbers, problems = numbers_at(point)
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in numbers.items()
    }
    return Row(plain, problems)


def numbers_at(point: OperatingPoint) -> tuple[Numbers, tuple[str, ...]]:
    """The recorded numbers of a solved variant at its currents, and reasons for missing ones."""
    numbers: Numbers = {}
    problems = []
    for group in point.record.groups:
        try:
            numbers |= _GROUPS[group](point)
        except FieldmapError as error:
            problems.append(reason(group, error))
    return numbers, tuple(dict.fromkeys(problems))


class OperatingPoint:
    """A solved variant at one set of currents: common current (A), currents (n_coils,)."""

    def __init__(self, device: Device, iron: SolvedIron, entry: CurrentSet, record: Record) -> None:
        self.device, self.iron, self.entry, self.record = device, iron, entry, record
        if entry.common is None:
            place: Any = entry.carried_at
            first = record.current_limit or 1.0
            self.common = lift_current(self.field, self.payload, place, entry.shares, first).current
        else:
            self.common = entry.common
        self.currents = self.common * entry.shares

    @property
    def payload(self) -> Payload:
        """The payload with its magnets as point dipoles, as in derivatives of designs. The checks of studies and
        designs ensure that there is one."""
        assert self.device.payload is not None
        return replace(self.device.payload, volume_level=1)

    @property
    def current_limit(self) -> float:
        """Limit of the current in every coil, A. The same checks ensure that there is one."""
        assert self.record.current_limit is not None
        return self.record.current_limit

    @property
    def box(self) -> tuple[Array, Array]:
        """Corners of the box around the workspace, m."""
        assert self.device.bounds is not None
        return self.device.bounds

    @property
    def field(self) -> Field:
        """The field inside the workspace."""
        return as_field(self.iron.field, self.box)

    def equilibrium(self) -> Equilibrium:
        """The equilibrium at these currents, searched for once. If there is none, each call raises the same error."""
        if isinstance(self._sought, FieldmapError):
            raise self._sought
        return self._sought

    @cached_property
    def _sought(self) -> Equilibrium | FieldmapError:
        try:
            return find_equilibrium(self.field, self.currents, self.payload, self.entry.carried_at)
        except FieldmapError as error:
            return error


def _currents(point: OperatingPoint) -> Numbers:
    return {"common_current": point.common, "current": point.currents}


def _field(point: OperatingPoint) -> Numbers:
    field, at = point.iron.field, point.record.points
    return {"flux_density": field.field(at, point.currents), "gradient": field.gradient(at, point.currents)}


def _force_per_ampere(point: OperatingPoint) -> Numbers:
    """(F(i + h) - F(i - h)) / 2h of the payload, which does not turn; exact where the force is
    proportional to the current."""
    forces = [
        upright_force(point.iron.field, factor * point.currents, point.payload, point.record.points)
        for factor in (1.0 + _STEP, 1.0 - _STEP)
    ]
    return {"force_per_ampere": (forces[0] - forces[1]) / (2.0 * _STEP * point.common)}


def _equilibrium(point: OperatingPoint) -> Numbers:
    found = point.equilibrium()
    numbers = {f"equilibrium_{axis}": float(found.position[k]) for k, axis in enumerate("xyz")}
    return numbers | {f"stiffness_{axis}": float(found.stiffness[k, k]) for k, axis in enumerate("xyz")}


def _area(point: OperatingPoint) -> Numbers:
    found, field = point.equilibrium(), point.field
    return {"equilibrium_area": equilibrium_area(field, found, point.payload, point.record.force_share)}


def _reach(point: OperatingPoint) -> Numbers:
    shares, limit = point.entry.shares, point.current_limit
    currents = limit / np.abs(shares).max() * shares
    over = 0.5 * (point.box[0] + point.box[1]) if point.entry.carried_at is None else point.entry.carried_at
    return {"reach_height": lowest_lift_height(point.field, currents, point.payload, over)}


def _reachable_share(point: OperatingPoint) -> Numbers:
    field, limit = point.iron.field, point.current_limit
    assert isinstance(field, LinearSolution)  # the checks of studies and designs
    return {"reachable_share": controllable_share(field, point.payload, *point.box, limit)}


def _iron(point: OperatingPoint) -> Numbers:
    state = point.iron.field.at(point.currents)
    largest = {one.body: one.largest_magnitude for one in body_fluxes(state)}
    of_bodies = np.array([largest[body.name] for body in point.device.bodies])
    return {"largest_flux_density": state.largest_flux_density, "body_flux_density": of_bodies}


def _power(point: OperatingPoint) -> Numbers:
    return {"power": float(winding_resistances(point.device) @ point.currents**2)}


def winding_resistances(device: Device) -> Array:
    """Resistances (c,), ohm: as the device states them, otherwise of copper at 20 C (`fieldmap.iron.summary`)."""
    return np.array(
        [copper_resistance(coil) if coil.resistance is None else coil.resistance for coil in device.coils]
    )


def box_grid(corners: tuple[Array, Array]) -> Array:
    """Points (n, 3) of a box, its corners among them."""
    return grid_points(*corners, BOX_GRID)


def inhomogeneities(field: Array) -> tuple[float, float]:
    """Root mean square and largest |B - mean B| over |mean B| of flux densities (n, 3).

    >>> inhomogeneities(np.array([[0.0, 0.0, 0.75], [0.0, 0.0, 1.25]]))
    (0.25, 0.25)
    """
    mean = field.mean(axis=0)
    apart = np.linalg.norm(field - mean, axis=1) / np.linalg.norm(mean)
    return float(np.sqrt(np.mean(apart**2))), float(apart.max())


def _homogeneity(point: OperatingPoint) -> Numbers:
    assert point.record.box is not None  # the study's checks
    rms, largest = inhomogeneities(point.iron.field.field(box_grid(point.record.box), point.currents))
    return {"inhomogeneity": rms, "largest_inhomogeneity": largest}


def _inductance(point: OperatingPoint) -> Numbers:
    field = point.iron.field
    if isinstance(field, LinearSolution):
        return {"inductance": field.inductance()}
    return {"inductance": field.differential_inductance(field.at(point.currents))}


def _error(point: OperatingPoint) -> Numbers:
    error = point.iron.error(point.currents)
    return {
        "error_flux_density": error.flux_density,
        "error_gradient": error.gradient,
        "surface_faces": point.iron.surface_faces,
    }


_GROUPS: dict[str, Callable[[OperatingPoint], Numbers]] = {
    "currents": _currents,
    "field": _field,
    "force_per_ampere": _force_per_ampere,
    "equilibrium": _equilibrium,
    "equilibrium_area": _area,
    "reach": _reach,
    "reachable_share": _reachable_share,
    "power": _power,
    "homogeneity": _homogeneity,
    "inductance": _inductance,
    "iron": _iron,
    "error": _error,
}


def lowest_lift_height(field: Field, currents: Array, payload: Payload, over: Array) -> float:
    """Lowest height z (m) in the box on the vertical through (x, y) at which these currents, or their negatives, lift
    the weight.

    The payload does not turn. The height is the box's lower end if they lift it there. Raises Infeasible if they lift
    it nowhere on the vertical.
    """
    lower, upper = (float(corner[2]) for corner in require_bounds(field))

    def lift(z: Array, way: float) -> Array:
        points = np.column_stack([np.broadcast_to(over[:2], (len(z), 2)), z])
        return upright_force(field, way * currents, payload, points)[:, 2]

    weight = payload.mass * GRAVITY
    heights = np.linspace(lower, upper, HEIGHTS)
    way, lifts = 1.0, lift(heights, 1.0)
    if not payload.soft and lifts.max() < weight:
        other = lift(heights, -1.0)
        way, lifts = (-1.0, other) if other.max() > lifts.max() else (way, lifts)
    enough = lifts >= weight
    if not enough.any():
        share, limit = lifts.max() / weight, np.abs(currents).max()
        must_hold = "the currents at the limit must lift the payload somewhere in the workspace"
        received = f"{share:.3g} of the weight at most, with {limit:g} A"
        remedy = "raise the limit, lighten the payload, or let the workspace begin nearer to the iron"
        raise Infeasible.of("reach", must_hold, received, remedy)
    first = int(enough.argmax())
    if first == 0:
        return lower
    return float(
        brentq(lambda z: lift(np.array([z]), way)[0] - weight, heights[first - 1], heights[first], xtol=1e-7)
    )


def controllable_share(
    solution: LinearSolution, payload: Payload, lower: Array, upper: Array, limit: float
) -> float:
    """Share of a box in which some currents within +-limit hold the payload: no horizontal force, lift = weight.

    Evaluated at the centres of 7 x 7 x 9 cells, for a vertical moment and linear iron, in which coils superpose. Raises
    InputError for a payload of pieces.
    """
    check_payload(payload, "reachable_share")
    half = 0.5 * (upper - lower) / GRID
    points = grid_points(lower + half, upper - half, GRID)
    moment = payload.moment_vector[2]
    per_ampere = moment * solution.unit_fields(points)[1][:, :, 2, :]
    constant = moment * solution.constant_fields(points)[1][:, 2, :]
    held = [
        _holds(per_ampere[:, k].T, constant[k], payload.mass * GRAVITY, limit) for k in range(len(points))
    ]
    return float(np.mean(held))


def _holds(matrix: Array, constant: Array, weight: float, limit: float) -> bool:
    """Whether currents within the limit balance the weight. matrix (3, n_coils): force, N/A; constant (3,): other
    force, N."""
    coils = matrix.shape[1]
    low, high, weights = np.full(coils, -limit), np.full(coils, limit), np.ones(coils)
    wanted, rows = np.array([0.0, 0.0, weight]) - constant, np.ascontiguousarray(matrix)
    currents, active = np.empty(coils), np.empty(coils, np.int64)
    return bool(least_power(rows, wanted, low, high, weights, currents, active) == FOUND)
