"""The iron by a scalar potential of second order: H = t - grad phi inside, charges on the surface outside.

The form minimises a convex functional of the nodal potential phi. With b(h) the material's law, t the coil field
(`fieldmap.iron.elements.nodal_elements`) and S the operator of the air,

    R(phi) . v  =  int (b(t - grad phi) + b_r - t) . grad v dV  -  (S phi) . v  =  0      for all nodal v.

The tangent is -(int grad (db/dh) grad + S): symmetric and, for db/dh >= 1, positive. H is tangentially continuous by
construction, B only in the mean: the complement of the flux form (`fieldmap.iron.elements.flux_form`), with errors of
the other sign in closed magnetic circuits.

The air is an operator on the iron's surface. The potential phi of the iron's own field is continuous; outside it is
harmonic and decays. A layer of charge q on the surface faces generates it: W q = m, where m are the means of phi over
the faces. The layer's charge is the sum of the normal derivatives on both sides, so that the flux that leaves through
the faces into the air is

    x = W^-1 m - N^-1 m,      m = M phi,      N = M K^-1 M^T,

where N^-1 m is the flux into the iron, if it were air, of the smoothest second-order potential with these face means
(K: the iron's stiffness at mu_r = 1). Both terms depend on phi through its face means only: potentials with zero face
means add nothing. S = M^T (W^-1 - N^-1) M is therefore positive up to the discretisation error, and the whole
functional stays convex however saturated the iron is. (With the plain Schur complement of K in place of N^-1, modes
that W does not resolve would be negative, and Newton's method fails beyond 2.4 T.)

N^-1 m = y is found by the method of multipliers (Hestenes, J. Optim. Theory Appl. 4 (1969) 303): with a weight D,

    (K + M^T D M) phi = M^T (D m + y),      y <- y + D (m - M phi),

in two steps from zero. The matrix has the pattern of K and is positive definite. The factor of the saddle-point matrix
of K and M took more than three times the memory and eighteen times the work at 73 000 faces.

In N the iron's elements are air. N^-1 m is the flux that the surface charges drive inside the iron, so W and N
must give the same flux there. They do not at the rim of a sheet (thickness g) that is thinner than its elements are
wide (h). Take a potential that differs between both sides of the rim. In the elements of the sheet it falls off over
their whole width h, and its energy is h / (3 g) and more; for charges the energy grows with the logarithm of h / g.
N^-1 would subtract the sheet's own stiffness there, and flux would crowd through its rim (a magnet 10 um above a plate:
1.4 to 2.6 times the true flux density in the outermost elements). Elements at such a rim therefore have the
permeability g / h in N, and 1 if they are narrower than the gap.

Flux linkage and co-energy of the iron follow from the fields inside it: docs/theory/forces.md (4), (5).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_matrix, diags

from fieldmap.constants import MU0
from fieldmap.iron.elements.bh_law import Magnetisation, straight_laws
from fieldmap.iron.elements.nodal_elements import CoilField, FieldOfPoints, NodalElements
from fieldmap.iron.elements.state import (
    ElementField,
    IronState,
    LinearField,
    PotentialField,
    SeparatedFaces,
    SeparatedState,
)
from fieldmap.iron.mesh.mesh import volumes
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.linear_systems import ElementSums, SparseFactor, block_gmres, require_convergence
from fieldmap.iron.operators.mutual import MutualPotential
from fieldmap.iron.topology import TET_EDGES
from fieldmap.records import Record
from fieldmap.typing import Array


def vacuum(iron: AssembledIron) -> Magnetisation:
    """Air in all elements, for one source; with the permeability g / h at the rims of sheets."""
    mesh, topology = iron.mesh, iron.topology
    first = len(mesh.body_names) - len(mesh.sheets)
    outer = np.zeros(len(mesh.points), bool)
    outer[topology.nodes[topology.surface]] = True
    rim = np.flatnonzero((mesh.body >= first) & outer[mesh.tets].any(axis=1))
    gap = np.array([sheet.gap for sheet in mesh.sheets] or [0.0])[mesh.body[rim] - first]
    corners = mesh.points[mesh.tets[rim]]
    sides = np.linalg.norm(corners[:, TET_EDGES[:, 0]] - corners[:, TET_EDGES[:, 1]], axis=2)
    # A tetrahedron is a third of a prism of height g: its volume is g / 3 times half the longest side times the width
    # across that side.
    width = 6 * volumes(mesh.points, mesh.tets[rim]) / (gap * sides.max(axis=1))
    law = np.zeros(len(mesh.tets), np.int64)
    law[rim] = 1 + np.arange(len(rim))
    tables = straight_laws(np.append(1.0, np.minimum(1.0, gap / width)))
    return Magnetisation(law, tables, np.zeros((1, len(law), 3)))


# The weight D of a face, times the mean potential that a unit charge on the face makes on it. Each step gains three
# digits or more (measured errors after one and two steps: 5e-4 and 4e-7 for random face means, 2e-5 and 8e-9 for
# smooth ones). Rounding costs five of the sixteen digits.
_WEIGHT = 1e5
_STEPS = 2


class Exterior:
    """S for one mesh. face_mean (s, n): M; vacuum: entries of the iron's stiffness matrix at mu_r = 1, in `sums`."""

    def __init__(
        self, face_mean: csr_matrix, mutual: MutualPotential, sums: ElementSums, vacuum: Array
    ) -> None:
        self._mean = face_mean
        self._mutual = mutual
        self._weight = (_WEIGHT / mutual.diagonal)[:, None]
        mass = face_mean.T @ diags(self._weight[:, 0]) @ face_mean
        self._vacuum = sums.factor(vacuum + sums.entries_of(mass))

    def charge(self, potential: Array, refinements: int = 2) -> Array:
        """Charges (s, c) of the surface faces for nodal potentials (n, c)."""
        return self._mutual.solve(self._mean @ potential, refinements)

    def apply(self, potential: Array, refinements: int = 1) -> Array:
        """S phi (n, c) for phi (n, c); `refinements` of the inverse of W, see `MutualPotential.solve`."""
        return self._mean.T @ self.flux(self._mean @ potential, refinements)

    def apply_roughly(self, potential: Array) -> Array:
        """S phi (n, c) for phi (n, c) to three digits, at a third of the cost: a fixed, symmetric map."""
        means = self._mean @ potential
        return self._mean.T @ (self._mutual.solve(means) - self._inward(means, 1))

    def flux(self, means: Array, refinements: int = 2) -> Array:
        """Flux (s, c) that leaves through the surface faces into the air for mean potentials (s, c)."""
        return self._mutual.solve(means, refinements) - self._inward(means)

    def smoothest(self, potential: Array) -> Array:
        """The smoothest potentials (n, c), in the norm of K, with the same face means as potentials (n, c)."""
        means = self._mean @ potential
        flux = self._inward(means)
        return self._vacuum.solve(self._mean.T @ (self._weight * means + flux))

    def _inward(self, means: Array, steps: int = _STEPS) -> Array:
        """N^-1 m (s, c) for m (s, c)."""
        flux = np.zeros_like(means)
        for _ in range(steps):
            potential = self._vacuum.solve(self._mean.T @ (self._weight * means + flux))
            flux = flux + self._weight * (means - self._mean @ potential)
        return flux


