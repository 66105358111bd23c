"""Saturating iron: a device meshed once, and its states at given currents.

States that follow from solved ones by the symmetry of the iron need no solve. Others follow by Newton's method, and by
continuation in the sources where it fails: a state at a share of the currents (and of the magnets' remanence) starts
the next. Its potential, scaled up in proportion, is a better start than zero. The steps are halved where Newton fails
and doubled where it succeeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.field import Bounds, Currents, FieldOfStates, coil_currents
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.nodal_elements import CoilField, NodalElements
from fieldmap.iron.elements.potential_form import (
    Magnetisation,
    Magnetised,
    PotentialForm,
    PotentialState,
    SolvedPotential,
    iron_differential_inductance,
    linkage_and_coenergy,
)
from fieldmap.iron.elements.state import PotentialField
from fieldmap.iron.error import ErrorEstimate, estimate_error, workspace_surface
from fieldmap.iron.geometry.checks import geometry_notes
from fieldmap.iron.materials import material_assumptions
from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.mesh.mesh import checked_points, refuse_inside
from fieldmap.iron.reaction import DipoleAnswers, ReactionFields, answers_to_sensors, reaction_fields
from fieldmap.iron.report import Progress, SolverReport, Stages, report_of
from fieldmap.iron.sensitivity.adjoint import IronProblem, Origin
from fieldmap.iron.solution import NonlinearSolution
from fieldmap.iron.solvers.linear import check_arguments, images_of
from fieldmap.iron.solvers.meshed_device import MeshedDevice
from fieldmap.records import Record
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.sources.inductance import bare_inductance
from fieldmap.typing import Array, Index, PathLike
from fieldmap.usual_values import warn_if_unusual

_FIRST_STEP, _SMALLEST_STEP = 0.5, 1 / 64
# Least tolerance of the states on the way: they only start the next state.
_TOLERANCE_ON_THE_WAY = 1e-4


def solve_with_continuation(
    form: PotentialForm, material: Magnetisation, field: CoilField, tolerance: float, start: Array | None
) -> tuple[SolvedPotential, tuple[float, ...]]:
    """The potential in the coils' field, and the shares of the field that were solved on the way to it; no shares if
    Newton converged without them.

    Tries Newton from `start` (n, 1), then from zero, then in steps of field and remanence. Raises NotConverged with all
    residuals once none of these has succeeded.
    """
    residuals: list[float] = []
    begins: tuple[Array | None, ...] = (None,) if start is None else (start, None)
    for begin in begins:
        try:
            return form.solve_potential(material, field, tolerance, begin), ()
        except NotConverged as error:
            residuals += error.residuals
    reached, step = 0.0, _FIRST_STEP
    potential: Array | None = None
    shares: list[float] = []
    while step >= _SMALLEST_STEP:
        share = min(1.0, reached + step)
        part = replace(material, remanence=share * material.remanence)
        begin = None if potential is None else potential * (share / reached)
        wanted = tolerance if share == 1.0 else max(tolerance, _TOLERANCE_ON_THE_WAY)
        try:
            found = form.solve_potential(part, field.combined(np.array([[share]])), wanted, begin)
        except NotConverged as error:
            residuals += error.residuals
            step = 0.5 * step
            continue
        shares.append(share)
        if share == 1.0:
            return found, tuple(shares)
        reached, step, potential = share, 2 * step, found.potential
    where = "iron solver, Newton and continuation in the currents"
    must_hold = f"the residual must fall to {tolerance:g}"
    last = f"last residual {residuals[-1]:.2e} after {len(residuals)} steps in all"
    received = f"no state beyond {100 * reached:.3g} % of the currents; {last}"
    remedy = (
        "loosen the tolerance, smooth the B-H table where its slope jumps, or look for slivers in the mesh"
    )
    raise NotConverged(Problem(where, must_hold, received, remedy), residuals=tuple(residuals))


@dataclass(frozen=True, eq=False, repr=False)
class StateImage(Record):
    """The image of a state under one operation of the mesh: currents and nodal potential.

    The field strength is an axial vector, H'(M x) = det(M) M H(x), so the potential is multiplied by det(M) and moved
    with the nodes. Where there are no magnets, reversing all currents reverses the potential.
    """

    coils: Index
    coil_signs: Array
    nodes: Index
    potential_sign: float

    def currents(self, currents: Array) -> Array:
        """Currents (..., c) of the image of a state of currents (..., c)."""
        out = np.empty_like(currents)
        out[..., self.coils] = self.coil_signs * currents
        return out

    def potential(self, potential: Array) -> Array:
        """Nodal potential (n, ...) of the image of a state of potential (n, ...)."""
        out = np.empty_like(potential)
        out[self.nodes] = self.potential_sign * potential
        return out


def state_images(
    symmetry: MeshSymmetry | None, elements: NodalElements, magnets: bool
) -> tuple[StateImage, ...]:
    """The images under every operation that maps coils onto coils and magnets onto magnets.

    Without magnets each operation gives two images, one with all currents reversed; the identity gives none, or the
    reversal alone.
    """
    if symmetry is None:
        return ()
    images = []
    for k, operation in enumerate(symmetry.group.operations):
        if operation.coils is None or (magnets and not operation.keeps_magnets):
            continue
        nodes = elements.node_images(symmetry.node_images[k])
        senses = (1.0,) if magnets else (1.0, -1.0)
        coils, signs = np.array(operation.coils), np.array(operation.coil_signs, float)
        images += [
            StateImage(coils, sense * signs, nodes, sense * operation.handedness)
            for sense in senses
            if k or sense < 0
        ]
    return tuple(images)


# Newton stops when its residual, in the energy norm, is this fraction of the requested tolerance.
_RESIDUAL_PER_TOLERANCE = 1e-3
# The same fraction in the flux form: the difference between the forms needs two digits only.
_RESIDUAL_OF_COMPLEMENT = 1e-2
# Tolerance of the linear solve for derivatives by the currents.
_TOLERANCE_OF_SLOPES = 1e-8
# Mesh sizes of the state for comparison, over the mesh sizes of the state whose error is estimated.
_COARSER = 1.4


class NonlinearSolver(MeshedDevice, FieldOfStates):
    """A device meshed and assembled once: a field that solves a state for each new set of currents.

    `at(currents)` is the state at these currents; it is solved once and kept. `field` and its derivatives, called
    with currents, use this state.

    Parameters
    ----------
    device
        The machine, its file, or the name of a shipped one.
    refinement
        Divides the mesh sizes of the device file.
    progress
        progress(message, fraction) is called between steps.
    symmetry
        "auto" uses the mirror planes of the iron, "none" does not look for them.
    tolerance
        Tolerance of the states that `at` solves.

    Raises
    ------
    GeometryError, InputError
        As `solve`.

    Examples
    --------
    >>> import fieldmap as fm
    >>> solver = fm.iron.NonlinearSolver(fm.read_device("loop_and_sphere"))
    >>> print(f"{1e3 * solver.field([0.0, 0.0, -0.014], currents=[1.0])[2]:.2f} mT")
    1.01 mT
    """

    def __init__(
        self,
        device: Device | PathLike,
        refinement: float = 1.0,
        progress: Progress | None = None,
        symmetry: str = "auto",
        tolerance: float = 1e-3,
    ) -> None:
        super().__init__(read_device(device), refinement, progress, symmetry)
        self.tolerance = tolerance
        self._states: dict[bytes, NonlinearSolution] = {}
        self._last: NonlinearSolution | None = None
        self._progress, self._refinement, self._symmetry = progress, refinement, symmetry
        self._origin = Origin(self.device, linear=False)
        self._problem = IronProblem(self._form, self._unit)
        self._origin.hold(self._problem)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return self.device.coil_names

    @property
    def bounds(self) -> Bounds | None:
        """The box around the workspace."""
        return self.device.bounds

    @cached_property
    def assumptions(self) -> tuple[str, ...]:
        """The assumptions of every state, in words."""
        return material_assumptions(self.device) + geometry_notes(self.device)

    @property
    def states(self) -> tuple[NonlinearSolution, ...]:
        """The states that `at` has solved, in the order in which it did."""
        return tuple(self._states.values())

    def is_solved(self, currents: Currents) -> bool:
        """Whether `at` has solved the state at these currents already.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        bool
            True if it has.
        """
        return coil_currents(currents, self.coil_names).tobytes() in self._states

    def at(self, currents: Currents) -> NonlinearSolution:
        """The state at these currents: the one solved before for exactly these, or a new one.

        The solve of a new state starts from the state that was asked for last.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        NonlinearSolution
            The state.

        Raises
        ------
        InputError
            For currents that do not fit the coils.
        NotConverged
            As for `solve`.
        """
        values = coil_currents(currents, self.coil_names)
        warn_if_unusual("currents", values, "A")
        key = values.tobytes()
        if key not in self._states:
            self._states[key] = self.solve(values, self.tolerance, start=self._last)
        self._last = self._states[key]
        return self._last

    def by_currents(self, points: ArrayLike, currents: Currents) -> tuple[Array, Array, Array, Array]:
        """Flux density and gradient of a state, and their derivatives by the currents, exact for the discrete
        equations.

        The derivatives take one linear solve for all coils, with the tangent of the state. A state that `at` has not
        solved is solved here, starting from the one asked for last. It is not kept for `at`, because a search goes
        through thousands.

        Parameters
        ----------
        points
            Points (n, 3) or (3,), m, in the air.
        currents
            Currents (c,), A.

        Returns
        -------
        tuple[Array, Array, Array, Array]
            B (n, 3), T; G (n, 3, 3), T/m; dB/dI (n, c, 3), T/A; dG/dI (n, c, 3, 3), T/(m A). Without n for
            one point.

        Raises
        ------
        InputError, NotConverged
        """
        values = coil_currents(currents, self.coil_names)
        warn_if_unusual("currents", values, "A")
        where, single = checked_points(points)
        where = self.surface.off_surface(where)
        refuse_inside(self._iron.mesh, where)
        if self._last is None or not np.array_equal(self._last.currents, values):
            known = self._states.get(values.tobytes())
            self._last = known or self.solve(values, self.tolerance, start=self._last)
        state = self._last.state
        change = self.sensitivities(values, state.potential[:, 0], np.eye(len(values)), _TOLERANCE_OF_SLOPES)
        density = np.concatenate([state.iron.density, self.charge_density(change)])
        flux, slope = self.surface.field_and_gradient(where, density)
        values = np.append(values, 1.0)
        parts = [unit_flux_density_and_gradient(coil, where) for coil in self.device.coils]
        if self.device.background is not None:
            parts.append(self.device.background.field_and_gradient(where))
        for k, part in enumerate(parts):
            for total, unit in zip((flux, slope), part, strict=True):
                total[0] += values[k] * unit
                if k < len(self.device.coils):
                    total[1 + k] += unit
        found = flux[0], slope[0], np.moveaxis(flux[1:], 0, 1), np.moveaxis(slope[1:], 0, 1)
        return (found[0][0], found[1][0], found[2][0], found[3][0]) if single else found

    def solve(
        self, currents: Currents, tolerance: float = 1e-3, start: NonlinearSolution | Array | None = None
    ) -> NonlinearSolution:
        """A new state, not kept for `at`.

        Where Newton's method fails, the state is approached in steps of the currents; `report.continuation` names
        them.

        Parameters
        ----------
        currents
            Currents (c,), A.
        tolerance
            Bounds the algebraic error.
        start
            A neighbouring state of this solver, or its nodal potential (n,), from which Newton's method
            begins; from zero if None.

        Returns
        -------
        NonlinearSolution
            The state.

        Raises
        ------
        InputError
            For bad arguments.
        NotConverged
            With the residual history, once the steps have failed too.
        """
        values = np.array(coil_currents(currents, self.coil_names))
        check_arguments("solve", tolerance)
        stages = Stages(self._progress)
        stages.next("Newton iteration", 0.6)
        begin = start.state.potential if isinstance(start, NonlinearSolution) else start
        found, shares = self._solve_potential(values, tolerance, begin)
        field = self.coil_field(values)
        state = self._form.state(found.potential, field, self._material, found.residuals)
        stages.done()
        seconds = stages.seconds if start is not None else self._seconds | stages.seconds
        report = self._report(state, seconds, shares)
        device = self.device
        about = (device.coils, values, self._iron.mesh, state.iron, np.ones(1), report, device.sections)
        iron = (state, *self._linkage_and_coenergy(field, state.potential))
        around: dict[str, Any] = {"bounds": device.bounds, "background": device.background}
        return NonlinearSolution(*about, *iron, **around, origin=self._origin)

    def solve_potential(
        self, currents: Array, tolerance: float = 1e-3, start: Array | None = None
    ) -> tuple[Array, Array]:
        """As `solve`, for the potential alone, without charges, flux densities, linkages and the report.

        Parameters
        ----------
        currents, tolerance
            As for `solve`.
        start
            Nodal potential (n,) from which Newton's method begins; from zero if None.

        Returns
        -------
        tuple[Array, Array]
            The nodal potential (n,), and the result of `air` for it.

        Raises
        ------
        NotConverged
            With the residual history, once the steps have failed too.
        """
        found = self._solve_potential(currents, tolerance, start)[0]
        return np.ascontiguousarray(found.potential[:, 0]), np.ascontiguousarray(found.air[:, 0])

    def _solve_potential(
        self, currents: Array, tolerance: float, start: Array | None
    ) -> tuple[SolvedPotential, tuple[float, ...]]:
        begin = None if start is None else start.reshape(-1, 1)
        residual = tolerance * _RESIDUAL_PER_TOLERANCE
        field = self.coil_field(currents)
        return solve_with_continuation(self._form, self._material, field, residual, begin)

    @property
    def unknowns(self) -> int:
        """Number of nodes."""
        return self._form.elements.count

    @cached_property
    def images(self) -> tuple[StateImage, ...]:
        """Operations that turn a state of this solver into others without a solve, exact up to rounding. They follow
        from the symmetry of the mesh; with symmetry "none" the mesh has none."""
        magnets = bool(self._material.remanence.any()) or self.device.background is not None
        return state_images(self._iron.mesh.symmetry, self._form.elements, magnets)

    def tangent(self, currents: Array, potential: Array) -> csr_matrix:
        """The iron's tangent stiffness at a state, without the air.

        Parameters
        ----------
        currents
            Currents (c,), A.
        potential
            Nodal potential (n,).

        Returns
        -------
        csr_matrix
            Matrix (n, n).
        """
        return self._form.tangent(potential, self.coil_field(currents), self._material)

    def sensitivities(
        self, currents: Array, potential: Array, directions: Array, tolerance: float = 1e-3
    ) -> Array:
        """Derivatives of a state's nodal potential by the currents, from one linear solve with the tangent of the
        state.

        Parameters
        ----------
        currents
            Currents (c,), A.
        potential
            Nodal potential (n,) of the state.
        directions
            Directions of the currents (c, d).
        tolerance
            Tolerance of the linear solve.

        Returns
        -------
        Array
            Derivatives (n, d).

        Raises
        ------
        NotConverged
            If the linear solve does not converge.
        """
        change = self._unit.combined(directions.T)
        field = self.coil_field(currents)
        return self._form.sensitivities(potential, field, self._material, change, tolerance)

    def corrections(self, currents: Array, potential: Array, air: Array, tolerance: float = 0.03) -> Array:
        """Approximate differences between the states at given currents and nodal potentials.

        A difference is approximated by one step of Newton's method. All steps use the tangent of unsaturated
        iron, so that the corrections cost a tenth of a solve.

        Parameters
        ----------
        currents
            Currents (s, c), A.
        potential
            Nodal potentials (n, s).
        air
            The result of `air` for the potentials.
        tolerance
            Tolerance of the linear solve.

        Returns
        -------
        Array
            Corrections (n, s).

        Raises
        ------
        NotConverged
            If the linear solve does not converge.
        """
        fields = [self.coil_field(values) for values in currents]
        return self._form.corrections(self._material, fields, potential, air, tolerance)

    def energy_operator(self, currents: Array, potential: Array) -> Callable[[Array], Array]:
        """The tangent at a state, iron and air.

        Parameters
        ----------
        currents
            Currents (c,), A.
        potential
            Nodal potential (n,).

        Returns
        -------
        Callable[[Array], Array]
            A function of nodal potentials (n, k): symmetric and positive.
        """
        return self._energy_operator(currents, potential, self._material)

    def reaction_in(
        self, box: Bounds, share: float = 2e-3, others: Sequence[Array] = (), currents: Array | None = None
    ) -> ReactionFields | None:
        """The reaction of the iron in a state to magnets in a box, to first order in their moments.

        Parameters
        ----------
        box
            Lower and upper corner (3,) of the workspace, m; it holds no iron.
        share
            Wanted error: see `fieldmap.iron.reaction.reaction_fields`.
        others
            Currents (c,), A, at which the change of the reaction is measured.
        currents
            Currents (c,) of the state, A; all coils off unless given.

        Returns
        -------
        ReactionFields | None
            The fields of the reaction; None for iron as permeable as air.

        Raises
        ------
        NotConverged
            If a state cannot be solved.
        """

        rest = np.zeros(len(self.coil_names)) if currents is None else np.asarray(currents, float)
        # With currents or magnets the state need not have the symmetry of the iron.
        alone = not rest.any() and not self._material.remanence.any() and self.device.background is None
        images = images_of(self._iron) if alone else []
        elsewhere = map(self._magnetised_about, others)
        return reaction_fields(self._magnetised_about(rest), self.surface, box, share, elsewhere, images)

    def answers_to_sensors(self) -> DipoleAnswers | None:
        """The answers of the iron, linearised about the state without currents, to dipoles in the places of the
        device's sensors: `fieldmap.iron.reaction.answers_to_sensors`."""
        if not self.device.sensors:
            return None
        about = self._magnetised_about(np.zeros(len(self.coil_names)))
        return answers_to_sensors(about, self.surface, self.device.sensors)

    def _magnetised_about(self, currents: Array) -> Magnetised:
        return self.magnetised_at(currents, self.at(currents).state.potential[:, 0])

    def differential_inductance(self, state: NonlinearSolution, tolerance: float = 1e-8) -> Array:
        """Derivatives of the flux linkages by the currents. Where the iron saturates they are less than linkage per
        current.

        Parameters
        ----------
        state
            A state of this solver.
        tolerance
            Tolerance of the linear solve.

        Returns
        -------
        Array
            Inductances (c, c), H; symmetric.

        Raises
        ------
        InputError
            For a state of another solver.
        NotConverged
        """
        inside = state.state.iron.inside
        if not isinstance(inside, PotentialField) or inside.elements is not self._form.elements:
            where, remedy = "differential_inductance, state", "pass a result of solve of this solver"
            raise InputError.of(where, "must be a state of this solver", "another", remedy)
        return self._air_inductance + self.iron_inductance(state.currents, inside.potential[:, 0], tolerance)

    def iron_inductance(self, currents: Array, potential: Array, tolerance: float = 1e-8) -> Array:
        """The iron's part of `differential_inductance`.

        Parameters
        ----------
        currents
            Currents (c,), A.
        potential
            Nodal potential (n,) of the state.
        tolerance
            Tolerance of the linear solve.

        Returns
        -------
        Array
            Inductances (c, c), H.

        Raises
        ------
        NotConverged
        """
        about = potential, self.coil_field(currents), self._unit, tolerance
        return iron_differential_inductance(self._form, self._material, *about)

    def iron_linkage(self, currents: Array, potential: Array) -> Array:
        """The iron's part of the flux linkages of a state.

        Parameters
        ----------
        currents
            Currents (c,), A.
        potential
            Nodal potential (n,) of the state.

        Returns
        -------
        Array
            Flux linkages (c,), Wb.
        """
        return self._linkage_and_coenergy(self.coil_field(currents), potential)[0]

    def _linkage_and_coenergy(self, field: CoilField, potential: Array) -> tuple[Array, float]:
        elements, material = self._form.elements, self._material
        strength = elements.strength_at_points(potential.reshape(-1, 1), field, material)
        coils, unit = (elements.coil_field_at_points(one) for one in (field, self._unit))
        linkage, coenergy = linkage_and_coenergy(elements.volume, material, strength, coils, unit)
        return linkage[:, 0], float(coenergy[0])

    @cached_property
    def _air_inductance(self) -> Array:
        return bare_inductance(self.device.coils)

    def estimate_error(self, solution: NonlinearSolution, tolerance: float = 1e-3) -> ErrorEstimate:
        """Estimate the error of a state in the workspace (`fieldmap.iron.error`).

        The state is solved again in the flux form, from the potential found, and on a mesh 1.4 times coarser. The
        solver keeps that form and that mesh for further states.

        Parameters
        ----------
        solution
            A state of this solver.
        tolerance
            Bounds the algebraic error of these two solutions.

        Returns
        -------
        ErrorEstimate
            The estimate, relative to the largest field in the workspace.

        Raises
        ------
        InputError
            If the device has no workspace.
        NotConverged
            As `solve`.
        """
        points = workspace_surface(self.device)
        stages, field = Stages(self._progress), self.coil_field(solution.currents)
        stages.next("flux form", 0.3)
        residual = tolerance * _RESIDUAL_OF_COMPLEMENT
        elements, material = self._complement.elements, self._material
        values = elements.nodal.coil_field_at_points(field)
        try:
            start = elements.from_nodal(solution.state.potential)
            complement = self._complement.solve(material, values, residual, start).iron
        except NotConverged:
            complement = self._complement.solve(material, values, residual).iron
        stages.next("coarser mesh", 0.6)
        coarser = self._coarser.solve(solution.currents, tolerance)
        stages.done("error estimated")
        return estimate_error(points, solution, coarser, replace(solution, iron=complement))

    @cached_property
    def _complement(self) -> FluxForm:
        return FluxForm(self._iron)

    @cached_property
    def _coarser(self) -> NonlinearSolver:
        return NonlinearSolver(self.device, self._refinement / _COARSER, symmetry=self._symmetry)

    def _report(
        self, state: PotentialState, seconds: dict[str, float], shares: tuple[float, ...]
    ) -> SolverReport:
        low, high = self._material.tables.range_h[:, self._material.law]
        largest = state.largest_h[0]
        below = np.where(np.isfinite(low), low, 0.0)
        return replace(
            report_of(self._form, state.iron, seconds, self.assumptions),
            largest_flux_density=float(np.linalg.norm(state.iron.flux_density[0], axis=1).max()),
            continuation=shares,
            beyond_table=int((largest > high).sum()),
            below_table=int((largest < below).sum()),
        )


