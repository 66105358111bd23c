"""The iron's reaction to magnets: the field of iron that the magnets magnetise (docs/theory/reaction.md).

    w_k = sum m . b_k(x),   B = sum_k s_k w_k b_k,   energy -1/2 sum_k s_k w_k^2                         (1), (2), (3)

with sums over the dipoles m at x that move together. A field with a known reaction of its iron has it as `reaction`,
and its forces on magnets include the reaction.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from fieldmap.typing import Array

# Limit of the iteration for aligned moments. Far fewer steps suffice unless reaction and external field nearly cancel.
_MOST_STEPS = 300
IN_WORDS = "the iron's reaction to the magnets"
"""Beginning of lines in results, which go on with "in" and the size of the reaction, or with "left out"."""


class Reaction(Protocol):
    """Fields b_k, T/sqrt(J), that span the iron's reaction, with signs s_k (k,), 1 or -1."""

    @property
    def signs(self) -> Array:
        """Signs (k,)."""

    def fields(self, points: Array) -> tuple[Array, Array]:
        """The fields at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        tuple[Array, Array]
            b (k, n, 3), T/sqrt(J), and db_i/dx_j (k, n, 3, 3).
        """

    def second_gradient(self, points: Array) -> Array:
        """The second derivatives of the fields at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        Array
            d2b_i/dx_j dx_k (k, n, 3, 3, 3).
        """


def signs_of(count: int, repelled: int) -> Array:
    """Signs (count,): -1 for the last `repelled` fields, 1 for the others."""
    return np.where(np.arange(count) < count - repelled, 1.0, -1.0)


def own_reaction(reaction: Reaction, points: Array, moments: Array) -> tuple[Array, Array]:
    """The reaction to each of several single dipoles at the position of that dipole.

    Parameters
    ----------
    reaction
        Reaction of the iron.
    points
        Positions (n, 3), m.
    moments
        Moments (3,) or (n, 3), A m^2.

    Returns
    -------
    tuple[Array, Array]
        B (n, 3), T, and its gradient (n, 3, 3), T/m, with the magnetisation of the iron held fixed.
    """
    flux, slope = reaction.fields(points)
    weights = reaction.signs[:, None] * np.einsum("kni,ni->kn", flux, np.broadcast_to(moments, points.shape))
    return np.einsum("kn,kni->ni", weights, flux), np.einsum("kn,knij->nij", weights, slope)


def own_force(reaction: Reaction, points: Array, moments: Array) -> Array:
    """Force on bodies of dipoles, each from the reaction of the iron to that body.

    Parameters
    ----------
    reaction
        Reaction of the iron.
    points
        Positions (n, q, 3) of the q dipoles of n bodies, m.
    moments
        Moments (n, q, 3), A m^2.

    Returns
    -------
    Array
        Force (n, 3), N.
    """
    n, q, _ = points.shape
    flux, slope = reaction.fields(points.reshape(-1, 3))
    weights = np.einsum("knqi,nqi->kn", flux.reshape(-1, n, q, 3), moments)
    pull = np.einsum("knqij,nqi->knj", slope.reshape(-1, n, q, 3, 3), moments)
    return np.einsum("k,kn,knj->nj", reaction.signs, weights, pull)


def aligned_moments(reaction: Reaction | None, points: Array, flux: Array, magnitude: float) -> Array:
    """Moments of single dipoles along the sum of the external field and of the reaction to the dipole: m || B + A m.

    The iteration starts along the external field. Each step lowers the energy -m . B - m . A m / 2.

    Parameters
    ----------
    reaction
        Reaction of the iron; None without one.
    points
        Positions (n, 3), m.
    flux
        External flux density (n, 3), T.
    magnitude
        Magnitude of the moments, A m^2.

    Returns
    -------
    Array
        Moments (n, 3), A m^2; zero where the external field is zero, because the direction is undefined there.
    """

    def along(field: Array) -> Array:
        norm = np.linalg.norm(field, axis=-1, keepdims=True)
        return np.divide(magnitude * field, norm, out=np.zeros_like(field), where=norm > 0.0)

    moments = along(flux)
    if reaction is None:
        return moments
    fields, signs = reaction.fields(points)[0], reaction.signs
    # A multiple of the moment makes A positive semidefinite. It does not turn the moment, and no step overshoots.
    repelled = np.einsum("k,kni,kni->n", np.minimum(signs, 0.0), fields, fields)
    for _ in range(_MOST_STEPS):
        weights = signs[:, None] * np.einsum("kni,ni->kn", fields, moments)
        before = moments
        moments = along(flux + np.einsum("kn,kni->ni", weights, fields) - repelled[:, None] * moments)
        if not (np.abs(moments - before) > 1e-15 * magnitude).any():
            break
    return moments


def reaction_at_dipole(reaction: Reaction, point: Array, moment: Array) -> tuple[Array, Array, Array]:
    """The reaction to a dipole at the position of the dipole.

    Parameters
    ----------
    reaction
        Reaction of the iron.
    point
        Position (3,), m.
    moment
        Moment (3,), A m^2.

    Returns
    -------
    tuple[Array, Array, Array]
        A m (3,), T; A (3, 3), T/(A m^2); and d(A m)_i/dx_l (3, 3), T/m, as the dipole moves.
    """
    b, slope = (values[:, 0] for values in reaction.fields(point[None, :]))
    matrix = np.einsum("k,ki,kj->ij", reaction.signs, b, b)
    change = np.einsum("k,ki,kjl,j->il", reaction.signs, b, slope, moment)
    change += np.einsum("k,k,kil->il", reaction.signs, b @ moment, slope)
    return matrix @ moment, matrix, change


def own_slopes(reaction: Reaction, point: Array, moment: Array, turning: Array) -> Array:
    """Derivatives by position of a dipole's force from the reaction to that dipole: (4) with a moment that turns.

    Parameters
    ----------
    reaction
        Reaction of the iron.
    point
        Position (3,), m.
    moment
        Moment (3,), A m^2.
    turning
        dm_i/dx_j (3, 3), A m; zero for a fixed moment.

    Returns
    -------
    Array
        dF_i/dx_j (3, 3), N/m.
    """
    flux, slope = (values[:, 0] for values in reaction.fields(point[None, :]))
    pull = np.einsum("kij,i->kj", slope, moment)
    second = np.einsum("kijl,i->kjl", reaction.second_gradient(point[None, :])[:, 0], moment)
    second += np.einsum("kij,il->kjl", slope, turning)
    signs, moved = reaction.signs, pull + flux @ turning
    return np.asarray(np.einsum("k,kjl->jl", signs * (flux @ moment), second) + (signs * pull.T) @ moved)
