"""Modes of solved states: proper orthogonal decomposition, and the few fields that the modes make in the workspace."""

from collections.abc import Callable

import numpy as np

from fieldmap.typing import Array

# Directions whose share of the energy is below rounding.
_NEGLIGIBLE = 1e-13


def proper_modes(states: Array, apply: Callable[[Array], Array], most: int) -> Array:
    """At most `most` orthonormal modes (n, r) that hold the largest share of the energy of `states` (n, s).

    apply(x (n, s)) is the symmetric positive operator of the energy product. Sirovich, Quart. Appl. Math. 45 (1987)
    561: the method of snapshots.
    """
    gram = states.T @ apply(states)
    values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    order = np.argsort(values)[::-1][:most]
    order = order[values[order] > _NEGLIGIBLE * values[order[0]]]
    return np.asarray(states @ (vectors[:, order] / np.sqrt(values[order])))


def output_fields(amplitudes: Array, fields: Array, most: int) -> tuple[Array, Array]:
    """Combinations of the modes whose fields are enough for all states: `combination` (k, r) and `weights` (k, r).

    amplitudes (s, r) of the states, fields (r, m) of the modes at m numbers of interest. Field j is
    combination[j] @ fields; a state of amplitudes a has the field sum_j (weights @ a)_j field_j, up to the k + 1st
    singular value of the states' fields. Every weight is of order one at the largest state.
    """
    count, modes = amplitudes.shape
    values, vectors = np.linalg.eigh(amplitudes.T @ amplitudes / count)
    values = np.maximum(values, 1e-16 * values[-1])
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    left, singular, _ = np.linalg.svd(root @ fields, full_matrices=False)
    k = min(most, modes, int((singular > 1e-12 * singular[0]).sum()))
    combination = (left[:, :k] / singular[:k]).T @ root
    weights = (inverse @ left[:, :k] * singular[:k]).T
    scale = np.abs(amplitudes @ weights.T).max(axis=0)
    return combination * scale[:, None], weights / scale[:, None]
