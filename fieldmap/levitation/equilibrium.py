"""Search for the point at which the magnetic force carries the weight."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.device.model import Payload
from fieldmap.errors import InputError, Problem
from fieldmap.levitation.balance import Balance
from fieldmap.levitation.checks import check_currents, check_payload, check_position
from fieldmap.levitation.interface import LevitationField
from fieldmap.levitation.result import Equilibrium, SearchReport
from fieldmap.levitation.search import best_starts, no_equilibrium, roots, search_grid
from fieldmap.typing import Array


def find_equilibrium(
    field_map: LevitationField,
    currents: ArrayLike,
    payload: Payload | None,
    start: ArrayLike | None = None,
    moment: Literal["fixed", "aligned"] = "fixed",
) -> Equilibrium:
    """Find where the force on a point dipole balances its weight, F(x) + m g = 0, inside the field's box.

    field_map: an opened map, or anything with `field`, `gradient`, `second_gradient`, `coil_names`, `lower`
    and `upper` (`LevitationField`). currents (n_coils,), A. payload: mass and moment are used. start (3,),
    m: where to begin; without it the whole box is searched and, of several equilibria, the one with most
    stable directions nearest to the box's vertical axis is returned (the rest are in `.others`). moment:
    "fixed" keeps the moment vertical, turned so that it is pulled up at the start; "aligned" lets it follow
    B. Returns an `Equilibrium`: SI units, frame of the map; see docs/theory/equilibrium.md for the
    equations.

    Raises InputError for currents or a start that do not fit the map, NoEquilibrium (with the lift that is
    available) when nothing balances.

    Example::

        m = fieldmap.open_map("maps/out/workspace.h5")
        payload = fieldmap.read_device("drive_unit").payload
        e = fieldmap.find_equilibrium(m, currents=[2.4] * 6, payload=payload)
        print(e.position, e.stable_axes)
    """
    carried = check_payload(payload, "find_equilibrium")
    amperes = check_currents(field_map, currents, "find_equilibrium")
    if moment not in ("fixed", "aligned"):
        raise InputError(
            Problem("find_equilibrium(moment)", "must be 'fixed' or 'aligned'", repr(moment), "choose one")
        )
    begin = None if start is None else check_position(field_map, start, "find_equilibrium(start)")
    grid = search_grid(field_map)
    balance = _balance(field_map, amperes, carried, moment, grid if begin is None else begin[None, :])
    residuals = balance.residual(grid)
    starts = best_starts(grid, np.linalg.norm(residuals, axis=1), field_map)
    found: list[Array] = []
    tried = 0
    if begin is not None:
        tried, found = 1, roots(balance, field_map, begin[None, :])
    if not found:
        tried, found = tried + len(starts), roots(balance, field_map, starts)
    if not found:
        raise no_equilibrium(balance, grid, residuals, tried)
    return _result(balance, field_map, found, begin, tried, moment)


def _balance(
    source: LevitationField, currents: Array, payload: Payload, moment: str, where: Array
) -> Balance:
    """The balance, with a fixed moment up or down, whichever is lifted more at the points `where`."""
    up = np.array([0.0, 0.0, payload.moment])
    balance = Balance(source, currents, payload.mass, payload.moment, up)
    if moment == "aligned":
        balance.fixed_moment = None
        return balance
    lift = balance.magnetic_force(where)[:, 2]
    if abs(lift.min()) > lift.max():
        balance.fixed_moment = -up
    return balance


def _eigen(stiffness: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    eigenvalues, directions = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    # A direction with no force to speak of is not stable.
    return eigenvalues, directions, eigenvalues > 1e-9 * np.abs(eigenvalues).max()


def _ranked(
    balance: Balance, source: LevitationField, found: list[Array], begin: Array | None
) -> list[Array]:
    """By distance from where the search began; else the stable ones first, then by distance from the axis."""
    axis = 0.5 * (np.asarray(source.lower) + np.asarray(source.upper))

    def order(x: Array) -> tuple[float, float]:
        if begin is not None:
            return 0.0, float(np.linalg.norm(x - begin))
        unstable = 3 - int(_eigen(balance.stiffness(x))[2].sum())
        return float(unstable), float(np.linalg.norm((x - axis)[:2]))

    return sorted(found, key=order)


def _result(
    balance: Balance,
    source: LevitationField,
    found: list[Array],
    begin: Array | None,
    tried: int,
    moment: str,
) -> Equilibrium:
    ranked = _ranked(balance, source, found, begin)
    position = ranked[0]
    stiffness = balance.stiffness(position)
    eigenvalues, directions, stable = _eigen(stiffness)
    residual = balance.residual(position[None, :])[0]
    report = SearchReport(
        method="trust-region reflective least squares, analytic derivative",
        starts=tried,
        converged=len(found),
        evaluations=balance.evaluations,
        relative_residual=float(np.linalg.norm(residual) / balance.weight),
        stiffness_asymmetry=float(np.linalg.norm(stiffness - stiffness.T) / 2 / np.linalg.norm(stiffness)),
        lower=np.asarray(source.lower),
        upper=np.asarray(source.upper),
    )
    return Equilibrium(
        position=position,
        force_residual=residual,
        stiffness=stiffness,
        eigenvalues=eigenvalues,
        directions=directions,
        stable=stable,
        moment=np.array(balance.moments(position[None, :])[0]),
        field=source.field(position[None, :], balance.currents)[0],
        currents=balance.currents,
        others=np.array(ranked[1:]).reshape(-1, 3),
        assumptions=assumptions(moment),
        report=report,
    )


def assumptions(moment: str) -> tuple[str, ...]:
    """What every force in this room rests on."""
    held = {
        "fixed": "the moment keeps its vertical direction",
        "aligned": "the moment stays parallel to the local field and keeps its magnitude",
    }[moment]
    return (
        "the magnet is a point dipole at its centre",
        held,
        "the currents are constant and the magnet does not change the field of the coils and the iron",
        "position means the magnet's centre; the sensor reads a point magnet_offset above it",
    )