def solve(
    device: Device | PathLike,
    currents: Currents,
    tolerance: float = 1e-3,
    progress: Progress | None = None,
    refinement: float = 1.0,
    estimate: bool = False,
    symmetry: str = "auto",
) -> NonlinearSolution:
    """Solve a device with nonlinear iron. For many currents make a `NonlinearSolver` once.

    Second-order potential form, Newton's method with exact line search (docs/theory/iron_saturation.md).

    Parameters
    ----------
    device
        The machine, its file, or the name of a shipped one.
    currents
        Currents (c,), A.
    tolerance
        Bounds the algebraic error. The mesh error is set by the mesh sizes of the device file and
        `refinement`.
    progress
        progress(message, fraction) is called between steps.
    refinement
        Divides the mesh sizes.
    estimate
        Put an estimate of the error of the field in the workspace into `report.error`, see
        `NonlinearSolver.estimate_error`; that takes about as long again.
    symmetry
        "auto" uses the mirror planes of the iron, "none" does not look for them.

    Returns
    -------
    NonlinearSolution
        The state at these currents.

    Raises
    ------
    GeometryError
        If bodies, windings and workspace do not fit together.
    InputError
        For bad arguments or a body without a B(H) law.
    NotConverged
        With the residual history.

    Examples
    --------
    >>> import fieldmap as fm
    >>> state = fm.solve(fm.read_device("loop_and_sphere"), currents=[1.0])
    >>> print(f"{1e3 * state.field([0.0, 0.0, -0.014])[2]:.2f} mT")
    1.01 mT
    """
    device = read_device(device)
    if estimate:
        workspace_surface(device)
    solver = NonlinearSolver(device, refinement, progress, symmetry)
    solution = solver.solve(currents, tolerance)
    error = solver.estimate_error(solution, tolerance) if estimate else None
    return replace(solution, report=replace(solution.report, error=error))
