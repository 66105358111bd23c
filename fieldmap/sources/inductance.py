"""Inductances of windings in air, with uniform current density over their sections."""

import itertools
from collections.abc import Sequence

import numpy as np

from fieldmap.constants import MU0
from fieldmap.device.background import Background
from fieldmap.device.coils import Coil
from fieldmap.kernels.coils.neumann import neumann_sum
from fieldmap.parallel import results_of
from fieldmap.sources import line_currents
from fieldmap.sources.coils import unit_flux_density
from fieldmap.sources.winding_rules import WindingRule, current_elements, flux_elements
from fieldmap.typing import Array


def bare_inductance(coils: Sequence[Coil]) -> Array:
    """Inductance matrix of coils without iron, turns and polarity included.

    Self-inductance: flux of the closed-form field through the turns, docs/theory/forces.md (8). Mutual
    inductance: Neumann's double integral over both windings, (9); for loops and polylines the line integral of
    their vector potential. Good to about 1e-4.

    Parameters
    ----------
    coils
        The coils; windings must not overlap.

    Returns
    -------
    Array
        The matrix (c, c), H; symmetric.

    Raises
    ------
    InputError
        For a coil that has no self-inductance: loops and polylines without a wire_diameter, sheets, magpylib
        objects of other classes.

    Examples
    --------
    >>> from fieldmap.device.model import CircularCoil
    >>> brooks = CircularCoil("brooks", inner_radius=0.02, outer_radius=0.04, height=0.02, turns=1000)
    >>> print(f"{1e3 * bare_inductance([brooks])[0, 0]:.2f} mH")
    50.98 mH
    """
    matrix = np.zeros((len(coils), len(coils)))
    elements = [_elements(coil) for coil in coils] if len(coils) > 1 else []
    for k, coil in enumerate(coils):
        if coil.has_winding:
            rule = flux_elements(coil)
            matrix[k, k] = np.sum(unit_flux_density(coil, rule.points, digits=7) * rule.vectors)
        else:
            matrix[k, k] = line_currents.self_inductance(coil)
    pairs = list(itertools.combinations(range(len(coils)), 2))

    def mutual(pair: tuple[int, int]) -> float:
        j, k = pair
        return _mutual(coils[k], elements[k], coils[j], elements[j])

    for (j, k), found in zip(pairs, results_of(mutual, pairs), strict=True):
        matrix[k, j] = matrix[j, k] = found
    return matrix


def mutual_inductance(one: Coil, other: Coil) -> float:
    """The mutual inductance of a pair, as in `bare_inductance`."""
    return _mutual(other, _elements(other), one, _elements(one))


def _mutual(coil: Coil, elements: WindingRule, other: Coil, of_other: WindingRule) -> float:
    if line_currents.is_lines(coil):
        return _along(coil, of_other)
    if line_currents.is_lines(other):
        return _along(other, elements)
    return _neumann(elements, of_other)


def _elements(coil: Coil) -> WindingRule:
    return line_currents.line_elements(coil) if line_currents.is_lines(coil) else current_elements(coil)


def _along(lines: Coil, elements: WindingRule) -> float:
    """Line integral of the vector potential of a coil of lines along the currents of another."""
    return float(np.sum(line_currents.vector_potential(lines, elements.points) * elements.vectors))


def background_linkage(coils: Sequence[Coil], background: Background | None) -> Array:
    """Flux linkages (c,) in Wb of a background in air, turns and polarity included."""
    if background is None:
        return np.zeros(len(coils))
    rules = [
        flux_elements(coil) if coil.has_winding else line_currents.flux_elements_of_lines(coil)
        for coil in coils
    ]
    return np.array([float(np.sum(background.field(rule.points) * rule.vectors)) for rule in rules])


def _neumann(one: WindingRule, other: WindingRule) -> float:
    """mu0/(4 pi) times the double sum of dl . dl' / distance."""
    rows = (np.ascontiguousarray(each.T) for each in (one.points, one.vectors, other.points, other.vectors))
    return MU0 / (4 * np.pi) * neumann_sum(*rows)
