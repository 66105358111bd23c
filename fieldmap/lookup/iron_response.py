"""How the fields of a map follow the currents, for compiled callers whose currents change at every call.

A linear map superposes one field per coil, and behind them one of weight 1 if something makes a field that no current
drives. A map of saturating iron has fields of its own behind those of the coils, whose weights w(i) its reduced model
gives (that of a background is 1); what is here are these weights, their slopes, and the map linear in the currents that
touches it:  B(i) = sum_k i_k (B_k + sum_f J_fk B_f) + sum_f (w_f - J_f . i0) B_f.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.core import CoreMap
from fieldmap.core import block as map_block
from fieldmap.core.iron_numbers import CompiledModel
from fieldmap.currents import LiftAndDirections
from fieldmap.errors import InputError, Problem
from fieldmap.field import coil_currents
from fieldmap.interpolants import INTERPOLANTS, set_size
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.lookup.current_table import CurrentTable, tabulate
from fieldmap.lookup.evaluation import MapAtCurrents
from fieldmap.lookup.field_map import FieldMap
from fieldmap.typing import Array

_made: WeakKeyDictionary[FieldMap, dict[tuple[int, int, int] | None, CurrentTable]] = WeakKeyDictionary()


def core_map(field_map: FieldMap | MapAtCurrents) -> CoreMap:
    """The map as the C core takes it: of all fields that `unit_block` has. Of a map with linear iron its weights are
    the currents of the coils. Raises InputError for a map whose evaluator is not the C core."""
    return field_map._evaluator.core()


def unit_block(field_map: FieldMap | MapAtCurrents) -> Array:
    """The coefficients of all of a map's fields: of the coils per ampere, then of saturating iron at weight 1, then of
    what no current drives. Of a map at given currents: those of their sum.

    Raises InputError for an interpolant without kernels, which compiled loops cannot evaluate.
    """
    if isinstance(field_map, MapAtCurrents):
        return core_map(field_map).block
    if INTERPOLANTS[field_map.kind].kind is None:
        must_hold = "an interpolant that the C core evaluates"
        raise InputError(
            Problem("unit_block(field_map)", must_hold, field_map.kind, "open the map with another kind")
        )
    return field_map._form.unit


def saturates(field_map: FieldMap) -> bool:
    """Whether the field is not the sum of its coils' fields and a constant."""
    return field_map._model is not None


def division_domain(field_map: FieldMap) -> tuple[Array, Array, float] | None:
    """Lowest and highest (u, x, y) of a map of saturating iron over a division of six currents, and the exponent n of
    the division; None for any other map."""
    model = field_map._model
    if model is None or not isinstance(model.model.parametrisation, LiftAndDirections):
        return None
    return model.model.lower, model.model.upper, float(model.model.parametrisation.n)


def iron_weights(field_map: FieldMap, currents: ArrayLike) -> tuple[Array, Array]:
    """Weights (s, f) of the fields behind the coils', the iron's and that of a background, at currents (s, n), A, and
    their slopes (s, f, n), 1/A.

    Raises InputError for a map that superposes, OutsideMapError for currents beyond its domain.
    """
    model = _model(field_map)
    amperes = coil_currents(currents, field_map.coil_names, len(np.atleast_2d(currents)), finite=False)
    rows = np.ascontiguousarray(np.atleast_2d(amperes))
    found = [model.weights_and_slopes(row) for row in rows]
    coils = len(field_map.coil_names)
    return np.array([weights[coils:] for weights, _ in found]), np.array([s[coils:] for _, s in found])


def compiled_currents(field_map: FieldMap) -> CompiledModel:
    """The model of a map of saturating iron, from which the C core gets the weights of its fields at any currents.

    Raises InputError for a map that superposes.
    """
    return _model(field_map).compiled


def table_of_currents(field_map: FieldMap, nodes: tuple[int, int, int] | None = None) -> CurrentTable:
    """The table of a map of saturating iron over a division: its own, or one made now, with `nodes` of u, x and y,
    and kept for the next call.

    Raises InputError for any other map.
    """
    known = field_map.current_table
    if known is not None and nodes in (None, known.nodes):
        return known
    made, info = _made.setdefault(field_map, {}), field_map.info
    if nodes not in made:
        model, evaluator = field_map._model, field_map._evaluator
        made[nodes] = tabulate(model, evaluator, info.grid, info.current_error, nodes)
    return made[nodes]


def tangent_block(field_map: FieldMap, currents: ArrayLike) -> Array:
    """A block of n_coils + 1 fields whose sum with weights (i, 1) touches the map at currents (n_coils,), A.

    Raises InputError for a map that superposes.
    """
    amperes = coil_currents(currents, field_map.coil_names)
    values, slopes = iron_weights(field_map, amperes[None])
    n = len(amperes)
    mix = np.zeros((n + 1, n + values.shape[1]))
    mix[:n, :n], mix[:n, n:] = np.eye(n), slopes[0].T
    mix[n, n:] = values[0] - slopes[0] @ amperes
    return _mixed(unit_block(field_map), mix)


def _mixed(block: Array, mix: Array) -> Array:
    """The block of sets mix (new, old) @ those of `block`."""
    size = set_size(block)
    sets = block[map_block.HEADER :].reshape(-1, mix.shape[1], size)
    header = block[: map_block.HEADER].copy()
    header[map_block.SETS] = len(mix)
    return np.concatenate([header, np.einsum("ab,pbs->pas", mix, sets, optimize=True).ravel()])


def _model(field_map: FieldMap) -> CurrentModel:
    if field_map._model is None:
        must_hold = "must be a map of saturating iron"
        problem = Problem(
            "iron_weights(field_map)", must_hold, "one whose fields superpose", "use the currents themselves"
        )
        raise InputError(problem)
    return field_map._model
