"""Errors of a reduced model: the difference of its field from the field of solved states, in the workspace."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from fieldmap.iron import HysteresisSolver, NonlinearSolver
from fieldmap.maps.training.states import Snapshots
from fieldmap.records import Record
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.store.stated_accuracy import GRADIENT, largest_share
from fieldmap.typing import Array

# Least field that errors are compared with, as a share of the field of the coils alone at their largest currents. A
# state with a weaker field would have a large relative error for no reason.
_NO_FIELD = 1e-3
# Most numbers of the fields of several states that are summed at a time.
_AT_A_TIME = 2**17

Off: TypeAlias = Callable[[Array, Array, Array], Array]
"""Function such as `ModeFields.changed`."""


@dataclass(frozen=True)
class Errors(Record):
    """Largest errors of a model over several states.

    Attributes
    ----------
    states : number of states.
    solved : number of states that were solved; the others are images of these.
    flux_density, gradient : largest difference from the solver, T and T/m.
    flux_density_share, gradient_share : largest difference divided by the largest norm of the same state's field in the
        workspace, or by a thousandth of the field of the coils alone at their largest currents if that is larger.
    largest_flux_density, largest_gradient : largest field of all states, T and T/m.
    """

    states: int
    solved: int
    flux_density: float
    gradient: float
    flux_density_share: float
    gradient_share: float
    largest_flux_density: float
    largest_gradient: float

    @property
    def share(self) -> float:
        """`largest_share` of the two shares."""
        return largest_share(self.flux_density_share, self.gradient_share)


class Trial:
    """Compares fields at points in the air.

    Parameters
    ----------
    solver
        Its surface charges give the field of the iron.
    points
        (n, 3), m.
    largest
        (c,), largest currents of the coils, A.
    """

    def __init__(self, solver: NonlinearSolver | HysteresisSolver, points: Array, largest: Array) -> None:
        self._solver, self._points = solver, points
        bare = [unit_flux_density_and_gradient(coil, points) for coil in solver.device.coils]
        self._bare = [np.array([pair[j] for pair in bare]) for j in range(2)]
        self._least = [
            _NO_FIELD * max((i * _largest(one) for i, one in zip(largest, part, strict=True)), default=0.0)
            for part in self._bare
        ]
        background = solver.device.background
        self._constant = (0.0, 0.0) if background is None else background.field_and_gradient(points)

    def shares(self, currents: Array, charge: Array, change: Array) -> Array:
        """Relative changes of the field when the charges of the iron change.

        Parameters
        ----------
        currents
            (s, c), A.
        charge
            (s, faces), charges of the states.
        change
            (s, faces), changes of these.

        Returns
        -------
        Array
            (s, 2): largest change of flux density and of the gradient, each as a share of the state's
            largest.
        """
        changed, whole = self.fields(change), self.fields(charge)
        rows = np.empty((len(currents), 2))
        for k, values in enumerate(currents):
            for j in range(2):
                largest = _largest(whole[j][k] + self._without_iron(values, j))
                rows[k, j] = _largest(changed[j][k]) / max(largest, self._least[j])
        return rows

    def shares_of_sums(
        self, currents: Array, fields: tuple[Array, Array], weights: Array, changes: Array
    ) -> Array:
        """As `shares`, for changes (s, k) of the weights (s, k) of k fields of the iron, given as flux densities (k, n,
        3) and gradients (k, n, 3, 3)."""
        rows = np.empty((len(currents), 2))
        for j, each in enumerate(fields):
            whole = np.concatenate([each, self._bare[j]])
            largest = _largest_of_sums(np.concatenate([weights, currents], axis=1), whole, self._constant[j])
            rows[:, j] = _largest_of_sums(changes, each)
            rows[:, j] /= np.maximum(largest, self._least[j])
        return rows

    def left_of_sums(self, currents: Array, fields: tuple[Array, Array], weights: Array) -> Array:
        """See `ModeFields.left_of_sums`; fields and weights as for `shares_of_sums`."""
        both = np.concatenate([weights, currents], axis=1)
        rows = np.empty((len(currents), 2))
        for j, each in enumerate(fields):
            parts = np.concatenate([each, self._bare[j]])
            sums = np.abs(both) @ [_largest(part) for part in parts]
            whole = _largest_of_sums(both, parts, self._constant[j])
            rows[:, j] = np.maximum(whole, self._least[j]) / np.maximum(sums, self._least[j])
        return rows

    def errors(self, weights: Array, charge: Array, tried: Snapshots) -> Errors:
        """Errors of a model with charges weights (s, k) @ charge (k, faces) at solved states, at least one."""
        currents, potentials = tried.currents, tried.potentials
        ours = self.fields(charge)
        theirs = self.fields(self._solver.charge_density(potentials))
        # Columns: difference and largest of flux density, then of the gradient.
        rows = np.empty((len(currents), 4))
        for k, values in enumerate(currents):
            for j in range(2):
                truth = theirs[j][k] + self._without_iron(values, j)
                rows[k, 2 * j] = _largest(np.tensordot(weights[k], ours[j], 1) - theirs[j][k])
                rows[k, 2 * j + 1] = _largest(truth)
        worst = rows.max(axis=0).tolist()
        shares = (rows[:, [0, 2]] / np.maximum(rows[:, [1, 3]], self._least)).max(axis=0).tolist()
        return Errors(
            len(currents), tried.solved, worst[0], worst[2], shares[0], shares[1], worst[1], worst[3]
        )

    def _without_iron(self, currents: Array, j: int) -> Array:
        """Flux density or gradient of coils and background at currents (c,)."""
        return np.tensordot(currents, self._bare[j], 1) + self._constant[j]

    def fields(self, charge: Array) -> tuple[Array, Array]:
        """Flux densities (s, n, 3) and gradients (s, n, 3, 3) at the places, of charges (s, faces)."""
        return self._solver.surface.field_and_gradient(self._points, charge)


@dataclass(frozen=True, eq=False, repr=False)
class ModeFields(Record):
    """Fields of the modes of the iron at the points of a trial: flux (r, n, 3), T, and gradient (r, n, 3, 3), T/m."""

    trial: Trial
    flux: Array
    gradient: Array

    @property
    def rows(self) -> Array:
        """Flux density and gradient of each mode as one row (r, m); the gradient is scaled to equal size."""
        length = np.abs(self.flux).max() / np.abs(self.gradient).max()
        parts = (self.flux, length * self.gradient)
        return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)

    def combined(self, combination: Array) -> "ModeFields":
        """Fields of combinations (k, r) of the modes."""
        return ModeFields(
            self.trial, *(np.tensordot(combination, of, 1) for of in (self.flux, self.gradient))
        )

    def changed(self, currents: Array, amplitudes: Array, changes: Array) -> Array:
        """Relative change (s,) of the field at currents (s, c) when the amplitudes (s, r) change by changes (s, r); the
        larger of flux density and gradient, as in `larger`."""
        return larger(self.trial.shares_of_sums(currents, (self.flux, self.gradient), amplitudes, changes))

    def left_of_sums(self, currents: Array, amplitudes: Array) -> Array:
        """Flux density and gradient (s, 2) at currents (s, c) and amplitudes (s, r), as shares of the sums that the
        fields of modes and coils would have if none cancelled another."""
        return self.trial.left_of_sums(currents, (self.flux, self.gradient), amplitudes)


def larger(shares: Array) -> Array:
    """`largest_share` (s,) of shares (s, 2) of flux density and gradient."""
    return np.asarray(np.maximum(shares[:, 0], shares[:, 1] / GRADIENT))


def _largest(values: Array) -> float:
    """Largest norm over the points of values (n, ...)."""
    return float(np.linalg.norm(values.reshape(len(values), -1), axis=1).max())


def _largest_of_sums(weights: Array, fields: Array, constant: Array | float = 0.0) -> Array:
    """Largest norms (s,), over n points, of the fields weights (s, k) @ fields (k, n, ...) + constant (n, ...).

    As many states are summed at a time as fit into a processor's cache.
    """
    flat, points = fields.reshape(len(fields), -1), fields.shape[1]
    always = np.broadcast_to(constant, fields.shape[1:]).reshape(-1)
    step = max(1, _AT_A_TIME // flat.shape[1])
    found = np.empty(len(weights))
    for first in range(0, len(weights), step):
        sums = (weights[first : first + step] @ flat + always).reshape(-1, points, flat.shape[1] // points)
        found[first : first + step] = np.sqrt(np.einsum("snd,snd->sn", sums, sums).max(axis=1))
    return found
