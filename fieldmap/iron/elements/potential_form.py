"""The iron by a scalar potential of second order: H = t - grad phi inside, charges on the surface outside.

Minimises a convex functional of the nodal potential phi. With b(h) the material's law, t the coil field
(`fieldmap.iron.elements.nodal_elements`) and S the air (`fieldmap.iron.operators.exterior`),

    R(phi) . v  =  int (b(t - grad phi) + b_r - t) . grad v dV  -  (S phi) . v  =  0      for all nodal v.

The tangent is -(int grad (db/dh) grad + S): symmetric and, for db/dh >= 1, positive. H is tangentially continuous by
construction, B only in the mean: the complement of the flux form (`fieldmap.iron.elements.flux_form`), with errors of
the other sign in closed magnetic circuits.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.nodal_elements import CoilField, NodalElements
from fieldmap.iron.elements.separated import SeparatedFaces, SeparatedState
from fieldmap.iron.elements.state import ElementField, IronState, PotentialField
from fieldmap.iron.elements.vacuum import vacuum
from fieldmap.iron.mesh.topology import Faces
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.element_sums import ElementSums
from fieldmap.iron.operators.exterior import Exterior
from fieldmap.iron.operators.linear_systems import block_gmres, require_convergence
from fieldmap.iron.operators.sparse_cholesky import SparseFactor
from fieldmap.records import Record
from fieldmap.typing import Array

_MAX_LINEAR_STEPS = 80
_MAX_NEWTON_STEPS = 40
# From this tolerance on three digits of the air are enough.
_ROUGH = 1e-3


class Elements(Protocol):
    """What a form asks of its elements. The coil field inside the iron has the shape that they give it.

    count: number n of unknowns; unknowns (e, k): their numbers in every element; volume (e,); face_mean (s, n): takes
    them to the mean potentials of the surface faces.
    """

    @property
    def count(self) -> int: ...
    @property
    def unknowns(self) -> NDArray[np.int64]: ...
    @property
    def volume(self) -> Array: ...
    @property
    def face_mean(self) -> csr_matrix: ...

    def elimination_order(self) -> NDArray[np.int64]:
        """Order (n,) in which the unknowns are eliminated."""
        ...

    def mean_over(self, triangles: NDArray[np.int64], topology: Faces) -> csr_matrix:
        """Takes unknowns to their means (k, n) over faces with these nodes (k, 3)."""
        ...

    def no_field(self) -> Any:
        """One source that is zero."""
        ...

    def residual(self, potential: Array, field: Any, source: int, material: Magnetisation) -> Array:
        """Element vectors (e, k) of the inside's share of R at a potential (n,)."""
        ...

    def tangent(self, potential: Array, field: Any, source: int, material: Magnetisation) -> Array:
        """Element matrices (e, k, k) of minus its derivative."""
        ...

    def mean_fields(
        self, potential: Array, field: Any, source: int, material: Magnetisation
    ) -> tuple[Array, Array]:
        """Mean flux density (e, 3) of every element and the largest mu0 H (e,) in it."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class PotentialState(Record):
    """Nodal potential (n, c), largest mu0 H (c, e) of every element, and the iron's charges and flux densities."""

    potential: Array
    largest_h: Array
    iron: IronState


E = TypeVar("E", bound=Elements)


