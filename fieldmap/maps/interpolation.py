"""How far the interpolant of a map lies from the solver between the nodes: measured where it is worst."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np

from fieldmap.interpolants import Form, contract, hermite_form, set_size
from fieldmap.iron import SolverReport
from fieldmap.kernels.map import lookup as kernels
from fieldmap.store import FieldError, Grid, MapData
from fieldmap.store.grid import Array

Pair = tuple[Array, Array]
RANDOM_POINTS = 200
SEED = 20240229


class UnitFields(Protocol):
    """What a map is evaluated from."""

    @property
    def report(self) -> SolverReport:
        """Of the solver."""
        ...

    def unit_fields(self, points: Array) -> tuple[Array, Array]:
        """Flux density (n_fields, n, 3) and gradient (n_fields, n, 3, 3), per ampere or at weight 1."""
        ...


def sample_points(grid: Grid) -> Array:
    """Points (n, 3): random ones all over the box, and the centres of cells at its corners, edges and faces.

    An interpolant is worst at cell centres, and a method that treats its boundary badly is worst in the outer
    cells. The random points are the same on every run.
    """
    random = grid.lower + np.random.default_rng(SEED).random((RANDOM_POINTS, 3)) * (grid.upper - grid.lower)
    cells = [(0, (n - 1) // 2, n - 2) for n in grid.shape]
    middle = tuple(index[1] for index in cells)
    outer = [cell for cell in itertools.product(*cells) if cell != middle]
    centres = grid.lower + (np.array(outer) + 0.5) * grid.spacing
    return np.concatenate([random, centres])


def interpolation_error(data: MapData, solution: UnitFields) -> FieldError:
    """Largest difference between the Hermite form and the solver over the sample points.

    The norm of each field's difference times its scale, a coil's reference current, is summed over the fields, so the
    figure holds at the sampled points for any currents up to these, whatever their signs. A sample, not a bound.
    """
    points = sample_points(data.grid)
    form = hermite_form(data, "raise")
    return FieldError(*map(float, difference_to_solver(form, data.field_scale, points, solution)))


def difference_to_solver(form: Form, scale: Array, points: Array, solution: UnitFields) -> Array:
    """(2,): largest sum over the fields of the norms of the differences at points (n, 3), each times its scale: B and
    gradient."""
    return _largest(_by_field(form, points), zip(*solution.unit_fields(points), strict=True), scale)


def difference_of_forms(one: Form, other: Form, scale: Array, points: Array) -> Array:
    """The same between two forms of one map."""
    return _largest(_by_field(one, points), _by_field(other, points), scale)


def _by_field(form: Form, points: Array) -> Iterator[tuple[Array, Array]]:
    """Field (n, 3) and gradient (n, 3, 3) of one coil after the other, per ampere."""
    for one in np.eye(form.n_coils):
        flux, slope = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
        kernels.evaluate(contract(form.unit, one, set_size(form.unit)), points, flux, slope)
        yield flux, slope


def _largest(ours: Iterable[Pair], theirs: Iterable[Pair], scale: Array) -> Array:
    total: list[Array | float] = [0.0, 0.0]
    for factor, (flux, slope), (exact, exact_slope) in zip(scale, ours, theirs, strict=True):
        total[0] = total[0] + factor * np.linalg.norm(flux - exact, axis=1)
        total[1] = total[1] + factor * np.linalg.norm(slope - exact_slope, axis=(1, 2))
    return np.array([np.max(part) for part in total])