_MAX_LINEAR_STEPS = 80
_MAX_NEWTON_STEPS = 40
# At this tolerance or a larger one, three digits of the air are enough.
_ROUGH = 1e-3


Magnetised = Callable[[FieldOfPoints], Array]
"""Charge densities (c, s), T, of the iron's faces in fields -grad u, by a function u(points (n, 3)) -> (c, n), T m."""


@dataclass(frozen=True, eq=False, repr=False)
class PotentialState(Record):
    """Nodal potential (n, c), largest mu0 H (c, e) of every element, and the iron's charges and flux densities."""

    potential: Array
    largest_h: Array
    iron: IronState


@dataclass(frozen=True, eq=False, repr=False)
class SolvedPotential(Record):
    """Nodal potential (n, 1) of one source, the exterior's S times it (n, 1), and the residuals of all steps."""

    potential: Array
    air: Array
    residuals: tuple[float, ...]


class ConvexForm:
    """One mesh with nodal or flux elements: R is solved by Krylov and Newton iterations. name: of the form, for
    reports; elements: they also define the type of the coil field inside the iron, `field`."""

    name: ClassVar[str]
    elements: Any

    def __init__(self, iron: AssembledIron, elements: Any) -> None:
        self.iron = iron
        self.elements = elements
        self._sums = ElementSums(elements.unknowns, elements.count, elements.elimination_order)
        nothing = elements.no_field()
        stiffness = self._tangent_entries(np.zeros(elements.count), nothing, vacuum(iron))
        self.exterior = Exterior(elements.face_mean, iron.mutual, self._sums, stiffness)
        one = np.ones((elements.count, 1))
        # The iron's stiffness maps constants to zero. The preconditioner replaces S by a mass matrix on the surface,
        # scaled to the capacity of the body.
        capacity = float((one.T @ self.exterior.apply(one))[0, 0])
        mass = elements.face_mean.T @ iron.surface.areas
        self._capacity = mass * (capacity / mass.sum())
        self._apart = SeparatedFaces.of(iron.mesh) if iron.mesh.drawn_sheets else None

    def solve_linear(self, material: Magnetisation, field: Any, tolerance: float) -> PotentialState:
        """All sources at once, for laws that are straight lines. Raises NotConverged."""
        zero = np.zeros(self.elements.count)
        stiffness = self.tangent(zero, field, material)
        sources = range(len(material.remanence))
        right = np.column_stack([self._residual(zero, field, c, material) for c in sources])
        potential, history = self._linear_solver(stiffness, material, tolerance)(right)
        residuals = require_convergence(type(self).__name__, history, tolerance)
        return self.state(potential, field, material, residuals)

    def magnetised(self, tangent: csr_matrix, material: Magnetisation, tolerance: float) -> Magnetised:
        """The response of a state with this tangent to small fields that have a potential. S is applied to three
        digits, and stays symmetric. The function that is returned raises NotConverged."""
        solver = self._linear_solver(tangent, material, tolerance, rough=True)
        drive = self._drive(tangent, material)

        def charges(applied: FieldOfPoints) -> Array:
            potential, history = solver(drive(applied(self.elements.node_points).T))
            require_convergence(type(self).__name__, history, tolerance)
            return self.charge_density(potential, 1)

        return charges

    def _drive(self, tangent: csr_matrix, material: Magnetisation) -> Callable[[Array], Array]:
        """A function from nodal values (k, c) of potentials to the residuals (n, c) that their fields cause."""
        raise NotImplementedError

    def solve(
        self, material: Magnetisation, field: Any, tolerance: float, start: Array | None = None
    ) -> PotentialState:
        """The state of `solve_potential`."""
        found = self.solve_potential(material, field, tolerance, start)
        return self.state(found.potential, field, material, found.residuals)

    def solve_potential(
        self, material: Magnetisation, field: Any, tolerance: float, start: Array | None = None
    ) -> SolvedPotential:
        """One source of nonlinear iron, by Newton with exact line search from `start` (n, 1). Raises NotConverged."""
        phi = np.zeros(self.elements.count) if start is None else start[:, 0].copy()
        scale, residuals = 0.0, []
        factor: SparseFactor | None = None
        # The air is linear: its part of the residual is updated with the step, not computed anew.
        air = self.exterior.apply(phi[:, None])[:, 0]
        inner = self._residual(phi, field, 0, material)
        for _ in range(_MAX_NEWTON_STEPS):
            right = inner - air
            if factor is not None:
                # Close to the solution the tangent of the step before gives the norm to a factor of three (drive unit).
                # That is enough: the residual has to fall to a thousandth of the state's allowed error.
                norm = _energy_norm(right, factor.solve(right))
                if norm < tolerance * scale:
                    residuals.append(norm / scale)
                    return SolvedPotential(phi[:, None], air[:, None], tuple(residuals))
            entries = self._tangent_entries(phi, field, material)
            factor = self._factor(entries)
            first = factor.solve(right)
            # The energy norm of the residual, relative to the norm of the coils' drive.
            norm = _energy_norm(right, first)
            if scale == 0.0:
                drive = inner if start is None else self._residual(np.zeros_like(phi), field, 0, material)
                scale = _energy_norm(drive, factor.solve(drive)) or 1.0
            residuals.append(norm / scale)
            if residuals[-1] < tolerance:
                return SolvedPotential(phi[:, None], air[:, None], tuple(residuals))
            stiffness = self._sums.matrix(entries)

            def operator(x: Array, factor: SparseFactor = factor, stiffness: csr_matrix = stiffness) -> Array:
                return factor.solve(stiffness @ x + self.exterior.apply_roughly(x))

            # The linear solve need not be more accurate than the Newton step.
            worth = min(0.1, max(1e-4, residuals[-1]))
            step = block_gmres(operator, first[:, None], worth, _MAX_LINEAR_STEPS)[0][:, 0]
            air_step = self.exterior.apply(step[:, None])[:, 0]
            length, inner = self._line_search(phi, step, right, air, air_step, field, material)
            phi, air = phi + length * step, air + length * air_step
        require_convergence("Newton", tuple(residuals), tolerance)
        raise AssertionError("unreachable")

    def _linear_solver(
        self, stiffness: csr_matrix, material: Magnetisation, tolerance: float, rough: bool = False
    ) -> Callable[[Array], tuple[Array, list[Array]]]:
        """Solves (stiffness + S) x = right (n, c); with the residuals (c,) of all steps. rough: S to three digits."""
        factor = self._factor(self._sums.entries_of(stiffness))
        exact = tolerance < _ROUGH and not rough
        air = self.exterior.apply if exact else self.exterior.apply_roughly

        def operator(x: Array) -> Array:
            return factor.solve(stiffness @ x + air(x))

        return lambda right: block_gmres(operator, factor.solve(right), tolerance, _MAX_LINEAR_STEPS)

    def tangent(self, potential: Array, field: Any, material: Magnetisation) -> csr_matrix:
        """The iron's tangent stiffness (n, n) at a potential (n,) in one source, without the air."""
        return self._sums.matrix(self._tangent_entries(potential, field, material))

    def corrections(
        self, material: Magnetisation, fields: Sequence[Any], potential: Array, air: Array, tolerance: float
    ) -> Array:
        """Newton corrections (n, s) of potentials (n, s) of s sources. All use the tangent without sources; air: S phi
        (n, s) by `Exterior.apply`. Raises NotConverged."""
        zero = np.zeros(self.elements.count)
        stiffness = self.tangent(zero, self.elements.no_field(), material)
        columns = [np.ascontiguousarray(values) for values in potential.T]
        pairs = zip(columns, fields, strict=True)
        right = np.column_stack([self._residual(phi, field, 0, material) for phi, field in pairs]) - air
        return self._solve_linear_system(stiffness, material, right, tolerance)

    def _factor(self, entries: Array) -> SparseFactor:
        """Factor of a tangent, with the capacity in place of the air: a preconditioner, to three digits."""
        with_air = entries.copy()
        with_air[self._sums.diagonal] += self._capacity
        return self._sums.rough_factor(with_air)

    def charge_density(self, potential: Array, refinements: int = 2) -> Array:
        """Charge (c, s) per area of the surface faces, T, for potentials (n, c)."""
        charge = self.exterior.charge(potential, refinements)
        return np.ascontiguousarray((charge / self.iron.surface.areas[:, None]).T)

    def by_charge_density(self, weights: Array) -> Array:
        """Derivatives (n, k) by the potential of sums of `charge_density` with weights (k, s)."""
        shares = weights.T / self.iron.surface.areas[:, None]
        return np.asarray(self.elements.face_mean.T @ self.iron.mutual.solve(shares, 2))

    def solve_tangent(
        self, potential: Array, field: Any, material: Magnetisation, right: Array, tolerance: float
    ) -> Array:
        """Solve (K + S) x = right (n, c) with the tangent K of the state (n, 1). Raises NotConverged."""
        stiffness = self.tangent(np.ascontiguousarray(potential[:, 0]), field, material)
        return self._solve_linear_system(stiffness, material, right, tolerance)

    def _solve_linear_system(
        self, stiffness: csr_matrix, material: Magnetisation, right: Array, tolerance: float
    ) -> Array:
        solved, history = self._linear_solver(stiffness, material, tolerance)(right)
        require_convergence("tangent of the potential form", history, tolerance)
        return solved

    def _line_search(self, phi, step, right, air, air_step, field, material) -> tuple[float, Array]:
        """Minimum of the functional along the step: root of R(phi + a step) . step, which falls with a.

        right: R at phi. Returns a and the iron's share of R there.
        """

        def inner(a: float) -> Array:
            return self._residual(phi + a * step, field, 0, material)

        def slope(share: Array, a: float) -> float:
            return float((share - air - a * air_step) @ step)

        full = inner(1.0)
        start, end = float(right @ step), slope(full, 1.0)
        if abs(end) < 0.3 * abs(start) or end > 0:
            return 1.0, full
        low, high, low_value, high_value = 0.0, 1.0, start, end
        for _ in range(12):
            secant = low + (high - low) * np.clip(low_value / (low_value - high_value), 0.1, 0.9)
            there = inner(secant)
            value = slope(there, secant)
            if abs(value) < 0.1 * abs(start):
                return float(secant), there
            if value > 0:
                low, low_value = secant, value
            else:
                high, high_value = secant, value
        length = float(low or 0.5 * high)
        return length, inner(length)

    def _residual(self, phi: Array, field: Any, source: int, material: Magnetisation) -> Array:
        return self._sums.vector(self.elements.residual(phi, field, source, material))

    def _tangent_entries(self, phi: Array, field: Any, material: Magnetisation) -> Array:
        return self._sums.entries(self.elements.tangent(phi, field, 0, material))

    def _inside(
        self, potential: Array, field: Any, material: Magnetisation, at_points: LinearField
    ) -> ElementField:
        """The field within elements; at_points: the field at their points, linear between them."""
        return at_points

    def state(
        self, potential: Array, field: Any, material: Magnetisation, residuals: tuple[float, ...]
    ) -> PotentialState:
        """The state of nodal potentials (n, c) in a field, with its charges and flux densities."""
        strength = self.elements.strength_at_points(potential, field, material)
        flux_density = material.flux_density(strength)
        largest = np.linalg.norm(strength, axis=3).max(axis=2)
        at_points = LinearField(flux_density, flux_density - strength)
        inside = self._inside(potential, field, material, at_points)
        density, mean = self.charge_density(potential), flux_density.mean(axis=2)
        apart = None
        if self._apart is not None:
            means = self.elements.mean_over(self._apart.nodes, self.iron.topology) @ potential
            apart = SeparatedState(self._apart, np.ascontiguousarray(means.T))
        state = IronState(self.iron.surface, density, mean, len(residuals), residuals, inside, apart)
        return PotentialState(potential, largest, state)


