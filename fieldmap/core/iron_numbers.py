"""A reduced model of saturating iron as an array of numbers for the C core: fieldmap/core/iron.h."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.library import LIBRARY
from fieldmap.records import tuple_line
from fieldmap.typing import Array

# Rows of single precision are padded to multiples of _LANES numbers. _SIZES numbers with sizes precede the arrays.
_LANES: int = LIBRARY.IRON_LANES
_SIZES: int = LIBRARY.IRON_SIZES


class SignalDomain(NamedTuple):
    """Domain of a model's currents. division, exponent: as in `fieldmap.currents.CompiledParametrisation`; matrix (c,
    d): currents from signals, inverse (d, c): its pseudo-inverse, both empty for a division; lower, upper (d,): range
    of the signals, with a margin for rounding; limit: of every current, A, or infinity; tolerance: allowed relative
    difference of currents from the parametrisation; checked: whether currents outside are refused."""

    division: bool
    exponent: float
    matrix: NDArray[np.float64]
    inverse: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    limit: float
    tolerance: float
    checked: bool

    def __repr__(self) -> str:
        return tuple_line(self)


class CompiledModel(NamedTuple):
    """The arrays of a `fieldmap.store.ReducedModel` for `core_numbers`: p points, r modes, c coils, k fields.

    gradients (3 p, r), kept in single precision; fixed (3 p,) or (0,); other arrays as in that class. terms (t, 3)
    and expansion (t, r), kept in single precision: amplitudes as a sum over products of Chebyshev polynomials of the
    signals, each scaled to -1..1; a term is an earlier term (column 0) times the polynomial of signal (1) and degree
    (2); the first term is 1. tolerance: relative error of a solve, in the energy norm. pinning (l, k): pinning fields
    of the k play cells in each law, T, in ascending order; shares (k,), their sum 1. Both are empty for iron without
    hysteresis.
    """

    source: NDArray[np.float64]
    fixed: NDArray[np.float64]
    gradients: NDArray[np.floating[Any]]
    weights: NDArray[np.float64]
    law: NDArray[np.int64]
    offset: NDArray[np.int64]
    knots: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    air: NDArray[np.float64]
    constant: NDArray[np.float64]
    output: NDArray[np.float64]
    terms: NDArray[np.int64]
    expansion: NDArray[np.floating[Any]]
    domain: SignalDomain
    tolerance: float
    pinning: NDArray[np.float64] = np.zeros((0, 0))
    shares: NDArray[np.float64] = np.zeros(0)

    def __repr__(self) -> str:
        return tuple_line(self)


def core_numbers(model: CompiledModel) -> Array:
    """Return the sizes and arrays of a model in one array, in the order of the C core."""
    domain, modes = model.domain, len(model.constant)
    wide = _LANES * -(-modes // _LANES)
    sizes = np.zeros(_SIZES)
    sizes[:18] = (
        len(model.weights),
        modes,
        wide,
        model.source.shape[1],
        len(model.output),
        model.fixed.size > 0,
        len(model.offset) - 1,
        len(model.knots),
        len(model.terms),
        len(domain.lower),
        domain.division,
        domain.checked,
        field_count(model),
        domain.exponent,
        domain.limit,
        domain.tolerance,
        model.tolerance,
        len(model.shares),
    )
    doubles = (
        sizes,
        model.source,
        model.fixed,
        model.weights,
        model.law,
        model.offset,
        model.knots,
        model.coefficients,
        model.air,
        model.constant,
        model.output,
        model.terms,
        domain.matrix,
        domain.inverse,
        domain.lower,
        domain.upper,
        model.pinning,
        model.shares,
    )
    singles = model.gradients, model.expansion
    # The array is filled in place, because gradients of a model for making maps may take a gigabyte.
    rows = sum(len(single) for single in singles)
    numbers, at = np.zeros(sum(each.size for each in doubles) + rows * wide // 2), 0
    for each in doubles:
        numbers[at : at + each.size] = each.ravel()
        at += each.size
    for single in singles:
        behind = at + len(single) * wide // 2
        numbers[at:behind].view(np.float32).reshape(len(single), wide)[:, :modes] = single
        at = behind
    return numbers


def field_count(model: CompiledModel) -> int:
    """Return the number of all fields: of the coils, the iron and a background."""
    return int(model.source.shape[1] + len(model.output) + (model.fixed.size > 0))


def numbers_without_fields(
    source: Array,
    fixed: Array,
    gradients: Array,
    weights: Array,
    law: NDArray[np.int64],
    tables: tuple[NDArray[np.int64], Array, Array],
    air: Array,
    constant: Array,
    pinning: Array,
    shares: Array,
) -> Array:
    """Return the numbers of a model without fields, expansion and limits of currents: for `IronState.step`, or
    without coils for `IronState.solve_in`. Arguments and tables of the laws are as in `CompiledModel`."""
    coils, modes = source.shape[1], len(constant)
    # The core requires a signal and a term if there are coils; these are placeholders.
    one = min(coils, 1)
    terms = np.zeros((one, 3), np.int64), np.zeros((one, modes))
    domain = SignalDomain(
        False,
        0.0,
        np.zeros((coils, one)),
        np.zeros((one, coils)),
        -np.ones(one),
        np.ones(one),
        np.inf,
        0.0,
        False,
    )
    given = source, fixed, gradients, weights, law, *tables, air, constant, np.zeros((0, modes)), *terms
    return core_numbers(CompiledModel(*given, domain, 1.0, pinning, shares))
