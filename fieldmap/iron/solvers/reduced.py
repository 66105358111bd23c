"""The iron on a basis of few potentials: the equations of a reduced model.

The amplitudes of the basis solve the projected equation of the potential form (docs/theory/iron_elements.md, (1)): the
law B(H) is evaluated at the points of the elements, as in the full model, and the functional stays convex.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, qr, solve_triangular

from fieldmap.core.iron import FOUND, CoreIron, IronState
from fieldmap.core.iron_numbers import numbers_without_fields
from fieldmap.errors import NotConverged
from fieldmap.iron.elements.bh_law import LawTables
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import Magnetisation, PotentialForm
from fieldmap.kernels.iron.magnetisation_law import magnetise, root_of_susceptibility
from fieldmap.parallel import results_of
from fieldmap.records import Record
from fieldmap.threads import over_rows
from fieldmap.typing import Array

# Most points for the tangents of `GalerkinModel.conditions`.
_FEW = 20_000
# Points in one block of a sum over all points.
_BLOCK = 4096
# Most steps with the tangent of another model; largest ratio of a step to the step before; states solved at once.
_STEPS, _SLOW, _AT_ONCE = 25, 0.9, 32


@dataclass(frozen=True, eq=False, repr=False)
class GalerkinModel(Record):
    """Projected iron: r modes, c coils, p sample points.

    gradients (3 p, r) and source (3 p, c): gradients of the modes and the coils' field per ampere at the points, in
    T; weights (p,) in m^3; law (p,) and tables: the material there; air (r, r) and constant (r,): A and r0 of the
    equation (docs/theory/current_dependence.md, (2)); fixed (3 p,): field of the background at the points, T, None
    without one. pinning (l, k), T, and shares (k,): of the play cells of each law, empty for iron without hysteresis.
    remanent (c,): the magnets' part of the flux linkages, times mu0, T m^3/A; empty where it is not needed.
    """

    gradients: Array
    source: Array
    weights: Array
    law: NDArray[np.int64]
    tables: LawTables
    air: Array
    constant: Array
    fixed: Array | None = None
    pinning: Array = field(default_factory=lambda: np.zeros((0, 0)))
    shares: Array = field(default_factory=lambda: np.zeros(0))
    remanent: Array = field(default_factory=lambda: np.zeros(0))

    def applied(self, currents: Array) -> Array:
        """Field (3 p,) of coils and background at the points at currents (c,), T."""
        own = self.source @ currents
        return own if self.fixed is None else own + self.fixed

    def _strength(self, rows: slice, currents: Array, amplitudes: Array) -> Array:
        """mu0 H (3 p, s) in some rows at currents (c, s) and amplitudes (r, s), T."""
        h = self.source[rows] @ currents - self.gradients[rows] @ amplitudes
        if self.fixed is not None:
            h += self.fixed[rows, None]
        return h

    @property
    def modes(self) -> int:
        """Number of amplitudes."""
        return self.gradients.shape[1]

    def solve(self, currents: Array, start: Array, tolerance: float = 1e-7) -> tuple[Array, int]:
        """Amplitudes (r,) at currents (c,), and the number of Newton steps; the last amplitudes if
        `fieldmap.core.iron.MOST_STEPS` are not enough.

        The core has the gradients in single precision, which changes amplitudes by some 1e-8 of the state.
        """
        state, amplitudes = self._core.state(), np.array(start, dtype=np.float64)
        state.solve_in(self.applied(currents), amplitudes, tolerance=tolerance)
        return amplitudes, state.steps

    def solutions(self, currents: Array, starts: Array, near: "GalerkinModel", tolerance: float) -> Array:
        """Amplitudes (s, r) at many currents (s, c), from starts (s, r). A step of all states takes one pass over the
        points, with the tangents of `near`, a model with fewer points. States that do not converge so are solved by
        Newton's method."""
        parts = [slice(first, first + _AT_ONCE) for first in range(0, len(currents), _AT_ONCE)]
        found = [self._solutions(currents[part], starts[part], near, tolerance) for part in parts]
        return np.concatenate(found) if found else starts.copy()

    def _solutions(self, currents: Array, starts: Array, near: "GalerkinModel", tolerance: float) -> Array:
        found, last = starts.copy(), np.full(len(starts), np.inf)
        pairs = list(zip(currents, starts, strict=True))
        factors = np.array(list(results_of(lambda pair: near.tangent_factor(*pair), pairs)))
        left, slow = np.arange(len(starts)), []
        for _ in range(_STEPS):
            residuals = self.residuals(currents[left], found[left])
            solved = (cho_solve((factors[k], True), row) for k, row in zip(left, residuals, strict=True))
            steps = np.array(list(solved))
            energy = np.array([np.sum((found[k] @ factors[k]) ** 2) for k in left])
            decrement = np.sqrt(np.maximum((residuals * steps).sum(axis=1), 0.0) / np.maximum(energy, 1e-300))
            worse = decrement > _SLOW * last[left]
            found[left[~worse]] += steps[~worse]
            last[left] = decrement
            slow += left[worse].tolist()
            left = left[~worse & (decrement > tolerance)]
            if not left.size:
                break
        for k in [*slow, *left]:
            found[k] = self.solve(currents[k], found[k], tolerance)[0]
        return found

    def residuals(self, currents: Array, amplitudes: Array) -> Array:
        """Residuals (s, r) of the projected equation at currents (s, c) and amplitudes (s, r)."""

        def of(first: int) -> Array:
            rows = slice(3 * first, 3 * (first + _BLOCK))
            return np.asarray(self._magnetised(first, currents.T, amplitudes.T).T @ self.gradients[rows])

        total = self.constant - amplitudes @ self.air
        for part in results_of(of, range(0, len(self.weights), _BLOCK)):
            total += part
        return np.asarray(total)

    def _magnetised(self, first: int, currents: Array, amplitudes: Array) -> Array:
        """`moments` (3 p, s) of `_BLOCK` points from number `first` on, at currents (c, s) and amplitudes (r, s)."""
        points, rows = slice(first, first + _BLOCK), slice(3 * first, 3 * (first + _BLOCK))
        h = self._strength(rows, currents, amplitudes)
        magnetise(0, h.shape[0] // 3, h, self.weights[points], self.law[points], self.tables.arrays)
        return h

    def roots_of_tangent(self, currents: Array, amplitude: Array, factor: Array) -> Array:
        """Rows H (p, 3, r), so that the sum over the points of H^T H is the share of the law in the tangent K = L L^T
        at currents (c,) and amplitudes (r,), in coordinates in which K is the unit matrix; factor: L."""
        of = np.ascontiguousarray(solve_triangular(factor, self.gradients.T, lower=True).T)
        return self._roots(0, currents, amplitude, of)

    def tangent_factor(self, currents: Array, amplitude: Array) -> Array:
        """Cholesky factor (r, r), lower, of the tangent at currents (c,) and amplitudes (r,)."""
        return cholesky(self.air + self._of_law(currents, amplitude, self.gradients), lower=True)

    def factor_and_slopes(self, currents: Array, amplitude: Array) -> tuple[Array, Array]:
        """`tangent_factor`, and the derivatives (r, c), 1/A, of the amplitudes of this state by the currents:
        docs/theory/current_dependence.md, (5)."""
        of_law = self._of_law(currents, amplitude, self.gradients, self.source)
        factor = cholesky(self.air + of_law[: self.modes, : self.modes], lower=True)
        return factor, np.asarray(cho_solve((factor, True), of_law[: self.modes, self.modes :]))

    def _of_law(self, currents: Array, amplitude: Array, *functions: Array) -> Array:
        """Sums (n, n) over the points of w f . (db/dh - 1) g for all pairs f, g of n functions (3 p, ...)."""
        total = np.zeros(2 * (sum(of.shape[1] for of in functions),))
        for first in range(0, len(self.weights), _BLOCK):
            own = np.concatenate([of[3 * first : 3 * (first + _BLOCK)] for of in functions], axis=1)
            part = self._roots(first, currents, amplitude, own).reshape(own.shape)
            total += part.T @ part
        return total

    def share_of_law(self, factor: Array) -> Array:
        """Share (r, r) of the law in a tangent K = L L^T, with its Cholesky factor L, in coordinates in which K is the
        unit matrix."""
        half = solve_triangular(factor, self.air, lower=True)
        return np.eye(len(factor)) - solve_triangular(factor, half.T, lower=True)

    def _roots(self, first: int, currents: Array, amplitude: Array, of: Array) -> Array:
        """Functions `of` (3 p, n) at points from number `first` on, times the root of w (db/dh - 1), (p, 3, n), in the
        memory of `of`."""
        points, rows = slice(first, first + len(of) // 3), slice(3 * first, 3 * first + len(of))
        h = self._strength(rows, currents[:, None], amplitude[:, None])[:, 0]
        out = of.reshape(-1, 3, of.shape[1])
        root_of_susceptibility(h, self.weights[points], self.law[points], self.tables.arrays, out)
        return out

    @cached_property
    def _few(self) -> "GalerkinModel":
        """The model on at most `_FEW` random points, with weights that are scaled to the same sum."""
        count = len(self.weights)
        if count <= _FEW:
            return self
        points = np.sort(np.random.default_rng(0).choice(count, _FEW, replace=False))
        return self.sampled(points, self.weights[points] * (self.weights.sum() / self.weights[points].sum()))

    @cached_property
    def _core(self) -> CoreIron:
        return self._core_with(np.zeros((len(self.gradients), 0)), np.zeros(0))

    def conditions(
        self, currents: Array, amplitude: Array, fields: Array, weights: "Weights"
    ) -> "Conditions":
        """The conditions on a choice of points at a state. fields (r, m): as for `error_coordinates`."""
        few = self._few
        factor, slopes = few.factor_and_slopes(currents, amplitude)
        by_fields = error_coordinates(factor, amplitude, fields, weights.energy)
        linked = few.moments(currents, amplitude).ravel() @ few.source
        combine = combinations(by_fields, slopes, linked, weights.linkage)
        scale = 0.0
        if weights.inductance:
            whole = few.inductance(currents, amplitude, slopes)
            scale = weights.inductance / (float(np.abs(whole).max(initial=0.0)) or 1.0)
        return Conditions(currents, amplitude, combine, slopes, scale)

    def inductance(self, currents: Array, amplitude: Array, slopes: Array) -> Array:
        """Derivatives of the flux linkages by the currents (n,), times mu0, of pairs of coils, each pair once:
        docs/theory/flux_linkage.md, (4). slopes (r, c): of the amplitudes."""
        of_air = slopes.T @ self.air @ slopes
        return np.asarray(
            self.inductances(currents, amplitude, slopes).sum(axis=0) + of_air[np.triu_indices(len(of_air))]
        )

    def inductances(self, currents: Array, amplitude: Array, slopes: Array) -> Array:
        """The contribution of every point to `inductance`, (p, n)."""
        roots = self._roots(0, currents, amplitude, self.source - self.gradients @ slopes)
        one, other = np.triu_indices(roots.shape[2])
        return np.asarray(np.einsum("pik,pik->pk", roots[:, :, one], roots[:, :, other]))

    def along(self, currents: Array, tolerance: float = 1e-6) -> Array:
        """Amplitudes (s, r) of iron with hysteresis that was never magnetised, at currents (s, c), one straight step
        after the other. Raises NotConverged."""
        return np.array([state.amplitudes for _, state in self._steps(currents, tolerance)])

    def linkages_along(self, currents: Array, tolerance: float = 1e-6) -> Array:
        """As `along`, the iron's part of the flux linkages (s, c), times mu0, without the magnets' part."""
        linkages = np.empty(currents.shape)
        for out, (row, state) in zip(linkages, self._steps(currents, tolerance), strict=True):
            state.linkages(row, out, None, tolerance=tolerance)
        return linkages

    def _steps(self, currents: Array, tolerance: float) -> Iterator[tuple[Array, IronState]]:
        """The state after each step of `along`."""
        state = self._core_at_currents.state()
        weights = np.empty(self.source.shape[1] + (self.fixed is not None))
        for row in np.array(currents, dtype=np.float64, order="C"):
            if state.step(row, weights, tolerance=tolerance) != FOUND:
                received = f"a relative step of {state.left:.1e} at {row.tolist()} A"
                must_hold, remedy = "Newton's method must end", "take more modes and points"
                raise NotConverged.of("reduced model of iron with hysteresis", must_hold, received, remedy)
            yield row, state

    @cached_property
    def _core_at_currents(self) -> CoreIron:
        return self._core_with(self.source, np.zeros(0) if self.fixed is None else self.fixed)

    def _core_with(self, source: Array, fixed: Array) -> CoreIron:
        iron = self.gradients, self.weights, self.law, self.tables.arrays, self.air, self.constant
        return CoreIron(numbers_without_fields(source, fixed, *iron, self.pinning, self.shares))

    def moments(self, currents: Array, amplitude: Array) -> Array:
        """mu0 times the magnetic moment (p, 3) of every point, T m^3."""
        h = self._strength(slice(None), currents[:, None], amplitude[:, None])
        given = (h, self.weights, self.law, self.tables.arrays)
        over_rows(magnetise, len(self.weights), *given, work=10.0)
        return h.reshape(-1, 3)

    def sums(self, moments: Array) -> Array:
        """Contributions (r + c,) of moments (p, 3) to the residual (r,), then to the flux linkages (c,) times mu0."""
        return np.concatenate([moments.ravel() @ self.gradients, moments.ravel() @ self.source])

    def contributions(self, moments: Array, combine: Array) -> Array:
        """Contributions (p, k) of every point's moments (p, 3) to combinations (r + c, k) of `sums`, or to combinations
        (r, k) of the residual alone."""
        of_points = self.gradients @ combine[: self.modes]
        if len(combine) > self.modes:
            of_points += self.source @ combine[self.modes :]
        return np.einsum("pi,pik->pk", moments, of_points.reshape(*moments.shape, -1))

    def totals(self, conditions: Sequence["Conditions"], mixing: Array) -> tuple[list[Array], Array]:
        """Sums (k,) over all points for each of the conditions, and for each point the sum (p,) over the conditions of
        its squared contributions, estimated by random projections, mixing (r + c, m). A pass over the points serves
        many conditions."""
        firsts = range(0, len(conditions), _AT_ONCE)
        parts = [self._totals(conditions[first : first + _AT_ONCE], mixing) for first in firsts]
        pairs = results_of(
            lambda one: one.of_pairs(self).sum(axis=0) if one.inductance else np.zeros(0), conditions
        )
        totals = (total for some, _ in parts for total in some)
        whole = [np.concatenate(both) for both in zip(totals, pairs, strict=True)]
        return whole, np.sum([squares for _, squares in parts], axis=0)

    def _totals(self, conditions: Sequence["Conditions"], mixing: Array) -> tuple[list[Array], Array]:
        currents = np.array([one.currents for one in conditions]).T
        amplitudes = np.array([one.amplitude for one in conditions]).T
        mixed = np.concatenate([one.combine @ mixing for one in conditions], axis=1)

        def of(first: int) -> tuple[Array, Array]:
            rows = slice(3 * first, 3 * (first + _BLOCK))
            functions = np.concatenate([self.gradients[rows], self.source[rows]], axis=1)
            moments = self._magnetised(first, currents, amplitudes)
            added = (functions @ mixed).reshape(-1, 3, len(conditions), mixing.shape[1])
            added = np.einsum("pik,pikm->pkm", moments.reshape(-1, 3, len(conditions)), added)
            return moments.T @ functions, np.einsum("pkm,pkm->p", added, added)

        sums, squares = zip(*results_of(of, range(0, len(self.weights), _BLOCK)), strict=True)
        of_all = np.sum(sums, axis=0)
        totals = [row @ one.combine for row, one in zip(of_all, conditions, strict=True)]
        return totals, np.concatenate(squares)

    def combined(self, basis: Array) -> "GalerkinModel":
        """The same model on combinations (r, q) of its modes."""
        air, gradients = basis.T @ self.air @ basis, np.ascontiguousarray(self.gradients @ basis)
        return replace(self, gradients=gradients, air=0.5 * (air + air.T), constant=basis.T @ self.constant)

    def sampled(self, points: NDArray[np.int64], weights: Array) -> "GalerkinModel":
        """The same model on some of its points with other weights (hyper-reduction)."""
        rows = (3 * points[:, None] + np.arange(3)).ravel()
        at_points: dict[str, Any] = {
            name: np.ascontiguousarray(getattr(self, name)[rows])
            for name in ("gradients", "source", "fixed")
            if getattr(self, name) is not None
        }
        return replace(self, weights=weights, law=self.law[points], **at_points)


def error_coordinates(factor: Array, amplitude: Array, fields: Array, energy: float) -> Array:
    """C (r, r), so that |R^T C|^2 is the squared error that a residual R (r,) causes in a state of amplitudes (r,): the
    squared relative error of the fields, plus `energy`^2 times the squared relative error in the energy norm.

    fields (r, m): of the modes, at m numbers of interest. To first order the error of the amplitudes is K^-1 R, with
    the tangent K of the state; `factor` (r, r) is the lower Cholesky factor of K.
    """
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
    # K = L L^T: R . K^-1 R = |L^-1 R|^2, and a . K a = |L^T a|^2.
    caused = inverse.T @ (inverse @ fields) / (np.linalg.norm(amplitude @ fields) or 1.0)
    stored = inverse.T * (energy / (np.linalg.norm(factor.T @ amplitude) or 1.0))
    return same_lengths(np.concatenate([caused, stored], axis=1))


def combinations(by_fields: Array, slopes: Array, linked: Array, weight: float) -> Array:
    """Combinations (r + c, r + c), in columns, of `GalerkinModel.sums`: first by_fields (r, r), of `error_coordinates`,
    of the residual; then the errors of the flux linkages over the largest one, times `weight`. An error of the residual
    moves the state, and with it the linkages. slopes (r, c): of the amplitudes; linked (c,): linkages of the state."""
    (modes, coils), largest = slopes.shape, float(np.abs(linked).max(initial=0.0)) or 1.0
    combined = np.zeros((modes + coils, modes + coils))
    combined[:modes, :modes] = by_fields
    combined[:modes, modes:] = -slopes * (weight / largest)
    combined[modes:, modes:] = np.eye(coils) * (weight / largest)
    return combined


@dataclass(frozen=True, eq=False, repr=False)
class Weights(Record):
    """Weights of the relative errors of a state's energy, flux linkages and inductances, if the relative error of its
    field has the weight 1."""

    energy: float
    linkage: float
    inductance: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Conditions(Record):
    """Numbers that points with their weights must add up to at a state, so that its field, its energy, its flux
    linkages and its inductances are right: docs/theory/flux_linkage.md, (5).

    currents (c,), amplitude (r,): of the state. combine (r + c, r + c): of `combinations`. slopes (r, c): of the
    amplitudes. inductance: factor on `GalerkinModel.inductances`, 0 where these do not count.
    """

    currents: Array
    amplitude: Array
    combine: Array
    slopes: Array
    inductance: float

    def of_points(self, model: GalerkinModel) -> Array:
        """The contributions of each point of a model to the numbers, (p, k)."""
        added = model.contributions(model.moments(self.currents, self.amplitude), self.combine)
        return np.concatenate([added, self.of_pairs(model)], axis=1) if self.inductance else added

    def of_pairs(self, model: GalerkinModel) -> Array:
        """The last of these numbers: the contributions of each point to the inductances, (p, n)."""
        return self.inductance * model.inductances(self.currents, self.amplitude, self.slopes)


def same_lengths(rows: Array) -> Array:
    """Array A (r, at most r), so that x @ A is as long as x @ rows for every x (r,); rows (r, m)."""
    return np.ascontiguousarray(qr(rows.T, mode="r", check_finite=False)[0][: len(rows)].T)


def project(
    form: PotentialForm,
    material: Magnetisation,
    unit: CoilField,
    background: CoilField | None,
    basis: Array,
    of_air: Array,
) -> GalerkinModel:
    """Project the potential form on nodal potentials `basis` (n, r); of_air (n, r): S times the basis; unit: field of
    one ampere in every coil; background: one source, if there is any."""
    elements = form.elements
    gradients = elements.gradients_at_points(basis)

    def at_points(field: CoilField) -> Array:
        bubble = elements.gradients_at_points(field.bubble.T)
        return bubble + np.moveaxis(field.constant, 0, 2)[:, None]

    rows = 12 * len(gradients)
    gradients, weights = gradients.reshape(rows, -1), np.repeat(0.25 * elements.volume, 4)
    # The product of an array with its own transpose takes half the time.
    roots = np.sqrt(np.repeat(weights, 3))
    rooted = roots[:, None] * gradients
    air = rooted.T @ rooted + basis.T @ of_air
    remanence = np.repeat(material.remanence[0], 4, axis=0).reshape(-1)
    constant = rooted.T @ (roots * remanence)
    fixed = None if background is None else at_points(background).reshape(rows)
    law, source = (np.repeat(material.law, 4), material.tables), at_points(unit).reshape(rows, -1)
    remanent = source.T @ (np.repeat(weights, 3) * remanence)
    return GalerkinModel(
        gradients, source, weights, *law, 0.5 * (air + air.T), constant, fixed, remanent=remanent
    )
