"""Flux linkages of the coils with a payload, and the voltages that a moving payload induces.

The co-energy of coils, iron and payload has the term m . B of the payload's moments in the field B. Its derivatives by
the currents are the linkages, and by place and rotation force and torque: docs/theory/flux_linkage.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_vector
from fieldmap.field import AnyField, as_field
from fieldmap.lookup.actuation import derivatives_by_currents, wrench_actuation
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.typing import Array

_REMEDY = "give x, y, z in the frame of the field"


def payload_linkage(
    field: AnyField,
    position: ArrayLike,
    currents: Any,
    moment: ArrayLike | MagneticBody,
    orientation: ArrayLike | None = None,
) -> Array:
    """Flux linkages of the coils with a payload: the sum of m . dB/dI over its moments.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    position
        Position (3,) in the frame of the field, m.
    currents
        Currents, A: (n_coils,), one number for all coils, or a mapping by name.
    moment
        Moment of a dipole (3,), A m^2, or a `MagneticBody`.
    orientation
        Rotation (3, 3) of a body, with its axes as columns; upright unless given.

    Returns
    -------
    Array
        Flux linkages (n_coils,), Wb, all turns of each coil.

    Raises
    ------
    OutsideMapError
        For a place outside the field.
    InputError
        For a field that neither superposes nor has derivatives by its currents.
    """
    source = as_field(field)
    body = moment if isinstance(moment, MagneticBody) else MagneticBody.dipole(moment)
    place = check_vector("payload_linkage(position)", position, _REMEDY)
    arms, moments = body.dipoles(source, place[None], currents, orientation)
    by_flux = derivatives_by_currents(source, place + arms[0], currents)[0]
    return np.asarray(np.einsum("qni,qi->n", by_flux, moments[0]))


def back_emf(
    field: AnyField,
    position: ArrayLike,
    currents: Any,
    moment: ArrayLike | MagneticBody,
    velocity: ArrayLike,
    angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
    orientation: ArrayLike | None = None,
) -> Array:
    """Voltages that the motion of a payload induces in the coils at constant currents.

    They are the rates of the flux linkages, V = R i + d(linkage)/dt. The derivative of a linkage by the place equals
    the derivative of the force by the current.

    Parameters
    ----------
    field, position, currents, moment, orientation
        As for `payload_linkage`.
    velocity
        Velocity of the position (3,), m/s.
    angular_velocity
        (3,), rad/s, in the frame of the field.

    Returns
    -------
    Array
        Voltages (n_coils,), V.

    Raises
    ------
    OutsideMapError, InputError
        As for `payload_linkage`.
    """
    given = {"velocity": velocity, "angular_velocity": angular_velocity}
    twist = [check_vector(f"back_emf({name})", values, _REMEDY) for name, values in given.items()]
    rows = wrench_actuation(field, position, moment, currents, orientation).matrix
    return np.asarray(np.concatenate(twist) @ rows)
