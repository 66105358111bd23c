"""The iron's reaction to magnets in the workspace: the field of iron that a magnet has magnetised.

A few fields b_k of charges on the iron's surface span the reaction, with signs s_k: docs/theory/reaction.md (1) to (3).

The fields b_k follow from dipoles on the surface of the workspace. The dipoles' fields at the iron span the fields of
all sources inside; a pivoted QR factorisation of these fields leaves out redundant dipoles. The iron is solved for each
remaining dipole, and b is the sum of the dipoles' reactions times eigenvectors of W over the roots of its eigenvalues
(Nystroem's method), where W is the matrix of mutual reactions. W is symmetric up to the discretisation error.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, qr

from fieldmap.constants import MU0
from fieldmap.device.parts import FieldSensor
from fieldmap.field import STEP
from fieldmap.iron.elements.potential_form import Magnetised
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.reaction import signs_of
from fieldmap.records import Record
from fieldmap.typing import Array, Index

TOLERANCE = 1e-4
"""Tolerance of the solves for single dipoles. The reaction changes by less (drive unit, eight coils: 5e-5)."""

# Places of dipoles along every edge of the box. Dipoles are redundant below this pivot of QR, relative to the first.
_PER_EDGE, _SPANNED = 6, 3e-3
# Most faces of the iron at which the dipoles' fields are compared.
_FACES = 1000
# Relative. Places and directions that differ by less are the same.
_SAME = 1e-6
# Dipoles with their images are taken up to this multiple of the number of dipoles that spans the fields.
_MORE = 1.5
# Dipoles that are solved together, a bound on the memory of their Krylov spaces.
_AT_ONCE = 24
# Random places in the box for the choice of the number of fields, and as many others for the error. Most fields.
_PLACES, _MOST = 2, 64
_SEED = 58


@dataclass(frozen=True, eq=False, repr=False)
class _FieldsOfIron(Record):
    """Fields of charge densities (k, s) on faces, T per unit of the source that magnetises the iron."""

    faces: ChargedFaces
    charge: Array

    def fields(self, points: Array) -> tuple[Array, Array]:
        """The fields at points.

        Parameters
        ----------
        points
            Positions (n, 3) in the air, m.

        Returns
        -------
        tuple[Array, Array]
            Flux densities (k, n, 3) and their gradients dB_i/dx_j (k, n, 3, 3), per m.
        """
        return self.faces.field_and_gradient(points, self.charge)


@dataclass(frozen=True, eq=False, repr=False)
class ReactionFields(_FieldsOfIron):
    """Fields b_k in the workspace, of charge densities (k, s) on faces, T/sqrt(J).

    repelled: number of fields, the last ones, with the sign s_k = -1. dipoles: number of dipoles and images from which
    the fields were made. asymmetry: largest difference of the reactions of two dipoles on each other, over the largest
    reaction. error: relative error of the reaction to a dipole at its own place, or of the force on the dipole, the
    larger: the largest at places without a part in the choice of the fields. It is due to too few fields, not to the
    mesh. width: largest edge of the iron's triangles over its distance from the workspace. change: the same error of
    these fields for saturating iron in other states, the largest of all that were tried.
    """

    repelled: int
    dipoles: int
    asymmetry: float
    error: float
    width: float
    change: float = 0.0

    @property
    def signs(self) -> Array:
        """Signs s (k,)."""
        return signs_of(len(self.charge), self.repelled)

    def second_gradient(self, points: Array) -> Array:
        """The second derivatives of the fields, by central differences of their gradients.

        Parameters
        ----------
        points
            Positions (n, 3) in the air, m.

        Returns
        -------
        Array
            d2b_i/dx_j dx_k (k, n, 3, 3, 3).
        """
        where, count = np.atleast_2d(points), len(self.charge)
        steps = STEP * np.eye(3)
        shifted = np.concatenate([where + steps[:, None], where - steps[:, None]]).reshape(-1, 3)
        slopes = self.fields(shifted)[1].reshape(count, 2, 3, len(where), 3, 3)
        return np.moveaxis(slopes[:, 0] - slopes[:, 1], 1, -1) / (2.0 * STEP)


@dataclass(frozen=True, eq=False, repr=False)
class DipoleAnswers(_FieldsOfIron):
    """The fields of iron magnetised by each of k dipoles of 1 A m^2: charge densities (k, s) on faces, T/(A m^2).

    The answer to a dipole in a sensor's place, along its axis, gives by reciprocity the sensor's reading of the iron's
    reaction to a magnet: the magnet's moment times the answer at the magnet (docs/field_sensors.md).
    """


def answers_to_sensors(
    solve: Magnetised, faces: ChargedFaces, sensors: Sequence[FieldSensor]
) -> DipoleAnswers:
    """The answers of iron to dipoles in the places of sensors, along their axes.

    Parameters
    ----------
    solve
        Solves the iron: linear iron, or saturating iron linearised about a state.
    faces
        The faces of the iron.
    sensors
        The sensors, at least one; they lie in the air.

    Returns
    -------
    DipoleAnswers
        The answers, in the order of the sensors.

    Raises
    ------
    NotConverged
        If the iron cannot be solved.
    """
    dipoles = _Dipoles(
        *(np.array([getattr(one, name) for one in sensors]) for name in ("position", "direction"))
    )
    return DipoleAnswers(faces, MU0 * _solved(solve, dipoles))


@dataclass(frozen=True, eq=False, repr=False)
class Image(Record):
    """x -> matrix @ x + offset maps the iron onto itself, and face k onto face faces[k]."""

    matrix: Array
    offset: Array
    faces: Index

    def keeps(self, lower: Array, upper: Array) -> bool:
        """Whether the operation maps a box onto itself."""
        corners = np.stack([lower, upper]) @ self.matrix.T + self.offset
        size = np.linalg.norm(upper - lower)
        return bool(np.abs(np.sort(corners, axis=0) - [lower, upper]).max() < _SAME * size)


def reaction_fields(
    solve: Magnetised,
    faces: ChargedFaces,
    box: tuple[Array, Array],
    share: float = 2e-3,
    others: Iterable[Magnetised] = (),
    images: Sequence[Image] = (),
) -> ReactionFields | None:
    """The fields that span the reaction of iron to magnets in a box.

    Parameters
    ----------
    solve
        Solves the iron: linear iron, or saturating iron linearised about a state.
    faces
        The faces of the iron.
    box
        Lower and upper corner (3,) of the workspace, m; it holds no iron.
    share
        Wanted relative error of the reaction to dipoles on the surface of the box, and of the forces on them.
    others
        The same iron in other states, for `ReactionFields.change`.
    images
        Operations that map the iron, in this state, onto itself: the reaction to the image of a dipole is the image of
        the reaction.

    Returns
    -------
    ReactionFields | None
        The fields. Their error is larger than `share` where the mesh allows no less. None for iron as permeable as air,
        such as magnets of recoil permeability 1.

    Raises
    ------
    NotConverged
        If the iron cannot be solved.
    """
    lower, upper = (np.asarray(corner, dtype=np.float64) for corner in box)
    wanted = _spanning(_shell(lower, upper), faces)
    chosen, charge = _with_images(solve, wanted, [image for image in images if image.keeps(lower, upper)])
    flux, slope = faces.field_and_gradient(chosen.points, charge)
    mutual = np.einsum("sni,ni->ns", flux, chosen.axes)
    if not mutual.any():
        return None
    values, vectors = eigh(0.5 * (mutual + mutual.T))
    order = np.argsort(-np.abs(values))[:_MOST]
    # Smaller eigenvalues are rounding.
    order = order[np.abs(values[order]) > 1e-9 * np.abs(values[order[0]])]
    values = values[order]
    shapes = vectors[:, order] / np.sqrt(np.abs(values))
    signs = np.sign(values)
    places = lower + np.random.default_rng(_SEED).random((2 * _PLACES, 3)) * (upper - lower)
    tried, here = _Dipoles.along_all_axes(places), np.repeat(np.arange(2 * _PLACES), 3)
    charges = np.sqrt(MU0) * shapes.T @ charge
    fields = [values[:, here] for values in faces.field_and_gradient(places, charges)]

    def missed(of: Magnetised, count: int) -> Array:
        solved = faces.field_and_gradient(places, MU0 * _solved(of, tried))
        flux, slope = (values[range(len(here)), here] for values in solved)
        own = _Own.of(tried, flux, slope, upper - lower)
        return own.missed(signs[:count], *(values[:count] for values in fields))

    own = _Own.of(chosen, np.einsum("nni->ni", flux), np.einsum("nnij->nij", slope), upper - lower)
    spanned = (np.einsum("sk,s...->k...", shapes, values, optimize=True) for values in (flux, slope))
    of_places = missed(solve, len(signs))
    seen, unseen = np.hsplit(of_places, 2)
    errors = np.hstack([own.missed(signs, *spanned), seen]).max(axis=1)
    enough = np.flatnonzero(errors <= share)
    count = 1 + int(enough[0] if len(enough) else errors.argmin())
    by_sign = np.argsort(-signs[:count], kind="stable")
    return ReactionFields(
        faces,
        np.ascontiguousarray(charges[:count][by_sign]),
        int((signs[:count] < 0).sum()),
        len(chosen.points),
        float(np.abs(mutual - mutual.T).max() / np.abs(mutual).max()),
        float(unseen[count - 1].max()),
        _width(faces, lower, upper),
        max((float(missed(other, count)[-1].max()) for other in others), default=0.0),
    )


@dataclass(frozen=True, eq=False, repr=False)
class _Own(Record):
    """The reaction to each of n dipoles at its own place: axes, flux density and force (n, 3); size (n,) to which
    errors of the force are relative."""

    axes: Array
    flux: Array
    force: Array
    size: Array

    @classmethod
    def of(cls, dipoles: _Dipoles, flux: Array, slope: Array, room: Array) -> _Own:
        """From flux density (n, 3) and gradient (n, 3, 3) at the dipoles. room: edges of the box. Symmetry may leave no
        force: the size is the force, or the energy over the box's diagonal if that is larger."""
        force = np.einsum("ni,nij->nj", dipoles.axes, slope)
        energy = np.linalg.norm(flux, axis=1) / np.linalg.norm(room)
        return cls(dipoles.axes, flux, force, np.maximum(np.linalg.norm(force, axis=1), energy))

    def missed(self, signs: Array, fields: Array, gradients: Array) -> Array:
        """Relative errors (k, n) of flux density or force, the larger, with the first of fields (k, n, 3), the first
        two, and so on."""
        weights = signs[:, None] * np.einsum("kni,ni->kn", fields, self.axes)
        flux = np.cumsum(weights[..., None] * fields, axis=0) - self.flux
        force = np.cumsum(np.einsum("kn,ni,knij->knj", weights, self.axes, gradients, optimize=True), axis=0)
        of_flux = np.linalg.norm(flux, axis=2) / np.linalg.norm(self.flux, axis=1)
        return np.asarray(np.maximum(of_flux, np.linalg.norm(force - self.force, axis=2) / self.size))


