"""Derivatives of a state's quantities by parameters, by the adjoint of the discrete equations.

A state solves R(phi, p) = 0, whose derivative by the potential is -(K + S), symmetric
(`fieldmap.iron.elements.potential_form`). For a quantity J(phi, p),

    dJ/dp = J_p + lambda . R_p,      (K + S) lambda = J_phi,

so that each number of J costs one linear solve with the matrix of Newton's method, and each parameter an integral over
the iron. In the potential form R_p . v = int m . grad v with m the change of mu0 M at fixed potential,

    m = (db/dh - 1) t' + b'(h) + b_r',

where t', b' and b_r' are the changes of the applied field, the law and the remanence. The flux linkage of coil k,
int mu0 M . t_k dV / mu0 plus the linkage in air, changes with m in the same way; fields at points depend on phi through
the charges of the surface. (D. G. Cacuci, J. Math. Phys. 22 (1981) 2794; for magnetostatics S. Gitosusastro, J. L.
Coulomb and J. C. Sabonnadiere, IEEE Trans. Magn. 25 (1989) 2834.)

A solved state keeps its device (`Origin`), which derivatives need, but not its matrices, which are many times larger
than the state. Matrices of a solver that is still in memory are used; otherwise they are made anew from the state's
mesh.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fieldmap.arguments import check
from fieldmap.constants import MU0
from fieldmap.device.model import Device
from fieldmap.errors import InputError
from fieldmap.iron.elements.bh_law import LawTables, Magnetisation, law_tables, straight_laws
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.elements.state import PotentialField
from fieldmap.iron.materials import body_properties, materials_on
from fieldmap.iron.mesh.mesh import IronMesh, refuse_inside
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.sensitivity.by_nodes import Adjoint, ByNodes, SolvedIron
from fieldmap.iron.sensitivity.changes import Change, Parameters
from fieldmap.iron.sensitivity.moved_bodies import MovedBodies
from fieldmap.iron.sensitivity.quantities import Derivatives, Quantity, Samples, Weights
from fieldmap.iron.solution import SolvedState
from fieldmap.records import Record, shortened
from fieldmap.sources import bare_inductance, unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.inductance import background_linkage, mutual_inductance
from fieldmap.typing import Array

_TOLERANCE = 1e-8
# Numbers of a quantity whose adjoints are in memory at once.
_AT_ONCE = 12


@dataclass(frozen=True, eq=False, repr=False)
class IronProblem(Record):
    """The equations of the iron of a state. unit: the field in the iron of one ampere in each coil."""

    form: PotentialForm
    unit: CoilField


def quantity_of(state: SolvedState, quantity: Quantity) -> Array:
    """The numbers of a quantity of a state. Raises InputError for points inside the iron."""
    return np.asarray(quantity.of(_samples(state, quantity, quantity.points)), dtype=float)


def _samples(state: SolvedState, quantity: Quantity, points: Array) -> Samples:
    uses, count = quantity.uses, len(state.coils)
    refuse_inside(state.mesh, points)
    return Samples(
        state.field(points) if "field" in uses and len(points) else np.zeros((len(points), 3)),
        state.gradient(points) if "gradient" in uses and len(points) else np.zeros((len(points), 3, 3)),
        state.flux_linkage() if "linkage" in uses else np.zeros(count),
        state.coil_names,
    )


class _Direct:
    """The part of the derivatives without the iron: fields of coils and background at points, linkages in air."""

    def __init__(self, device: Device, state: SolvedState, points: Array) -> None:
        self._device, self._currents, self._points = device, state.currents, points

    def derivative(self, change: Change, weights: Weights) -> Array:
        """Derivatives (k,) of all numbers of the quantity by one parameter."""
        total = np.zeros(len(weights.field))
        if len(self._points):
            total += np.tensordot(_side_by_side(weights.field, weights.gradient), self._fields(change), 3)
        if weights.linkage.any():
            total += weights.linkage @ self._linkage(change)
        return total

    @cached_property
    def _unit(self) -> Array:
        """Fields and gradients (c, n, 3, 4) of one ampere in each coil."""
        points = self._points
        return np.array(
            [_side_by_side(*unit_flux_density_and_gradient(coil, points)) for coil in self._device.coils]
        )

    def _fields(self, change: Change) -> Array:
        """Changes (n, 3, 4) of field and gradient of coils and background."""
        points, total = self._points, np.zeros((len(self._points), 3, 4))
        if change.currents.any():
            total += np.tensordot(change.currents, self._unit, 1)
        for k in change.coils:
            total += self._currents[k] * change.slope(
                lambda side, k=k: _side_by_side(*unit_flux_density_and_gradient(side.coils[k], points))
            )
        if change.has("background"):
            total += change.slope(lambda side: _side_by_side(*side.background.field_and_gradient(points)))
        return total

    def _linkage(self, change: Change) -> Array:
        """Changes (c,) of the linkages in air."""
        total = np.zeros(len(self._currents))
        if change.currents.any():
            total += self._inductance @ change.currents
        if change.coils:
            total += self._changed_inductance(change) @ self._currents
        if change.coils or change.has("background"):
            total += change.slope(lambda side: background_linkage(side.coils, side.background))
        return total

    @cached_property
    def _inductance(self) -> Array:
        return bare_inductance(self._device.coils)

    def _changed_inductance(self, change: Change) -> Array:
        """Change (c, c) of the inductances in air. Only pairs with a coil that changes are computed, a second each."""
        out = np.zeros((len(self._currents),) * 2)
        moved = []
        for k in change.coils:
            share = change.turns(k)
            if share is not None:
                out[k] += share * self._inductance[k]
                out[:, k] += share * self._inductance[:, k]
                continue
            moved.append(k)
            if change.motion(k) is None:
                out[k, k] = change.slope(lambda side, k=k: bare_inductance(side.coils[k : k + 1])[0, 0])
        for k in moved:
            for j in range(len(out)):
                if j != k and not (j in moved and j < k):
                    out[k, j] = out[j, k] = change.slope(
                        lambda side, k=k, j=j: mutual_inductance(side.coils[k], side.coils[j])
                    )
        return out


def _side_by_side(field: Array, gradient: Array) -> Array:
    """Field (..., 3) and gradient (..., 3, 3) as (..., 3, 4)."""
    return np.concatenate([field[..., None], gradient], axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class _Follow(Record):
    """Derivatives by one parameter in the iron, in T at the points of the elements (e, 4, 3). The applied field changes
    by `applied` plus `currents` (c,) times the coils' fields per ampere; mu0 M changes by `polarisation` through the
    material alone. coils: changes of the fields per ampere, by number of the coil; velocity (n, 3): of the mesh's
    points, where bodies move; drifts: velocities (n, 3) at these points of coils that move as a whole, by number."""

    currents: Array
    applied: Array | None
    polarisation: Array | None
    coils: Mapping[int, Array]
    velocity: Array | None
    drifts: Mapping[int, Array]


class _Inside:
    """The iron of a state: adjoints, and their sums with the derivatives of `_Follow`."""

    def __init__(self, origin: Origin, state: SolvedState, problem: IronProblem) -> None:
        assert state.iron is not None
        inside, shares = state.iron.inside, state.weights
        assert isinstance(inside, PotentialField)
        self._origin, self._problem, self._currents = origin, problem, state.currents
        self._device, self._mesh = origin.device, problem.form.iron.mesh
        self._elements = problem.form.elements
        self._potential = np.ascontiguousarray(inside.potential @ shares)
        self._field = inside.field.combined(shares[None])
        own = inside.material
        self._material = Magnetisation(
            own.law, own.tables, np.einsum("c,ced->ed", shares, own.remanence)[None]
        )
        h = self._elements.strength_at_points(self._potential[:, None], self._field, self._material)[0]
        self._strength = h
        self._polarisation = self._material.polarisation(h, 0)
        self._share = (0.25 * self._elements.volume)[:, None, None]
        self._unit = self._elements.coil_field_at_points(problem.unit)
        self._moved = MovedBodies(origin.device, self._mesh, problem.form.iron.topology)

    def derivatives(self, points: Array, weights: Weights, follows: Sequence[_Follow]) -> Array:
        """The iron's part of derivatives (k, p)."""
        adjoint = self._adjoint(points, weights)
        elements, linkage = self._elements, weights.linkage / MU0
        cover = elements.point_gradients(adjoint)
        cover += np.tensordot(linkage, self._unit, 1)
        cover *= self._share
        turned = self._material.susceptible(self._strength, cover)
        by_current = np.einsum("kedx,cedx->kc", turned, self._unit, optimize=True)
        out = np.zeros((len(cover), len(follows)))
        traced = Adjoint(adjoint, points, weights, cover, turned)
        moved = {p: follow.velocity for p, follow in enumerate(follows) if follow.velocity is not None}
        if moved:
            shifts = np.stack(list(moved.values()))
            by_nodes = self._by_nodes(shifts).derivative(traced)
            out[:, list(moved)] = np.tensordot(by_nodes, shifts, ((1, 2), (1, 2)))
        for c in sorted({c for follow in follows for c in follow.drifts}):
            by_nodes = self._by_all_nodes.of_coil(c, traced)
            for p, follow in enumerate(follows):
                if c in follow.drifts:
                    out[:, p] -= np.tensordot(by_nodes, follow.drifts[c], 2)
        for p, follow in enumerate(follows):
            out[:, p] += by_current @ follow.currents
            if follow.applied is not None:
                out[:, p] += np.tensordot(turned, follow.applied, 3)
            if follow.polarisation is not None:
                out[:, p] += np.tensordot(cover, follow.polarisation, 3)
            for k, change in follow.coils.items():
                linked = float(np.sum(self._share * self._polarisation * change))
                out[:, p] += linked * linkage[:, k]
        return out

    def _by_nodes(self, shifts: Array) -> ByNodes:
        """Derivatives by the positions of the nodes that at least one of the velocities (p, n, 3) moves."""
        form, device, currents = self._problem.form, self._device, self._currents
        state = SolvedIron(device, currents, self._potential, self._strength, self._polarisation, self._share)
        return ByNodes(form, state, (shifts != 0).any(axis=(0, 2)))

    @cached_property
    def _by_all_nodes(self) -> ByNodes:
        return self._by_nodes(np.ones((1, *self._elements.points.shape)))

    def _adjoint(self, points: Array, weights: Weights) -> Array:
        """Solutions (n, k) of (K + S) lambda = J_phi."""
        form, unit = self._problem.form, self._problem.unit
        right = np.zeros((len(self._potential), len(weights.field)))
        if len(points):
            faces = form.iron.surface.weights(np.ascontiguousarray(points), weights.field, weights.gradient)
            right += form.by_charge_density(faces)
        if weights.linkage.any():
            linked = unit.combined(weights.linkage)
            right -= form.source_response(self._potential, self._field, self._material, linked) / MU0
        return form.solve_tangent(self._potential[:, None], self._field, self._material, right, _TOLERANCE)

    def follow(self, change: Change) -> _Follow:
        """Derivatives by one parameter in the iron."""
        applied: Array | None = None
        currents = change.currents.copy()
        coils: dict[int, Array] = {}
        drifts: dict[int, Array] = {}
        for k in change.coils:
            share = change.turns(k)
            if share is not None:
                currents[k] += share * self._currents[k]
                coils[k] = share * self._unit[k]
                continue
            motion = change.motion(k)
            if motion is not None:
                origin = self._device.coils[k].placement.position
                drifts[k] = motion.velocity + (self._elements.points - origin) @ motion.spin.T
                continue
            coils[k] = self._reshaped(change, k)
            applied = _added(applied, self._currents[k] * coils[k])
        if change.has("background"):
            applied = _added(applied, change.slope(self._background))
        polarisation = change.slope(self._with_laws_of) if change.has("materials") else None
        velocity = self._moved.velocities(change) if change.has_shapes else None
        return _Follow(currents, applied, polarisation, coils, velocity, drifts)

    def _reshaped(self, change: Change, k: int) -> Array:
        """Change (e, 4, 3) of the unit field of a coil that changes its shape."""

        def field(x: Array) -> Array:
            return change.slope(lambda side: unit_flux_density(side.coils[k], x))[None]

        return self._elements.coil_field_at_points(self._elements.coil_field(field))[0]

    def _background(self, device: Device) -> Array:
        assert device.background is not None
        of_background = device.background.field
        of = self._elements.coil_field(lambda x: of_background(x)[None])
        return self._elements.coil_field_at_points(of)[0]

    def _with_laws_of(self, device: Device) -> Array:
        """B (e, 4, 3) at the present field strength with the materials of a device."""
        tables, remanence = self._origin.laws(device, self._mesh)
        law = self._material.law
        return self._strength + Magnetisation(law, tables, remanence[None, law]).polarisation(
            self._strength, 0
        )


