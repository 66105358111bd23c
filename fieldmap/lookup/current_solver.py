"""The model of a map of saturating iron for the C core: its arrays, and an expansion at which solves begin."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from fieldmap.core.iron import FOUND, MOST_STEPS, CoreIron
from fieldmap.core.iron_numbers import CompiledModel, SignalDomain, core_numbers, field_count
from fieldmap.currents import ROUNDING, TOLERANCE, CurrentDomain
from fieldmap.errors import NotConverged, Problem
from fieldmap.store import ReducedModel
from fieldmap.threads import over_rows
from fieldmap.typing import Array

COMPILED_TOLERANCE = 1e-4
"""Tolerance of solves in compiled callers: error of the state in the energy norm, a share. It adds at most a tenth of
the error of such models to the field: docs/theory/current_dependence.md."""
# Most terms of the expansion, and most terms up to the total degree _LOW_DEGREE. States solved per term, and tolerance
# of these solves.
_MOST_TERMS, _MOST_OF_LOW_DEGREE, _LOW_DEGREE = 170, 460, 12
_STATES_PER_TERM, _TOLERANCE = 2, 1e-4
# Work of such a solve, in the unit of `over_rows`.
_WORK = 20_000.0
# Total degrees of the first expansions. The solves for each expansion begin at the previous one.
_FIRST_DEGREES = (1, 3, 6)
# Tolerance of the first solve, in the middle of the domain.
_TOLERANCE_OF_MIDDLE = 1e-6


def compiled_model(model: ReducedModel, checked: bool) -> CompiledModel:
    """The arrays of a model, with an expansion fitted to its solutions by some hundreds of solves, in half a second at
    most. Iron with hysteresis has no expansion.

    checked: whether currents beyond the domain are refused. Raises NotConverged if Newton's method fails in the domain.
    """
    free = CompiledModel(
        _own(model.source),
        _own(model.fixed),
        _own(model.gradients, np.float32),
        _own(model.weights),
        _own(model.law),
        _own(model.law_offset),
        _own(model.law_knots),
        _own(model.law_coefficients),
        _own(model.air),
        _own(model.constant),
        _own(model.output),
        np.zeros((1, 3), np.int64),
        np.zeros((1, len(model.constant)), np.float32),
        compiled_domain(model.domain, False),
        _TOLERANCE_OF_MIDDLE,
        _own(model.pinning),
        _own(model.shares),
    )
    if model.remembers:
        # Solves begin at the memory of the iron.
        return free._replace(domain=compiled_domain(model.domain, checked), tolerance=COMPILED_TOLERANCE)
    domain, weights = model.domain, np.empty(field_count(free))
    state = CoreIron(core_numbers(free)).state()
    _check(state.solve(domain.middle, weights, tolerance=_TOLERANCE_OF_MIDDLE), domain.middle)
    known = free._replace(expansion=state.amplitudes[None].astype(np.float32))
    terms = expansion_terms(domain.parametrisation.signal_count)
    for degree in (*_FIRST_DEGREES, np.inf):
        # Solves that begin at an expansion of low degree take fewer steps.
        some = terms[degrees_of(terms) <= degree]
        shares = _spread(_STATES_PER_TERM * len(some), len(model.lower))
        signals = domain.parametrisation.within(domain.lower, domain.upper, shares)
        fitted = _fitted(known, some, domain.parametrisation.currents(signals), signals)
        known = known._replace(terms=some, expansion=fitted)
    return known._replace(domain=compiled_domain(domain, checked), tolerance=COMPILED_TOLERANCE)


def _spread(count: int, dimensions: int) -> Array:
    """Shares (count, dimensions) that fill a box evenly: multiples of the powers of 1 / x modulo 1, where x^(d + 1) is
    x + 1 (M. Roberts's extension of the golden ratio). scipy has such sequences, but takes a second to load."""
    x = 2.0
    for _ in range(60):
        x = (1.0 + x) ** (1.0 / (dimensions + 1))
    return np.asarray((np.arange(1, count + 1)[:, None] * x ** -np.arange(1.0, dimensions + 1)) % 1.0)


def _own(values: NDArray[Any], kind: type | None = None) -> NDArray[Any]:
    """A copy in C order, the only layout that compiled code takes."""
    return np.array(values, dtype=kind, order="C")


def compiled_domain(domain: CurrentDomain, checked: bool) -> SignalDomain:
    """The domain for compiled code. checked: whether currents outside are refused."""
    division, exponent, matrix = domain.parametrisation.kernel()
    beside = ROUNDING * (domain.upper - domain.lower)
    limit = getattr(domain.parametrisation, "limit", None)
    return SignalDomain(
        division,
        float(exponent),
        np.array(matrix, order="C"),
        np.array(np.linalg.pinv(matrix) if matrix.size else matrix.T, float, order="C"),
        np.array(domain.lower - beside),
        np.array(domain.upper + beside),
        np.inf if limit is None else float(limit) * (1.0 + ROUNDING),
        TOLERANCE,
        checked,
    )


def expansion_terms(signals: int) -> NDArray[np.int64]:
    """Terms (t, 3) of all products up to the highest total degree within the limits on their number."""
    chosen: list[tuple[int, ...]] = [(0,) * signals]
    for degree in range(1, 31):
        more = chosen + _of_degree(signals, degree)
        if len(more) > (_MOST_OF_LOW_DEGREE if degree <= _LOW_DEGREE else _MOST_TERMS):
            break
        chosen = more
    place = {powers: k for k, powers in enumerate(chosen)}
    terms = [(0, 0, 0)]
    for powers in chosen[1:]:
        last = max(j for j, power in enumerate(powers) if power)
        parent = (*powers[:last], *(0,) * (signals - last))
        terms.append((place[parent], last, powers[last]))
    return np.array(terms, dtype=np.int64)


def degrees_of(terms: NDArray[np.int64]) -> NDArray[np.int64]:
    """Total degree (t,) of each term."""
    found = np.zeros(len(terms), np.int64)
    for k, (before, _, degree) in enumerate(terms[1:], start=1):
        found[k] = found[before] + degree
    return found


def _of_degree(signals: int, degree: int) -> list[tuple[int, ...]]:
    """The degrees in each signal of all products of this total degree."""
    if signals == 1:
        return [(degree,)]
    return [(n, *rest) for n in range(degree + 1) for rest in _of_degree(signals - 1, degree - n)]


def _fitted(
    model: CompiledModel, terms: NDArray[np.int64], currents: Array, signals: Array
) -> NDArray[np.float32]:
    """Coefficients (t, r) of the expansion, fitted to the solutions at currents (s, c) of signals (s, d)."""
    core, rows = CoreIron(core_numbers(model)), np.ascontiguousarray(currents)
    amplitudes = np.empty((len(rows), len(model.constant)))

    def solve(start: int, stop: int) -> None:
        state, weights = core.state(), np.empty(field_count(model))
        for k in range(start, stop):
            # Each solve begins at the previous expansion, so that the states do not depend on their order.
            _check(state.solve(rows[k], weights, tolerance=_TOLERANCE, fresh=True), rows[k])
            amplitudes[k] = state.amplitudes

    over_rows(solve, len(rows), work=_WORK)
    products = products_of_terms(terms, signals, model.domain)
    return np.ascontiguousarray(np.linalg.lstsq(products, amplitudes, rcond=None)[0], dtype=np.float32)


def products_of_terms(terms: NDArray[np.int64], signals: Array, domain: SignalDomain) -> Array:
    """The values (s, t) of terms (t, 3), as in `CompiledModel`, at signals (s, d) of the domain."""
    width = domain.upper - domain.lower
    scaled = (
        np.divide(2.0 * (signals - domain.lower), width, out=np.ones_like(signals), where=width > 0.0) - 1.0
    )
    polynomials = chebvander(np.clip(scaled, -1.0, 1.0), int(terms[:, 2].max()))
    products = np.ones((len(signals), len(terms)))
    for k, (before, signal, degree) in enumerate(terms[1:], start=1):
        products[:, k] = products[:, before] * polynomials[:, signal, degree]
    return products


def _check(status: int, currents: Array) -> None:
    if status != FOUND:
        raise not_converged(currents, np.nan)


def not_converged(currents: Array, decrement: float) -> NotConverged:
    """The error for currents (c,) at which Newton's method fails."""
    return NotConverged(
        Problem(
            "reduced model of the iron",
            f"Newton's method must end within {MOST_STEPS} steps",
            f"a relative step of {decrement:.1e} at {currents.tolist()} A",
            "stay within the currents that the map was made for",
        ),
        residuals=(float(decrement),),
    )
