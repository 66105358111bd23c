"""How far an equilibrium moves with each coil's current: the implicit function theorem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_not_negative, check_positive
from fieldmap.device.model import Payload
from fieldmap.field import AnyField, require_bounds, resolve_currents
from fieldmap.levitation.balance import CURRENT_STEP, MagnetModel, check_position, magnet_balance
from fieldmap.lookup.payload import check_payload
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Record):
    """Derivatives of an equilibrium by the coil currents.

    position (3,), m, and currents (n_coils,), A: where. stiffness (3, 3), N/m; force_per_current (3, n_coils), N/A.
    at_held_height (2, n_coils), m/A: dx/di and dy/di while the height is held and nothing else reacts: what a disturbed
    current does, but for the vertical controller's own answer. with_lift_held (2, n_coils), m/A: the same where all
    currents are scaled besides so that the lift stays what it was: what remains once the controller has answered.
    level_per_current (n_coils,): by how much that scales them, 1/A. singular at a fold, where stiffness vanishes.
    """

    position: Array
    currents: Array
    stiffness: Array
    force_per_current: Array
    at_held_height: Array
    with_lift_held: Array
    level_per_current: Array

    def noise(self, deviation: ArrayLike, lift_held: bool = False) -> Array:
        """Covariance of x and y for noise of the currents that is slow enough for the magnet to follow.

        Parameters
        ----------
        deviation
            Independent standard deviations of the currents, a number or (n_coils,), A.
        lift_held
            Whether the lift is held.

        Returns
        -------
        Array
            Covariance (2, 2), m^2.
        """
        spread = np.broadcast_to(np.asarray(deviation, dtype=float), self.currents.shape)
        check_not_negative("Sensitivity.noise", deviation=float(spread.min()))
        by_current = self.with_lift_held if lift_held else self.at_held_height
        return np.asarray((by_current * spread**2) @ by_current.T)


def equilibrium_sensitivity(
    field: AnyField,
    currents: Any,
    payload: Payload | None,
    position: ArrayLike,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
    step: float | None = None,
) -> Sensitivity:
    """Derivatives of the horizontal equilibrium at a position by every coil's current.

    From F_h(x, i) = 0: dx_h/di = K_hh^-1 dF_h/di, and with the lift held besides by a common factor of the currents.

    Parameters
    ----------
    field
        Any `fieldmap.field.Field` with a box, which must hold at these currents.
    currents
        (n_coils,), A.
    payload
        What is levitated.
    position
        The magnet's centre (3,), m.
    moment, lever
        As in `magnet_balance`.
    step
        Change of each current, A, over plus and minus which forces are differenced; 1 % of the largest
        current unless given. Exact where the field is linear in the currents, of second order in the step
        where iron saturates.

    Returns
    -------
    Sensitivity
        The derivatives, m/A.

    Raises
    ------
    InputError
        For arguments that do not fit, or a position where the horizontal stiffness is singular.
    """
    carried = check_payload(payload, "equilibrium_sensitivity")
    source, amperes = resolve_currents(field, currents)
    point = check_position(require_bounds(source), position, "equilibrium_sensitivity(position)")
    width = CURRENT_STEP * float(np.abs(amperes).max()) if step is None else step
    check_positive("equilibrium_sensitivity", step=width)
    balance = magnet_balance(source, amperes, carried, point, moment, lever)
    stiffness = balance.stiffness(point)
    by_current = balance.force_per_signal(point, np.eye(len(amperes)), np.full(len(amperes), width))
    regular = abs(np.linalg.det(stiffness[:2, :2])) > 1e-10 * np.linalg.norm(stiffness) ** 2
    must = "the horizontal stiffness must not be singular: at a fold the equilibrium has no derivative"
    received = f"{stiffness[:2, :2].tolist()} N/m"
    remedy = "choose currents or a height away from the fold"
    check(regular, "equilibrium_sensitivity(position)", must, received, remedy)
    # The common factor 1 + s of all currents: d force / d s.
    by_level = by_current @ amperes
    matrix = np.zeros((3, 3))
    matrix[:, :2], matrix[:, 2] = stiffness[:, :2], -by_level
    held: Array = np.asarray(np.linalg.solve(matrix, by_current), dtype=float)
    horizontal = np.asarray(np.linalg.solve(stiffness[:2, :2], by_current[:2]), dtype=float)
    return Sensitivity(point, amperes, stiffness, by_current, horizontal, held[:2], held[2])
