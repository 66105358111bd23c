"""The magnetic body of a payload (dipoles of its magnets, and soft iron), and compiled functions for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.core.caller import caller
from fieldmap.errors import InputError, Problem
from fieldmap.field import AnyField
from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.finite_magnet import FiniteMagnet, finite_magnet, volume_rule
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.lookup.soft_body import soft_rule
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.device.payload import Magnet, Payload, SoftBody

_NONE = np.zeros((0, 3))


def magnetic_body(
    payload: Payload | Magnet | SoftBody,
    level: int | None = None,
    field: AnyField | None = None,
    tolerance: float = 1e-4,
    places: ArrayLike | None = None,
) -> MagneticBody:
    """The magnetic body of a payload, a magnet or a soft body, about its centre.

    A payload with a moment alone is a dipole along `Payload.direction`. If it has a shape and its own moment, such as a
    measured one, the rule of the shape is scaled to this moment.

    Parameters
    ----------
    payload
        The payload, magnet or soft body.
    level
        Order of the volume rule of each magnet (`volume_rule`); 1 is a point dipole at its centre. Unless given, the
        payload's `volume_level`, 3 for a shape alone.
    field
        Any field, for which `finite_magnet` then chooses the rules.
    tolerance
        Tolerance of this choice.
    places
        Centres (n, 3) of the payload for this choice, m; a field without a box needs them.

    Returns
    -------
    MagneticBody
        The body.

    Raises
    ------
    InputError
        For soft iron with only the name of a material, or a material that is no soft iron; and as for `finite_magnet`
        and `Payload.moment_vector`.
    NotConverged, OutsideMapError
        As for `finite_magnet`.

    Examples
    --------
    >>> from fieldmap.device.payload import MagnetCylinder, Payload, SoftSphere
    >>> pair = Payload(mass=0.01, pieces=[MagnetCylinder(0.01, 0.01, 1.3), SoftSphere(4e-3, mu_r=1e3)])
    >>> magnetic_body(pair).points.shape, magnetic_body(pair, level=1).points.shape
    ((36, 3), (1, 3))
    >>> round(magnetic_body(pair).moment, 4)
    0.8125
    """

    # Imported here, as in `_of_pieces`: maps are opened faster without the package of devices.
    from fieldmap.device.payload import Magnet, Payload, SoftBody

    if level is None:
        level = payload.volume_level if isinstance(payload, Payload) else Payload.volume_level

    def rule(shape: Magnet, arm: ArrayLike = (0.0, 0.0, 0.0)) -> FiniteMagnet:
        return (
            volume_rule(shape, level)
            if field is None
            else finite_magnet(shape, field, tolerance, places, arm)
        )

    if isinstance(payload, Magnet):
        return rule(payload)
    if isinstance(payload, SoftBody):
        return MagneticBody(_NONE, _NONE, soft=soft_rule(payload, Payload.soft_level))
    moment = payload.moment_vector
    if payload.pieces:
        return _of_pieces(payload, rule)
    if payload.magnet is not None and (level > 1 or field is not None):
        return _as_measured(rule(payload.magnet), float(moment[2]))
    return FiniteMagnet(np.zeros((1, 3)), moment[None, :])


def check_payload(payload: Payload | None, where: str, pieces: bool = False) -> Payload:
    """The payload, if its mass and moment are positive, or if it has allowed pieces. Raises InputError."""
    if payload is None:
        raise InputError.of(
            f"{where}(payload)", "must be a payload", "None", "add a [payload] table to the device file"
        )
    if payload.pieces and not pieces:
        must_hold = "must be one magnet or a moment here"
        remedy = "find_equilibrium, lift_current, currents_for, simulate and MuJoCo take payloads of pieces"
        raise InputError.of(f"{where}(payload.pieces)", must_hold, payload.description, remedy)
    needed = [("mass", payload.mass)] + ([] if payload.pieces else [("moment", payload.moment)])
    problems = [
        Problem(f"{where}(payload.{name})", "must be positive", f"{value}", f"give the payload a {name}")
        for name, value in needed
        if not (np.isfinite(value) and value > 0)
    ]
    if problems:
        raise InputError(*problems)
    return payload


def compiled_wrench(field_map: FieldMap, body: MagneticBody) -> tuple[Any, Any]:
    """Force and torque on a body, and their derivatives by the currents, for your own numba functions.

    inside = function(data, currents, place, turn, wrench, slopes) with float64 arrays: currents (n_coils,),
    A; place (3,), m, of the body's centre; turn (3, 3), columns its axes. It fills wrench (6,), N and N m,
    and slopes (6, n_coils), N/A and N m/A. It returns False and fills in NaN if the body leaves the box or
    the iron has no solution.

    Parameters
    ----------
    field_map
        Opened map.
    body
        The body.

    Returns
    -------
    tuple[Any, Any]
        (function, data). The data, as of `FieldMap.compiled`, are an argument or a global of your function, in this
        process only. With a map of saturating iron each thread needs its own.

    Raises
    ------
    InputError
        For a map with a table of currents, which has no slopes.

    Examples
    --------
    >>> function, data = compiled_wrench(m, magnetic_body(device.payload))                       # doctest: +SKIP
    """
    _require_no_table(field_map, "compiled_wrench")
    words = caller(field_map._evaluator.core(), field_map._weights_of_callers(), body.core)
    # Imported here: numba is needed only for compiled functions.
    from fieldmap.lookup.compiled import wrench_at

    return wrench_at, words


def compiled_linkages(field_map: FieldMap, body: MagneticBody | None = None) -> tuple[Any, Any]:
    """Flux linkages of the coils and their incremental inductances, for your own numba functions.

    known = function(data, currents, place, turn, linkages, inductance) with float64 arrays as for `compiled_wrench`. It
    fills linkages (n_coils,), Wb, as `FieldMap.flux_linkage`, and inductance (n_coils, n_coils), H, as
    `FieldMap.inductance`. It returns False and fills in NaN if the body leaves the box or the iron has no solution. The
    voltages that a moving body induces are slopes.T @ (velocity, angular velocity), with the slopes of
    `compiled_wrench`.

    Parameters
    ----------
    field_map
        Opened map with the flux linkages of its coils.
    body
        A payload whose linkages are added. Without one the function reads no place and no turn.

    Returns
    -------
    tuple[Any, Any]
        (function, data), as those of `compiled_wrench`.

    Raises
    ------
    InputError
        For a map without linkages, and for one with a table of currents.

    Examples
    --------
    >>> function, data = compiled_linkages(m, magnetic_body(device.payload))                     # doctest: +SKIP
    """
    _require_no_table(field_map, "compiled_linkages")
    of_body = None if body is None else body.core
    words = caller(
        field_map._evaluator.core(), field_map._weights_of_callers(), of_body, field_map._linkages()
    )
    from fieldmap.lookup.compiled import linkages_at

    return linkages_at, words


def _require_no_table(field_map: FieldMap, where: str) -> None:
    if field_map.current_table is not None:
        must_hold, remedy = "a map without a table of currents", "open it with tabulate_currents=False"
        raise InputError.of(f"{where}, field_map", must_hold, "one with a table", remedy)


def _as_measured(magnet: FiniteMagnet, moment: float) -> FiniteMagnet:
    """The rule of a shape, scaled from the moment of its remanence to a payload's own moment along z, A m^2."""
    share = moment / magnet.moment
    # A moment that follows from the shape differs by rounding alone.
    return magnet if abs(share - 1.0) < 1e-12 else replace(magnet, moments=share * magnet.moments)


def _of_pieces(payload: Payload, rule: Callable[[Magnet, ArrayLike], FiniteMagnet]) -> MagneticBody:
    from fieldmap.device.payload import Magnet, SoftBody

    points: list[Array] = [_NONE]
    moments: list[Array] = [_NONE]
    errors = []
    for piece in payload.pieces:
        if isinstance(piece.shape, Magnet):
            magnet, turn = (
                rule(piece.shape, piece.placement.position),
                np.asarray(piece.placement.rotation, dtype=float),
            )
            points.append(magnet.points @ turn.T + piece.placement.position)
            moments.append(magnet.moments @ turn.T)
            errors += [] if magnet.error is None else [magnet.error]
    soft = [
        soft_rule(one.shape, payload.soft_level, one.placement)
        for one in payload.pieces
        if isinstance(one.shape, SoftBody)
    ]
    error = max(errors) if errors else None
    return MagneticBody(np.concatenate(points), np.concatenate(moments), error, sum(soft, ()))
