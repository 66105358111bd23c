"""Pseudo-arclength continuation [1], which follows solutions of R(q, p) = 0 in the parameter p, around folds.

1. H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in Applications of Bifurcation
   Theory (ed. P. H. Rabinowitz), Academic Press, 1977, 359-384.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.errors import NotConverged, OutsideMapError
from fieldmap.records import Record
from fieldmap.typing import Array

Residual = Callable[[Array, float], Array]
Slope = Callable[[Array, float], Array]

_ITERATIONS = 8
_TOLERANCE = 1e-10
_DIFFERENCE = 1e-5
_GROWTH, _SMALLEST = 1.5, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class Fold(Record):
    """A point at which a branch turns back: the parameter has an extremum, and two solutions meet."""

    parameter: float
    unknowns: Array


@dataclass(frozen=True, eq=False, repr=False)
class FollowedBranch(Record):
    """A branch in the order in which it was followed.

    Attributes
    ----------
    parameters : (n,).
    unknowns : (n, k).
    at_stops : unknowns at the stops that were reached before the first fold or edge.
    folds : in the order in which they were passed.
    ended : "last stop"; "edge", when the unknowns or the parameter left their range; or "steps", after the
        largest number of steps.
    """

    parameters: Array
    unknowns: Array
    at_stops: Array
    folds: tuple[Fold, ...]
    ended: str


def follow_branch(
    residual: Residual,
    start: ArrayLike,
    stops: ArrayLike,
    scale: ArrayLike,
    slope: Slope | None = None,
    inside: Callable[[Array], bool] = lambda q: True,
    limits: tuple[float, float] | None = None,
    step: float = 0.05,
    most_steps: int = 400,
) -> FollowedBranch:
    """Follow the solution of residual(q, p) = 0 through the parameters `stops`.

    Parameters
    ----------
    residual
        residual(q (k,), p) gives (k,).
    start
        (k,), near the solution at stops[0].
    stops
        (n,), at least two parameters in rising or falling order. The branch has a point at exactly each of
        them, and ends at the last one.
    scale
        (k + 1,), a typical change of each unknown and of the parameter.
    slope
        slope(q, p) gives dR/dq (k, k); differences are used unless given.
    inside
        inside(q) says whether the unknowns lie in their range.
    limits
        Range of the parameter, which may turn back at folds; the range of the stops unless given.
    step
        Largest step, in units of `scale`.
    most_steps
        Largest number of steps.

    Returns
    -------
    FollowedBranch
        The branch.

    Raises
    ------
    NotConverged
        If there is no solution near the start.

    Examples
    --------
    >>> found = follow_branch(lambda q, p: q**3 - q + p, [1.0], [0.0, 0.3, 0.6], [1.0, 1.0], limits=(-1.0, 1.0))
    >>> print([round(fold.parameter, 4) for fold in found.folds], len(found.at_stops), found.ended)
    [0.3849, -0.3849] 2 edge
    """
    targets, begin = np.asarray(stops, dtype=float), np.asarray(start, dtype=float)
    bounds = limits or (float(targets.min()), float(targets.max()))
    walk = _Walk(residual, slope, np.asarray(scale, dtype=float), bounds, inside, targets, step)
    v = walk.at(np.append(begin, targets[0]) / walk.scale, targets[0])
    if v is None:
        where, must_hold = "follow_branch(start)", "must be near a solution"
        raise NotConverged.of(where, must_hold, f"{begin.tolist()}", "give a better start")
    return walk.go(v, most_steps)


@dataclass(eq=False)
class _Walk:
    """The continuation in scaled variables v = (q / q_scale, p / p_scale)."""

    residual: Residual
    slope: Slope | None
    scale: Array
    limits: tuple[float, float]
    inside: Callable[[Array], bool]
    stops: Array
    step: float

    def __post_init__(self) -> None:
        self.low, self.high = self.limits
        self.way = 1.0 if self.stops[-1] >= self.stops[0] else -1.0
        self.points: list[Array] = []
        self.reached: list[Array] = []
        self.folds: list[Fold] = []

    def go(self, v: Array, most_steps: int) -> FollowedBranch:
        """Follow the branch from the point v."""
        self.points, self.reached = [v], [v]
        tangent = self._tangent(v, None)
        tangent = tangent if tangent[-1] * self.way > 0 else -tangent
        length = self.step
        for _ in range(most_steps):
            new, length = self._advance(v, tangent, length)
            if new is None:
                return self._result("edge")
            turned = self._tangent(new, tangent)
            if turned[-1] * tangent[-1] < 0:
                self._note_fold(v, tangent, new)
            elif not self.folds:
                self._note_stops(v, new)
            self.points.append(new)
            v, tangent = new, turned
            if not self.folds and len(self.reached) == len(self.stops):
                return self._result("last stop")
        return self._result("steps")

    def _result(self, ended: str) -> FollowedBranch:
        points, reached = np.array(self.points) * self.scale, np.array(self.reached) * self.scale
        return FollowedBranch(points[:, -1], points[:, :-1], reached[:, :-1], tuple(self.folds), ended)

    def _advance(self, v: Array, tangent: Array, length: float) -> tuple[Array | None, float]:
        """The next point, or None at an edge, and the length of the step after it."""
        while length >= _SMALLEST * self.step:
            stop = self._next_stop(v, tangent, length)
            new = self._corrected(v, tangent, length) if stop is None else stop
            if new is not None:
                return new, min(_GROWTH * length, self.step)
            length *= 0.5
        return None, length

    def _next_stop(self, v: Array, tangent: Array, length: float) -> Array | None:
        """The point at the last stop if this step would pass it, else None: the residual may not exist beyond it."""
        last = self.stops[-1] / self.scale[-1]
        beyond = (v[-1] + length * tangent[-1] - last) * self.way
        if self.folds or beyond < 0 or tangent[-1] * self.way <= 0:
            return None
        return self.at(v + (last - v[-1]) / tangent[-1] * tangent, self.stops[-1])

    def _note_stops(self, v: Array, new: Array) -> None:
        while len(self.reached) < len(self.stops):
            stop = self.stops[len(self.reached)] / self.scale[-1]
            if (new[-1] - stop) * self.way < -1e-12:
                return
            share = (stop - v[-1]) / (new[-1] - v[-1]) if new[-1] != v[-1] else 1.0
            found = self.at(v + share * (new - v), stop * self.scale[-1])
            if found is None:
                return
            self.reached.append(found)

    def _note_fold(self, v: Array, tangent: Array, new: Array) -> None:
        whole = float(np.linalg.norm(new - v))

        def rise(length: float) -> float:
            if length == 0.0:
                return float(tangent[-1])
            at = self._corrected(v, tangent, length)
            return float(self._tangent(new if at is None else at, tangent)[-1])

        turns = rise(whole) * tangent[-1] < 0
        length = scipy.optimize.brentq(rise, 0.0, whole, xtol=1e-9) if turns else whole
        at = self._corrected(v, tangent, length) if length > 0 else v
        w = (new if at is None else at) * self.scale
        self.folds.append(Fold(float(w[-1]), w[:-1]))

    def _tangent(self, v: Array, before: Array | None) -> Array:
        """Unit vector along the branch: the null vector of the Jacobian."""
        tangent = np.linalg.svd(self._jacobian(v))[2][-1]
        return tangent if before is None or tangent @ before >= 0 else -tangent

    def _corrected(self, v: Array, tangent: Array, length: float) -> Array | None:
        """The point of the branch in the plane normal to the tangent, `length` ahead of v, by Newton's method. None if
        it does not converge nearby."""
        return self._newton(v + length * tangent, tangent, float(tangent @ v) + length, 2.0 * length)

    def at(self, guess: Array, parameter: float) -> Array | None:
        """The point of the branch at a parameter."""
        unit, value = np.eye(len(guess))[-1], parameter / self.scale[-1]
        return self._newton(np.append(guess[:-1], value), unit, value, np.inf)

    def _newton(self, guess: Array, row: Array, value: float, farthest: float) -> Array | None:
        """The solution near a guess in the plane row . w = value."""
        w, size = guess.copy(), np.inf
        for _ in range(_ITERATIONS):
            if not self._holds(w):
                return None
            try:
                matrix = np.vstack([self._jacobian(w), row])
                step = np.linalg.solve(matrix, np.append(self._value(w), row @ w - value))
            except (np.linalg.LinAlgError, OutsideMapError):
                return None
            w = w - step
            last, size = size, float(np.abs(step).max())
            if np.linalg.norm(w - guess) > farthest:
                return None
            # An interpolated force may jump between cells by its error. If steps stop shrinking, the point is taken.
            if size < _TOLERANCE or (size < 1e-5 and size > 0.5 * last):
                return w if self._holds(w) else None
        return w if size < 1e-5 and self._holds(w) else None

    def _value(self, v: Array) -> Array:
        w = v * self.scale
        return self.residual(w[:-1], float(w[-1]))

    def _jacobian(self, v: Array) -> Array:
        """dR/dv (k, k + 1): the unknowns by `slope` if there is one, the rest by differences inside the limits."""
        w = v * self.scale
        columns = []
        if self.slope is not None:
            columns = list((self.slope(w[:-1], float(w[-1])) * self.scale[:-1]).T)
        for k in range(len(columns), len(v)):
            ahead, behind = v.copy(), v.copy()
            ahead[k] += _DIFFERENCE
            behind[k] -= _DIFFERENCE
            if k == len(v) - 1:
                ahead[k] = min(ahead[k], self.high / self.scale[-1])
                behind[k] = max(behind[k], self.low / self.scale[-1])
            columns.append((self._value(ahead) - self._value(behind)) / (ahead[k] - behind[k]))
        return np.array(columns).T

    def _holds(self, v: Array) -> bool:
        margin = 1e-9 * (self.high - self.low)
        p = v[-1] * self.scale[-1]
        return bool(self.low - margin <= p <= self.high + margin) and self.inside(v[:-1] * self.scale[:-1])
