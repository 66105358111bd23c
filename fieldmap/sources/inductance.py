"""Inductances of windings in air, with uniform current density over their sections."""

from collections.abc import Sequence

import numpy as np
from scipy.constants import mu_0
from scipy.spatial.distance import cdist

from fieldmap.device.background import Background
from fieldmap.device.coils import Coil
from fieldmap.sources.coils import unit_flux_density
from fieldmap.sources.winding_rules import WindingRule, current_elements, flux_elements
from fieldmap.typing import Array

# Rows of the table of distances between two windings that are in memory at once.
_ROWS = 500


def bare_inductance(coils: Sequence[Coil]) -> Array:
    """Inductance matrix (c, c) in H of coils without iron, turns and polarity included; symmetric.

    Self-inductance: flux of the closed-form field through the turns, docs/theory/forces.md (8). Mutual inductance:
    Neumann's double integral over both windings, (9). Good to about 1e-4; windings must not overlap.

    >>> from fieldmap.device.model import CircularCoil
    >>> brooks = CircularCoil("brooks", inner_radius=0.02, outer_radius=0.04, height=0.02, turns=1000)
    >>> print(f"{1e3 * bare_inductance([brooks])[0, 0]:.2f} mH")
    50.98 mH
    """
    matrix = np.zeros((len(coils), len(coils)))
    elements = [current_elements(coil) for coil in coils] if len(coils) > 1 else []
    for k, coil in enumerate(coils):
        rule = flux_elements(coil)
        matrix[k, k] = np.sum(unit_flux_density(coil, rule.points, digits=7) * rule.vectors)
        for j in range(k):
            matrix[k, j] = matrix[j, k] = _neumann(elements[k], elements[j])
    return matrix


def background_linkage(coils: Sequence[Coil], background: Background | None) -> Array:
    """Flux linkages (c,) in Wb that a background adds in air, turns and polarity included."""
    if background is None:
        return np.zeros(len(coils))
    rules = [flux_elements(coil) for coil in coils]
    return np.array([float(np.sum(background.field(rule.points) * rule.vectors)) for rule in rules])


def _neumann(one: WindingRule, other: WindingRule) -> float:
    """mu0/(4 pi) times the double sum of dl . dl' / distance."""
    total = 0.0
    for start in range(0, len(one.points), _ROWS):
        rows = slice(start, start + _ROWS)
        potential = (1 / cdist(one.points[rows], other.points)) @ other.vectors
        total += float(np.sum(potential * one.vectors[rows]))
    return mu_0 / (4 * np.pi) * total