def _added(one: Array | None, other: Array) -> Array:
    return other if one is None else one + other


class Origin:
    """The device of states. linear: whether its iron was solved as linear; mu_r: of all soft bodies, None for each
    body's own."""

    def __init__(self, device: Device, linear: bool, mu_r: float | None = None) -> None:
        self.device, self.linear, self.mu_r = device, linear, mu_r
        self._solver: Any = None
        self._own: IronProblem | None = None

    def hold(self, problem: IronProblem) -> None:
        """Use these equations for as long as another object keeps them in memory."""
        self._solver = weakref.ref(problem)

    def __repr__(self) -> str:
        iron = "linear" if self.linear else "saturating"
        return shortened(f"Origin({self.device.name}, {iron} iron)")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_solver": None, "_own": None}

    def derivative(
        self,
        state: SolvedState,
        quantity: Quantity,
        parameters: Sequence[str],
        followed: Parameters | None = None,
    ) -> Derivatives:
        """See `SolvedState.derivative`; followed: how the device depends on the keys, if not as in its own file."""
        keys = (parameters,) if isinstance(parameters, str) else tuple(parameters)
        problem, known = self._problem(state), followed or Parameters(self.device)
        changes = [known.change(key) for key in keys]
        for change in changes:
            must_hold, remedy = "must not be a number of a joint", "take differences of two solutions"
            where = f"derivative, {change.key}"
            check(not change.has("joints"), where, must_hold, "a number of a joint", remedy)
        points = np.ascontiguousarray(quantity.points)
        samples = _samples(state, quantity, points)
        value = np.asarray(quantity.of(samples), dtype=float)
        weights = quantity.weights(samples)
        direct = _Direct(self.device, state, points)
        rows = np.array([direct.derivative(change, weights) for change in changes])
        rows = rows.reshape(len(changes), len(weights.field)).T
        if problem is not None:
            inside = _Inside(self, state, problem)
            # The iron's derivatives by the parameters serve all numbers of the quantity.
            follows = [inside.follow(change) for change in changes]
            for start in range(0, len(rows), _AT_ONCE):
                batch = slice(start, start + _AT_ONCE)
                part = Weights(weights.field[batch], weights.gradient[batch], weights.linkage[batch])
                rows[batch] += inside.derivatives(points, part, follows)
        by = {key: rows[:, k].reshape(value.shape) for k, key in enumerate(keys)}
        return Derivatives(value, by, 0 if problem is None else len(rows))

    def _problem(self, state: SolvedState) -> IronProblem | None:
        if state.iron is None:
            return None
        inside = state.iron.inside
        if state.mesh is None or not isinstance(inside, PotentialField):
            must_hold, remedy = "derivatives are those of the potential form", 'solve with form="potential"'
            raise InputError.of("derivative", must_hold, f"the {state.report.form} form", remedy)
        known = self._solver() if self._solver is not None else self._own
        if known is None or known.form.elements is not inside.elements:
            form = PotentialForm(assemble(state.mesh))
            # Both elements are of the same mesh and equal; only one of them is kept.
            form.elements = inside.elements
            known = IronProblem(form, inside.elements.unit_fields(self.device.coils, state.mesh))
            self._own = known
        return known

    def laws(self, device: Device, mesh: IronMesh) -> tuple[LawTables, Array]:
        """Tables and remanence (b, 3) of the bodies of a device, and of the sheets between them, on a mesh."""
        properties = body_properties(device, self.mu_r).on(mesh)
        if self.linear:
            return straight_laws(properties.mu_r), properties.remanence
        return law_tables(materials_on(device, mesh)), properties.remanence