class PotentialForm(ConvexForm):
    """One mesh in the potential form."""

    name = "potential"
    elements: NodalElements

    def __init__(self, iron: AssembledIron) -> None:
        super().__init__(iron, NodalElements.from_mesh(iron.mesh, iron.topology))

    def _drive(self, tangent: csr_matrix, material: Magnetisation) -> Callable[[Array], Array]:
        # The residual of a field -grad u is int (db/dh - 1) (-grad u) . grad v: only nodal values of u are needed.
        none = np.zeros(self.elements.count)
        less = self.tangent(none, self.elements.no_field(), vacuum(self.iron)) - tangent
        return lambda values: less @ values

    def sensitivities(
        self, potential: Array, field: CoilField, material: Magnetisation, change: CoilField, tolerance: float
    ) -> Array:
        """Changes (n, c) of the potential (n,) of a state with the coils' field, for the sources t' of `change`.

        They solve (K + S) phi' = int (db/dh - 1) t' . grad v. Raises NotConverged.
        """
        right = self.source_response(potential, field, material, change)
        return self.solve_tangent(potential[:, None], field, material, right, tolerance)

    def source_response(
        self, potential: Array, field: CoilField, material: Magnetisation, change: CoilField
    ) -> Array:
        """int (db/dh - 1) t' . grad v (n, c) at a potential (n,), for the sources t' of `change`."""
        elements = self.elements
        h = elements.strength_at_points(potential[:, None], field, material)[0]
        turned = material.susceptible(h, elements.coil_field_at_points(change))
        turned *= 0.25 * elements.volume[:, None, None]
        return np.ascontiguousarray(elements.tested(turned).T)

    def _inside(
        self, potential: Array, field: Any, material: Magnetisation, at_points: LinearField
    ) -> ElementField:
        return PotentialField(self.elements, potential, field, material)