@dataclass(frozen=True, eq=False, repr=False)
class _Dipoles(Record):
    """Dipoles at points (n, 3) along unit vectors (n, 3); mu0 times their moment is 1 T m^3."""

    points: Array
    axes: Array

    @classmethod
    def along_all_axes(cls, points: Array) -> _Dipoles:
        return cls(np.repeat(points, 3, axis=0), np.tile(np.eye(3), (len(points), 1)))

    def part(self, of: Index | slice) -> _Dipoles:
        return _Dipoles(self.points[of], self.axes[of])

    def potentials(self, x: Array) -> Array:
        """Potentials (n, m), T m, at points x (m, 3)."""
        offset = x - self.points[:, None]
        square = np.einsum("nmi,nmi->nm", offset, offset)
        return np.einsum("nmi,ni->nm", offset, self.axes) / (4.0 * np.pi * square * np.sqrt(square))

    def flux_densities(self, x: Array) -> Array:
        """Flux densities (n, m, 3), T, at points x (m, 3)."""
        offset = x - self.points[:, None]
        square = np.einsum("nmi,nmi->nm", offset, offset)
        along = 3.0 * np.einsum("nmi,ni->nm", offset, self.axes) / square
        scale = 1.0 / (4.0 * np.pi * square * np.sqrt(square))
        return (along[..., None] * offset - self.axes[:, None]) * scale[..., None]