class ConvexForm(Generic[E]):
    """One mesh, with either family of elements: Krylov and Newton on R. name: of the form, for reports."""

    name: ClassVar[str]

    def __init__(self, iron: AssembledIron, elements: E) -> None:
        self.iron = iron
        self.elements = elements
        self._sums = ElementSums(elements.unknowns, elements.count, elements.elimination_order)
        nothing = elements.no_field()
        stiffness = self._tangent_entries(np.zeros(elements.count), nothing, 0, vacuum(iron))
        self._exterior = Exterior(elements.face_mean, iron.mutual, self._sums, stiffness)
        one = np.ones((elements.count, 1))
        # Constants leave the iron's stiffness unmoved; a mass of the body's capacity on the surface stands for S.
        capacity = float((one.T @ self._exterior.apply(one))[0, 0])
        mass = elements.face_mean.T @ iron.surface.areas
        self._capacity = mass * (capacity / mass.sum())
        self._apart = SeparatedFaces.of(iron.mesh) if iron.mesh.drawn_sheets else None

    def solve_linear(self, material: Magnetisation, field: Any, tolerance: float) -> PotentialState:
        """All sources at once, for laws that are straight lines. Raises NotConverged."""
        zero = np.zeros(self.elements.count)
        stiffness = self._tangent(zero, field, 0, material)
        sources = range(len(material.remanence))
        right = np.column_stack([self._residual(zero, field, c, material) for c in sources])
        potential, history = self._linear_system(stiffness, material, right, tolerance)
        residuals = tuple(float(step.max()) for step in history)
        require_convergence(type(self).__name__, residuals, tolerance)
        return self._state(potential, field, material, residuals)

    def solve(
        self, material: Magnetisation, field: Any, tolerance: float, start: Array | None = None
    ) -> PotentialState:
        """One source of nonlinear iron, by Newton with exact line search from `start` (n, 1). Raises NotConverged."""
        phi = np.zeros(self.elements.count) if start is None else start[:, 0].copy()
        scale, residuals = 0.0, []
        factor: SparseFactor | None = None
        # The air is linear: its share of the residual is carried along instead of computed anew.
        air = self._exterior.apply(phi[:, None])[:, 0]
        inner = self._residual(phi, field, 0, material)
        for _ in range(_MAX_NEWTON_STEPS):
            right = inner - air
            if factor is not None:
                # The tangent of the step before tells the norm to a factor of three close to the solution (drive unit),
                # and the residual is asked to be a thousandth of what the state may be off.
                norm = _energy_norm(right, factor.solve(right))
                if norm < tolerance * scale:
                    residuals.append(norm / scale)
                    return self._state(phi[:, None], field, material, tuple(residuals))
            entries = self._tangent_entries(phi, field, 0, material)
            factor = self._factor(entries)
            first = factor.solve(right)
            # The energy norm of the residual, relative to that of the coils' drive.
            norm = _energy_norm(right, first)
            if scale == 0.0:
                drive = inner if start is None else self._residual(np.zeros_like(phi), field, 0, material)
                scale = _energy_norm(drive, factor.solve(drive)) or 1.0
            residuals.append(norm / scale)
            if residuals[-1] < tolerance:
                return self._state(phi[:, None], field, material, tuple(residuals))
            step = self._newton_step(self._sums.matrix(entries), factor, first, residuals[-1])
            air_step = self._exterior.apply(step[:, None])[:, 0]
            length, inner = self._line_search(phi, step, right, air, air_step, field, material)
            phi, air = phi + length * step, air + length * air_step
        require_convergence("Newton", tuple(residuals), tolerance)
        raise AssertionError("unreachable")

    def _linear_system(
        self, stiffness: csr_matrix, material: Magnetisation, right: Array, tolerance: float
    ) -> tuple[Array, list[Array]]:
        """Solve (stiffness + S) x = right (n, c); the residuals (c,) of all steps."""
        factor = self._factor(self._sums.entries_of(stiffness))
        air = self._exterior.apply if tolerance < _ROUGH else self._exterior.apply_roughly

        def operator(x: Array) -> Array:
            return factor.solve(stiffness @ x + air(x))

        return block_gmres(operator, factor.solve(right), tolerance, _MAX_LINEAR_STEPS)

    def air(self, potential: Array) -> Array:
        """S phi (n, c) for potentials (n, c), see `fieldmap.iron.operators.exterior`."""
        return self._exterior.apply(potential)

    def tangent(self, material: Magnetisation, field: Any, potential: Array) -> csr_matrix:
        """The iron's tangent stiffness (n, n) at a potential (n,), without the air."""
        return self._tangent(potential, field, 0, material)

    def corrections(
        self, material: Magnetisation, fields: Sequence[Any], potential: Array, air: Array, tolerance: float
    ) -> Array:
        """What one step of Newton's method would add to potentials (n, s) of as many sources, (n, s), with the tangent
        without sources, the same for all; air: S phi (n, s), as `air` gives it. Raises NotConverged."""
        zero = np.zeros(self.elements.count)
        stiffness = self._tangent(zero, self.elements.no_field(), 0, material)
        columns = [np.ascontiguousarray(values) for values in potential.T]
        pairs = zip(columns, fields, strict=True)
        right = np.column_stack([self._residual(phi, field, 0, material) for phi, field in pairs]) - air
        return self._solve_linear_system(stiffness, material, right, tolerance)

    def _factor(self, entries: Array) -> SparseFactor:
        """Of a tangent, with the capacity for the air."""
        with_air = entries.copy()
        with_air[self._sums.diagonal] += self._capacity
        return self._sums.factor(with_air)

    def charge_density(self, potential: Array) -> Array:
        """Charge (c, s) per area of the surface faces, T, for potentials (n, c)."""
        return np.ascontiguousarray((self._exterior.charge(potential) / self.iron.surface.areas[:, None]).T)

    def charges(self, potential: Array) -> Array:
        """Charges (s, c) of the surface faces for potentials (n, c)."""
        return self._exterior.charge(potential)

    def smoothest(self, potential: Array) -> Array:
        """The smoothest potentials (n, c) with the face means of these (n, c), see
        `fieldmap.iron.operators.exterior`."""
        return self._exterior.smoothest(self.elements.face_mean @ potential)

    def assembled(self, vectors: Array) -> Array:
        """Sum (n,) of element vectors (e, k)."""
        return self._sums.vector(vectors)

    def by_charge_density(self, weights: Array) -> Array:
        """How sums of `charge_density` with weights (k, s) follow the potential: (n, k)."""
        shares = weights.T / self.iron.surface.areas[:, None]
        return np.asarray(self.elements.face_mean.T @ self.iron.mutual.solve(shares, 2))

    def solve_tangent(
        self, potential: Array, field: Any, material: Magnetisation, right: Array, tolerance: float
    ) -> Array:
        """Solve (K + S) x = right (n, c) with the tangent K of the state (n, 1). Raises NotConverged."""
        stiffness = self._tangent(np.ascontiguousarray(potential[:, 0]), field, 0, material)
        return self._solve_linear_system(stiffness, material, right, tolerance)

    def _solve_linear_system(
        self, stiffness: csr_matrix, material: Magnetisation, right: Array, tolerance: float
    ) -> Array:
        solved, history = self._linear_system(stiffness, material, right, tolerance)
        residuals = tuple(float(step.max()) for step in history)
        require_convergence("tangent of the potential form", residuals, tolerance)
        return solved

    def _newton_step(self, stiffness, factor, first, residual: float) -> Array:
        def operator(x: Array) -> Array:
            return factor.solve(stiffness @ x + self._exterior.apply_roughly(x))

        tolerance = min(0.1, max(1e-4, residual))
        step, _ = block_gmres(operator, first[:, None], tolerance, _MAX_LINEAR_STEPS)
        return step[:, 0]

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

    def _tangent_entries(self, phi: Array, field: Any, source: int, material: Magnetisation) -> Array:
        return self._sums.entries(self.elements.tangent(phi, field, source, material))

    def _tangent(self, phi: Array, field: Any, source: int, material: Magnetisation) -> csr_matrix:
        return self._sums.matrix(self._tangent_entries(phi, field, source, material))

    def _inside(self, potential: Array, field: Any, material: Magnetisation) -> ElementField:
        """The field within elements."""
        raise NotImplementedError

    def _state(self, potential: Array, field: Any, material: Magnetisation, residuals) -> PotentialState:
        columns = range(potential.shape[1])
        fields = [self.elements.mean_fields(potential[:, c], field, c, material) for c in columns]
        density = self.charge_density(potential)
        mean, largest = (np.stack(values) for values in zip(*fields, strict=True))
        inside = self._inside(potential, field, material)
        apart = self._separated(potential)
        state = IronState(self.iron.surface, density, mean, len(residuals), residuals, inside, apart)
        return PotentialState(potential, largest, state)

    def _separated(self, potential: Array) -> SeparatedState | None:
        """The iron with air in drawn gaps, for potentials (n, c); None where there are none."""
        if self._apart is None:
            return None
        means = self.elements.mean_over(self._apart.nodes, self.iron.topology)
        return SeparatedState(self._apart, np.ascontiguousarray((means @ potential).T))


