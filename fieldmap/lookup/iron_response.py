"""Weights of a map's fields as functions of the currents, for compiled callers whose currents change at every call.

A linear map is the sum of one field per coil times its current, and of a constant field, weight 1, if there is a source
that no current drives. A map of saturating iron has more fields: those of the iron, whose weights w(i) the reduced
model gives, and the background, weight 1. This module gives these weights, their derivatives J = dw/di, and the tangent
of the map at currents i0, which is linear in the currents:
B(i) = sum_k i_k (B_k + sum_f J_fk B_f) + sum_f (w_f(i0) - J_f . i0) B_f.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive
from fieldmap.core import CoreMap
from fieldmap.core import block as map_block
from fieldmap.core.iron_numbers import CompiledModel
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
    """The map for the C core, with all fields of `unit_block`.

    The weights of a map with linear iron are the currents of the coils.

    Parameters
    ----------
    field_map
        Opened map, or one at given currents.

    Returns
    -------
    CoreMap
        The map for the C core.

    Raises
    ------
    InputError
        For a map whose evaluator is not the C core.
    """
    return field_map._evaluator.core()


def unit_block(field_map: FieldMap | MapAtCurrents) -> Array:
    """The coefficients of all of a map's fields.

    Parameters
    ----------
    field_map
        Opened map, or one at given currents.

    Returns
    -------
    Array
        Coefficients of the coils per ampere, then of saturating iron at weight 1, then of the constant field. For a map
        at given currents: coefficients of the sum.

    Raises
    ------
    InputError
        For an interpolant without kernels, which compiled loops cannot evaluate.
    """
    if isinstance(field_map, MapAtCurrents):
        return core_map(field_map).block
    if INTERPOLANTS[field_map.kind].kind is None:
        must_hold = "an interpolant that the C core evaluates"
        raise InputError.of(
            "unit_block(field_map)", must_hold, field_map.kind, "open the map with another kind"
        )
    return field_map._form.unit


def saturates(field_map: FieldMap) -> bool:
    """Whether the iron of the map saturates, so that its fields do not superpose.

    Parameters
    ----------
    field_map
        Opened map.

    Returns
    -------
    bool
        True for a map of saturating iron.
    """
    return field_map._model is not None


def iron_weights(field_map: FieldMap, currents: ArrayLike, loop: float | None = None) -> tuple[Array, Array]:
    """Weights of the fields of the iron and the background, and their derivatives by the currents.

    Parameters
    ----------
    field_map
        A map of saturating iron.
    currents
        (s, n), A.
    loop
        Size of current loops, A, whose slopes replace the derivatives, as for `FieldMap.by_currents`.

    Returns
    -------
    tuple[Array, Array]
        Weights (s, f), and derivatives (s, f, n), 1/A.

    Raises
    ------
    InputError
        For a linear map, and for a loop that is not positive.
    OutsideMapError
        For currents outside the domain.
    """
    if loop is not None:
        check_positive("iron_weights", loop=loop)
    model = _model(field_map)
    amperes = coil_currents(currents, field_map.coil_names, len(np.atleast_2d(currents)), finite=False)
    rows = np.ascontiguousarray(np.atleast_2d(amperes))
    found = [model.weights_and_slopes(row, loop) for row in rows]
    coils = len(field_map.coil_names)
    return np.array([weights[coils:] for weights, _ in found]), np.array([s[coils:] for _, s in found])


def compiled_currents(field_map: FieldMap) -> CompiledModel:
    """The model of a map of saturating iron, from which the C core gets the weights of its fields at any
    currents.

    Parameters
    ----------
    field_map
        Opened map of saturating iron.

    Returns
    -------
    CompiledModel
        The model.

    Raises
    ------
    InputError
        For a map that superposes.
    """
    return _model(field_map).compiled


def inductance_at_zero(field_map: FieldMap) -> Array:
    """Incremental inductances at zero currents, also where these lie beyond the domain of a map of saturating iron.

    Parameters
    ----------
    field_map
        Opened map.

    Returns
    -------
    Array
        (n_coils, n_coils), H, symmetric.

    Raises
    ------
    InputError
        For a map without linkages.
    NotConverged
        If the model has no solution there.
    """
    known = field_map._linkages().inductance
    if field_map._model is None:
        return known
    return known + field_map._model.linkages(np.zeros(len(known)), inductance=True, checked=False)[1]


def table_of_currents(field_map: FieldMap, nodes: tuple[int, int, int] | None = None) -> CurrentTable:
    """The table of weights of a map of saturating iron whose currents are divided by lift and directions.

    A table that is not stored with the map is made now and kept for later calls.

    Parameters
    ----------
    field_map
        The map.
    nodes
        Numbers of nodes for u, x and y; unless given, those of the map's own table or sufficient numbers.

    Raises
    ------
    InputError
        For any other map.
    """
    known = field_map.current_table
    if known is not None and nodes in (None, known.nodes):
        return known
    made, info = _made.setdefault(field_map, {}), field_map.info
    if nodes not in made:
        model, evaluator = field_map._model, field_map._evaluator
        made[nodes] = tabulate(model, evaluator, info.grid, info.current_error, nodes)
    return made[nodes]


def tangent_block(field_map: FieldMap, currents: ArrayLike, loop: float | None = None) -> Array:
    """A block of n_coils + 1 fields whose sum with weights (i, 1) is tangent to the map at given currents.

    Parameters
    ----------
    field_map
        Opened map of saturating iron.
    currents
        Currents (n_coils,), A.
    loop
        As for `iron_weights`.

    Returns
    -------
    Array
        The coefficients.

    Raises
    ------
    InputError
        As `iron_weights`.
    """
    return _mixed(unit_block(field_map), tangent_mix(field_map, currents, loop))


def tangent_mix(field_map: FieldMap, currents: ArrayLike, loop: float | None = None) -> Array:
    """The fields of `tangent_block` as combinations (n_coils + 1, n_fields) of the map's fields. Arguments and errors
    are those of `tangent_block`."""
    amperes = coil_currents(currents, field_map.coil_names)
    values, slopes = iron_weights(field_map, amperes[None], loop)
    n = len(amperes)
    mix = np.zeros((n + 1, n + values.shape[1]))
    mix[:n, :n], mix[:n, n:] = np.eye(n), slopes[0].T
    mix[n, n:] = values[0] - slopes[0] @ amperes
    return mix


def _mixed(block: Array, mix: Array) -> Array:
    """A block whose fields are combinations of the fields of `block`: mix (new, old) @ old fields."""
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
