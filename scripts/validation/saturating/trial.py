"""A map against fully solved states outside the training: random, extreme, and near the worst of these."""

import itertools
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.currents import CurrentDomain, LiftAndDirections
from fieldmap.device import Device
from fieldmap.errors import NotConverged
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.parallel import same_arithmetic
from fieldmap.store import MapData, read_map
from validation.row import Array, largest_error, timed
from validation.saturating.combinations import Combination

ASKED, STATED_BOUND, ASKED_BOUND, GRADIENT_BOUND = 1e-3, 1.5, 2.0, 4.0
"""Default accuracy of a recipe, and bounds of the true error over the stated error and over the accuracy. The bound of
the gradient is twice the bound of the flux density, as is its accuracy."""
TOLERANCE = 1e-4
"""Tolerance of the reference states, much smaller than the accuracy. A stated error below it counts as this value."""
# Single coils are tried at their largest current and at this share of it, where the permeability is different.
_WEAK = 0.125
_SEED = 41


@dataclass(frozen=True)
class Trial:
    """Results of one machine: seconds of its map, and either the reason of a refusal, or errors (2,) of B and gradient,
    relative to the largest value of the same state: `true` outside the training, `stated` by the map. worst:
    kind and currents, A, of the state with the largest true error of the flux density; states: number of tried states;
    size: description of the map; faces: of the iron's surface.
    """

    combination: Combination
    seconds: float
    cpu_seconds: float
    refusal: str = ""
    true: tuple[float, float] = (0.0, 0.0)
    stated: tuple[float, float] = (0.0, 0.0)
    worst: str = ""
    states: int = 0
    size: str = ""
    faces: int = 0

    @property
    def by_stated(self) -> float:
        """True error over stated error of the flux density."""
        return self.true[0] / max(self.stated[0], TOLERANCE)

    @property
    def by_asked(self) -> tuple[float, float]:
        """True errors of flux density and gradient over the requested accuracy."""
        return self.true[0] / ASKED, self.true[1] / ASKED

    @property
    def is_wrong(self) -> bool:
        """Whether a map was written and its error is beyond a bound."""
        flux, gradient = self.by_asked
        within = self.by_stated <= STATED_BOUND and flux <= ASKED_BOUND and gradient <= GRADIENT_BOUND
        return not self.refusal and not within

    @property
    def verdict(self) -> str:
        """ "refused", "wrong" or "right"."""
        return "refused" if self.refusal else "wrong" if self.is_wrong else "right"


def tried(combination: Combination, random: int = 12, extremes: int = 12, searched: int = 4) -> Trial:
    """Make the map and try it at random states, at most at `extremes` extreme states, and at states near the worst.

    Raises the errors of `fieldmap.generate` except NotConverged, which counts as a refusal."""
    with tempfile.TemporaryDirectory() as folder:
        made, wall, cpu = timed(lambda: _made(combination, Path(folder) / "map.h5"))
        if isinstance(made, NotConverged):
            return Trial(combination, wall, cpu, refusal=str(made))
        data = read_map(made)
        true, worst, states = _true_errors(combination, data, (random, extremes, searched))
        report, stated = data.provenance.solver_report, stated_errors(data)
    size = (
        f"{report['states_solved']} states solved, {report['states_trained_on_solved']} of them to train on; "
        f"{report['modes']} modes, {report['sample_points']} points"
    )
    return Trial(
        combination,
        wall,
        cpu,
        true=tuple(true),
        stated=stated,
        worst=worst,
        states=states,
        size=size,
        faces=report["surface_faces"],
    )


def stated_errors(data: MapData) -> tuple[float, float]:
    """Errors of flux density and gradient in the map's own report."""
    errors = data.provenance.solver_report["states_tried"].values()
    return max(of["flux_density_share"] for of in errors), max(of["gradient_share"] for of in errors)


def _made(combination: Combination, path: Path) -> Path | NotConverged:
    try:
        return combination.generate(path)
    except NotConverged as refusal:
        return refusal


def _true_errors(
    combination: Combination, data: MapData, counts: tuple[int, int, int]
) -> tuple[list[float], str, int]:
    """Largest errors of flux density and gradient, the state with the largest error of the flux density, and the number
    of tried states."""
    domain = data.reduced_model.domain
    random, extremes, searched = counts
    difference = Difference(combination.device(), combination.refinement, data)
    extreme = extreme_shares(domain)[:extremes]
    kinds = [("at random", one) for one in np.random.default_rng(_SEED).random((random, len(domain.lower)))]
    kinds += [("extreme", one) for one in extreme]
    with same_arithmetic():
        rows = [difference(domain.at(shares)) for _, shares in kinds]
        worst = kinds[int(np.argmax(rows, axis=0)[0])][1]
        kinds += [("searched", one) for one in with_currents(domain, between(worst, extreme))[:searched]]
        rows += [difference(domain.at(shares)) for _, shares in kinds[len(rows) :]]
    kind, shares = kinds[int(np.argmax(rows, axis=0)[0])]
    words = f"{kind}, {', '.join(f'{current:.3g}' for current in domain.at(shares))} A"
    return np.max(rows, axis=0).tolist(), words, len(rows)


