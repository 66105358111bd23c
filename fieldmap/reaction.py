"""The iron's reaction to magnets: the field that iron makes because they magnetise it (docs/theory/reaction.md).

    w_k = sum m . b_k(x),   B = sum_k s_k w_k b_k,   energy -1/2 sum_k s_k w_k^2                         (1), (2), (3)

over the dipoles m at x that move together. A field that knows the reaction of its iron has it as `reaction`; what asks
it for forces then gets those of the reaction, too.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from fieldmap.typing import Array

# To moments that lie along the field: far more than it takes, unless the iron's field and that of others nearly cancel.
_MOST_STEPS = 300
IN_WORDS = "the iron's reaction to the magnets"
"""Begins what results say of it: "in", with how large it is, or "left out"."""


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
    """Signs (count,) of fields of which the last `repelled` count negatively."""
    return np.where(np.arange(count) < count - repelled, 1.0, -1.0)


def own_reaction(reaction: Reaction, points: Array, moments: Array) -> tuple[Array, Array]:
    """The reaction to single dipoles at the places of these dipoles.

    Parameters
    ----------
    reaction
        Of the iron.
    points
        Positions (n, 3), m.
    moments
        Moments (3,) or (n, 3), A m^2.

    Returns
    -------
    tuple[Array, Array]
        B (n, 3), T, and gradient (n, 3, 3), T/m: of the reaction to each dipole alone, which stays as it is.
    """
    flux, slope = reaction.fields(points)
    weights = reaction.signs[:, None] * np.einsum("kni,ni->kn", flux, np.broadcast_to(moments, points.shape))
    return np.einsum("kn,kni->ni", weights, flux), np.einsum("kn,knij->nij", weights, slope)


def own_force(reaction: Reaction, points: Array, moments: Array) -> Array:
    """The force of the reaction to bodies of dipoles on these bodies.

    Parameters
    ----------
    reaction
        Of the iron.
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
    """Moments of single dipoles that lie along the field of others and of the reaction to them: m || B + A m.

    From the field of others in steps each of which lowers the energy -m . B - m . A m / 2.

    Parameters
    ----------
    reaction
        Of the iron; none that it magnetises unless given.
    points
        Positions (n, 3), m.
    flux
        Flux density (n, 3), T, of others.
    magnitude
        Of the moments, A m^2.

    Returns
    -------
    Array
        Moments (n, 3), A m^2; zero where the field of others is: a dipole has no direction there.
    """

    def along(field: Array) -> Array:
        norm = np.linalg.norm(field, axis=-1, keepdims=True)
        return np.divide(magnitude * field, norm, out=np.zeros_like(field), where=norm > 0.0)

    moments = along(flux)
    if reaction is None:
        return moments
    fields, signs = reaction.fields(points)[0], reaction.signs
    # What repels is made up for along the moment itself, where it turns nothing: then no step overshoots.
    repelled = np.einsum("k,kni,kni->n", np.minimum(signs, 0.0), fields, fields)
    for _ in range(_MOST_STEPS):
        weights = signs[:, None] * np.einsum("kni,ni->kn", fields, moments)
        before = moments
        moments = along(flux + np.einsum("kn,kni->ni", weights, fields) - repelled[:, None] * moments)
        if not (np.abs(moments - before) > 1e-15 * magnitude).any():
            break
    return moments


def reaction_at_dipole(reaction: Reaction, point: Array, moment: Array) -> tuple[Array, Array, Array]:
    """The reaction to a dipole at its own place.

    Parameters
    ----------
    reaction
        Of the iron.
    point
        Position (3,), m.
    moment
        Moment (3,), A m^2.

    Returns
    -------
    tuple[Array, Array, Array]
        A m (3,), T; A (3, 3), T/(A m^2); and d(A m)_i/dx_l (3, 3), T/m, where dipole and place move together.
    """
    b, slope = (values[:, 0] for values in reaction.fields(point[None, :]))
    matrix = np.einsum("k,ki,kj->ij", reaction.signs, b, b)
    change = np.einsum("k,ki,kjl,j->il", reaction.signs, b, slope, moment)
    change += np.einsum("k,k,kil->il", reaction.signs, b @ moment, slope)
    return matrix @ moment, matrix, change


def own_slopes(reaction: Reaction, point: Array, moment: Array, turning: Array) -> Array:
    """Derivatives by the place of the force of the reaction to a dipole on this dipole: (4) with a moment that follows.

    Parameters
    ----------
    reaction
        Of the iron.
    point
        Position (3,), m.
    moment
        Moment (3,), A m^2.
    turning
        dm_i/dx_j (3, 3), A m, zero for a moment that is fixed.

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