class PotentialForm(ConvexForm[NodalElements]):
    """One mesh in the potential form."""

    name = "potential"

    def __init__(self, iron: AssembledIron) -> None:
        super().__init__(iron, NodalElements.from_mesh(iron.mesh, iron.topology))

    def sensitivities(
        self, potential: Array, field: CoilField, material: Magnetisation, change: CoilField, tolerance: float
    ) -> Array:
        """How the potential (n,) of a state follows changes of the coils' field, the sources of `change`: (n, c).

        The residual R follows by int (db/dh - 1) t' . grad v, so that (K + S) phi' is this. Raises NotConverged.
        """
        right = self.source_response(potential, field, material, change)
        return self.solve_tangent(potential[:, None], field, material, right, tolerance)

    def source_response(
        self, potential: Array, field: CoilField, material: Magnetisation, change: CoilField
    ) -> Array:
        """int (db/dh - 1) t' . grad v (n, c) at a potential (n,), for the sources t' of `change`."""
        values = np.ascontiguousarray(potential)
        parts = [
            self._sums.vector(self.elements.source_response(values, field, material, change, c))
            for c in range(len(change.bubble))
        ]
        return np.column_stack(parts)

    def _inside(self, potential: Array, field: Any, material: Magnetisation) -> ElementField:
        law, tables, remanence = material.law, material.tables, material.remanence
        return PotentialField(self.elements, potential, field, law, tables, remanence)


def _energy_norm(residual: Array, step: Array) -> float:
    """sqrt(R . K^-1 R) of a residual R and K^-1 R."""
    return float(np.sqrt(max(float(residual @ step), 0.0)))
