"""One variant solved: its field at any currents, whether its iron is linear or saturates, and how far it is from the
truth."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Device
from fieldmap.errors import NotConverged, Problem
from fieldmap.field import BaseField, as_field
from fieldmap.iron import LinearSolution, NonlinearSolution, NonlinearSolver, solve_linear, solve_to_tolerance
from fieldmap.iron.error.estimate import ErrorEstimate, estimate_error, workspace_surface
from fieldmap.studies.study import IronModel
from fieldmap.typing import Array

# Ratio of the mesh sizes of a solution and of the one that it is compared with, and of two refinements.
COARSER = 1.4
MOST_REFINEMENTS = 6


class SolvedField(Protocol):
    """Field and gradient at the currents that it was asked for, at least."""

    @property
    def coil_names(self) -> tuple[str, ...]: ...

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array: ...

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array: ...


class SolvedIron(Protocol):
    """What the quantities of a study are computed from.

    proportional: whether field and force are proportional to the currents.
    """

    @property
    def proportional(self) -> bool: ...

    @property
    def assumptions(self) -> tuple[str, ...]: ...

    @property
    def surface_faces(self) -> int: ...

    def field_at(self, currents: Array) -> SolvedField: ...

    def largest_flux_density(self, currents: Array) -> float: ...

    def error(self, currents: Array) -> ErrorEstimate: ...


class FieldOfIron(BaseField):
    """The field of a solved variant at any currents."""

    def __init__(self, iron: SolvedIron, coil_names: tuple[str, ...]) -> None:
        self._iron, self._names = iron, coil_names

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self._names

    @property
    def proportional(self) -> bool:
        """Whether field and force are proportional to the currents."""
        return self._iron.proportional

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T."""
        return self._iron.field_at(currents).field(points, currents)

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self._iron.field_at(currents).gradient(points, currents)


class LinearIron:
    """A device of constant permeability, solved once for all currents."""

    def __init__(self, device: Device, model: IronModel) -> None:
        self._device, self._model = device, model
        self._estimate: ErrorEstimate | None = None
        if model.accuracy is not None and device.bodies:
            self.solution = solve_to_tolerance(device, model.accuracy, model.mu_r)
        else:
            self.solution = self._solved(model.refinement)

    def _solved(self, refinement: float, form: str = "auto") -> LinearSolution:
        return solve_linear(
            self._device, self._model.mu_r, self._model.tolerance, refinement=refinement, form=form
        )

    @property
    def proportional(self) -> bool:
        """Unless magnets add a field of their own."""
        return not self.solution.has_remanence

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the solution rests on."""
        return self.solution.report.assumptions

    @property
    def surface_faces(self) -> int:
        """Of the mesh."""
        return self.solution.report.surface_faces

    def field_at(self, currents: Array) -> SolvedField:
        """It holds for all currents."""
        return self.solution

    def largest_flux_density(self, currents: Array) -> float:
        """T, of the elements of the iron."""
        state = self.solution.state
        if state is None:
            return float("nan")
        weights = np.append(currents, 1.0) if self.solution.has_remanence else currents
        inside = np.einsum("c,ced->ed", weights, state.flux_density)
        return float(np.linalg.norm(inside, axis=1).max())

    def error(self, currents: Array) -> ErrorEstimate:
        """Of the worst coil: that of the refinement, or by both forms and a coarser mesh."""
        report = self.solution.report
        if report.error is not None:
            return report.error
        if self._estimate is None:
            coarser = self._solved(self._model.refinement / COARSER, report.form)
            other = self._solved(self._model.refinement, "flux") if report.form == "potential" else None
            self._estimate = estimate_error(workspace_surface(self._device), self.solution, coarser, other)
        return self._estimate


class SaturatingIron:
    """A device meshed once, and its states, each kept and begun at the last one."""

    proportional = False

    def __init__(self, device: Device, model: IronModel, refinement: float) -> None:
        self._solver = NonlinearSolver(device, refinement)
        self._tolerance = model.tolerance
        self._states: dict[bytes, NonlinearSolution] = {}
        self._last: NonlinearSolution | None = None

    def state(self, currents: Array) -> NonlinearSolution:
        """The state at currents (n_coils,), A."""
        key = np.asarray(currents, float).tobytes()
        if key not in self._states:
            self._states[key] = self._solver.solve(currents, self._tolerance, start=self._last)
        self._last = self._states[key]
        return self._last

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the states rest on."""
        return self._last.report.assumptions if self._last is not None else ()

    @property
    def surface_faces(self) -> int:
        """Of the mesh."""
        return len(self._solver.surface.areas)

    def field_at(self, currents: Array) -> SolvedField:
        """It holds for these currents only."""
        return as_field(self.state(currents))

    def largest_flux_density(self, currents: Array) -> float:
        """T, of the elements of the iron."""
        largest = self.state(currents).report.largest_flux_density
        return float("nan") if largest is None else largest

    def error(self, currents: Array) -> ErrorEstimate:
        """Of the state at these currents: in the flux form, and on a coarser mesh."""
        return self._solver.estimate_error(self.state(currents), self._tolerance)


def solved_iron(device: Device, model: IronModel, refinement: float) -> SolvedIron:
    """The device solved. refinement: divides the mesh sizes of saturating iron; `accuracy` chooses those of linear."""
    return SaturatingIron(device, model, refinement) if model.saturating else LinearIron(device, model)


def refined_too_often(accuracy: float, errors: list[float]) -> NotConverged:
    """The error for saturating iron whose estimated error does not fall below the accuracy."""
    return NotConverged(
        Problem(
            "iron.accuracy",
            f"the estimated error of B must fall to {accuracy:g} within {MOST_REFINEMENTS} refinements",
            ", ".join(f"{error:.2g}" for error in errors),
            "loosen the accuracy, or give the bodies that matter smaller mesh sizes",
        ),
        residuals=tuple(errors),
    )