def _width(faces: ChargedFaces, lower: Array, upper: Array) -> float:
    """Largest edge of a triangle, taken as equilateral, over its distance from a box."""
    beyond = np.maximum(lower - faces.centres, faces.centres - upper)
    distance = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return float(np.sqrt(4.0 / np.sqrt(3.0) * (faces.areas / np.maximum(distance, 1e-12) ** 2).max()))


def _shell(lower: Array, upper: Array) -> Array:
    """Points (n, 3) on the surface of a box."""
    shares = np.linspace(0.0, 1.0, _PER_EDGE)
    mesh = np.stack(np.meshgrid(shares, shares, shares, indexing="ij"), axis=-1).reshape(-1, 3)
    on_surface = ((mesh == 0.0) | (mesh == 1.0)).any(axis=1)
    return np.asarray(lower + mesh[on_surface] * (upper - lower))


def _spanning(candidates: Array, faces: ChargedFaces) -> _Dipoles:
    """Dipoles whose normal fields at the iron span the fields of dipoles at all candidates (n, 3), by pivoted QR."""
    few = faces.part(np.arange(0, len(faces.areas), 1 + len(faces.areas) // _FACES))
    dipoles = _Dipoles.along_all_axes(candidates)
    rows = [
        np.einsum("nmi,mi->nm", part.flux_densities(few.centres), few.normals) for part in _parts(dipoles)
    ]
    _, factor, order = qr((np.concatenate(rows) * np.sqrt(few.areas)).T, mode="economic", pivoting=True)
    left = np.abs(np.diagonal(factor))
    return dipoles.part(order[: len(left)][left > _SPANNED * left[0]])


def _with_images(solve: Magnetised, wanted: _Dipoles, images: Sequence[Image]) -> tuple[_Dipoles, Array]:
    """The first of the wanted dipoles, with their images, until there are `_MORE` times as many as wanted, and the
    charge densities for each. One dipole of each set of images is solved."""
    size = np.abs(wanted.points).max()
    taken: list[tuple[int, Array, Array, Index | None, float]] = []
    solved: list[int] = []
    for k, (point, axis) in enumerate(zip(wanted.points, wanted.axes, strict=True)):
        if len(taken) >= _MORE * len(wanted.points):
            break
        first = len(taken)
        for image in (None, *images):
            place, along, faces = point, axis, None
            if image is not None:
                place, along, faces = image.matrix @ point + image.offset, image.matrix @ axis, image.faces
            # A dipole along -x is a dipole along x times -1.
            sign = float(np.sign(along[np.abs(along).argmax()]))
            near = (
                np.abs(place - x).max() < _SAME * size and abs(along @ a) > 1.0 - _SAME
                for _, x, a, *_ in taken
            )
            if not any(near):
                taken.append((len(solved), place, sign * along, faces, sign))
        solved += [k] if len(taken) > first else []
    of_solved = _solved(solve, wanted.part(np.array(solved)))
    charge = np.empty((len(taken), of_solved.shape[1]))
    for row, (number, _, _, faces, sign) in zip(charge, taken, strict=True):
        row[slice(None) if faces is None else faces] = sign * of_solved[number]
    return _Dipoles(np.array([one[1] for one in taken]), np.array([one[2] for one in taken])), charge


def _solved(solve: Magnetised, dipoles: _Dipoles) -> Array:
    """Charge densities (n, s) for every dipole."""
    return np.concatenate([solve(part.potentials) for part in _parts(dipoles)])


def _parts(dipoles: _Dipoles) -> list[_Dipoles]:
    return [dipoles.part(slice(k, k + _AT_ONCE)) for k in range(0, len(dipoles.points), _AT_ONCE)]