class Difference:
    """Difference of a map's fields from those of solved states, at the nodes on the surface of its box."""

    def __init__(self, device: Device, refinement: float, data: MapData) -> None:
        points = data.grid.points()
        outer = ((points == points.min(axis=0)) | (points == points.max(axis=0))).any(axis=1)
        self._points = points[outer]
        self._fields = [
            values.reshape(len(values), len(points), -1)[:, outer]
            for values in (data.flux_density, data.gradient)
        ]
        self._model = CurrentModel(data.reduced_model, data.coil_names)
        self._solver = NonlinearSolver(device, refinement)

    def __call__(self, currents: Array) -> tuple[float, float]:
        """Differences of flux density and gradient at currents (c,), relative to the largest value of this state."""
        state, weights = self._solver.solve(currents, TOLERANCE), self._model.weights(currents)
        flux, gradient = (np.tensordot(weights, values, 1) for values in self._fields)
        return (
            largest_error(flux, state.field(self._points)),
            largest_error(gradient, state.gradient(self._points).reshape(gradient.shape)),
        )


def between(worst: Array, extremes: Array) -> Array:
    """Shares (m, d) half way from the worst state (d,) to the extremes (m, d), the nearest first."""
    away = np.linalg.norm(extremes - worst, axis=1)
    others = extremes[np.argsort(away, kind="stable")][(away == 0.0).sum() :]
    return 0.5 * (worst + others)


def with_currents(domain: CurrentDomain, shares: Array) -> Array:
    """The shares (m, d) without states of zero currents, which have no field for relative errors."""
    return shares[[bool(domain.at(one).any()) for one in shares]]


def equal_shares(domain: CurrentDomain, count: int) -> Array:
    """Shares (count, d) along the line of equal currents of all coils, with both ends."""
    along = np.linspace(0.0, 1.0, count)[:, None]
    if isinstance(domain.parametrisation, LiftAndDirections):
        return np.column_stack([along, np.tile(_without(domain)[1:], (count, 1))])
    lower, upper = domain.lower.max(), domain.upper.min()
    return (lower + along * (upper - lower) - domain.lower) / (domain.upper - domain.lower)


def extreme_shares(domain: CurrentDomain) -> Array:
    """Shares (m, d) of the ranges at typical extreme currents, not only corners, the most informative first; without
    the state of zero currents."""
    found = (
        _of_a_division(domain) if isinstance(domain.parametrisation, LiftAndDirections) else _of_coils(domain)
    )
    first = np.unique(found, axis=0, return_index=True)[1]
    return with_currents(domain, found[np.sort(first)])


def _without(domain: CurrentDomain) -> Array:
    """Shares (d,) at which signals are zero or nearest to zero."""
    return np.clip(-domain.lower / (domain.upper - domain.lower), 0.0, 1.0)


def _of_coils(domain: CurrentDomain) -> Array:
    """Single coils or groups with strong and weak currents, all equal, opposed pairs, and corners."""
    off, count = _without(domain), len(domain.lower)
    alone = np.where(np.eye(count, dtype=bool), 1.0, off)
    weak = off + _WEAK * (alone - off)
    opposed = alone.copy()
    for k in range(count):
        opposed[k, (k + max(1, count // 2)) % count] = 0.0
    corners = np.random.default_rng(_SEED).integers(0, 2, (4, count)).astype(float)
    equal = np.array([np.ones(count), np.zeros(count)])
    parts = [alone[:3], weak[:1], equal, opposed[:3], corners, weak[1:2], alone[3:], 1.0 - alone[:1]]
    return np.concatenate(parts)


def _of_a_division(domain: CurrentDomain) -> Array:
    """Shares on the line x = y = 0, and at the ends of the direction signals."""
    off = _without(domain)[1:]
    line = [[lift, *off] for lift in (1.0, 0.0, 0.5)]
    axes = [[1.0, share, off[1]] for share in (0.0, 1.0)] + [[1.0, off[0], share] for share in (0.0, 1.0)]
    tips = [[1.0, *corner] for corner in itertools.product((0.0, 1.0), repeat=2)]
    return np.array([*line, *axes, *tips, [0.0, 1.0, 1.0]])