def _energy_norm(residual: Array, step: Array) -> float:
    """sqrt(R . K^-1 R) of a residual R and K^-1 R."""
    return float(np.sqrt(max(float(residual @ step), 0.0)))


def linkage_and_coenergy(
    volume: Array, material: Magnetisation, strength: Array, coils: Array, unit: Array
) -> tuple[Array, Array]:
    """The iron's parts of the flux linkages (c, s) in Wb and of the co-energy (s,) in J.

    At the four points of every element, in T: strength (s, e, 4, 3), mu0 H of s solved sources; coils (s, e, 4, 3):
    field of their coils alone; unit (c, e, 4, 3): field of one ampere in each of c coils. The linkage is the exact
    derivative of the discrete co-energy, so both agree on any mesh.
    """
    share = (0.25 * volume / MU0)[:, None]
    linkage, coenergy = np.zeros((len(unit), len(strength))), np.zeros(len(strength))
    per_coil = unit.reshape(len(unit), int(np.prod(unit.shape[1:])))
    for s, (h, t) in enumerate(zip(strength, coils, strict=True)):
        remanence = material.remanence[s][:, None]
        law = np.repeat(material.law[:, None], 4, axis=1)
        stored = material.tables.integral(np.linalg.norm(h, axis=2), law)
        added = material.polarisation(h, s)
        linkage[:, s] = per_coil @ (share[..., None] * added).ravel()
        local = np.sum(remanence * h - 0.5 * (h + added) * h + 0.5 * added * t, axis=2)
        coenergy[s] = np.sum(share * (stored + local))
    return linkage, coenergy


def iron_differential_inductance(
    form: PotentialForm,
    material: Magnetisation,
    potential: Array,
    field: CoilField,
    unit: CoilField,
    tolerance: float,
) -> Array:
    """The iron's part of the matrix of linkage derivatives (c, c) in H, at a state with nodal potential (n,) in the
    field of its coils.

    unit: the fields t_k of one ampere in each coil. With the tangent D = db/dh of the state, the derivative p_j of the
    potential by the current of coil j solves (K + S) p_j = int (D t_j - t_j) . grad v. Then
    d lambda_k / d I_j = 1/mu0 int (D - 1) (t_j - grad p_j) . t_k. Raises NotConverged.
    """
    response = form.sensitivities(potential, field, material, unit, tolerance)
    elements, t = form.elements, form.elements.coil_field_at_points(unit)
    h = elements.strength_at_points(potential[:, None], field, material)[0]
    added = material.susceptible(h, t - elements.point_gradients(response))
    return np.einsum("e,keqd,jeqd->kj", 0.25 * elements.volume / MU0, t, added, optimize=True)
