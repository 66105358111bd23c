"""What a designer asks of a machine at given currents: windings, inductances, forces, flux densities, heat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import check_positive
from fieldmap.device import read_device
from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.model import Device
from fieldmap.field import Currents, coil_currents
from fieldmap.iron.solution import LinearSolution, SolvedState
from fieldmap.iron.solvers.nonlinear import NonlinearSolver
from fieldmap.iron.summary import BodyFlux, GroupForce, body_fluxes
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

COPPER = 1.724e-8
"""Resistivity of annealed copper at 20 C, ohm m (IEC 60028)."""
FILL = 0.6
"""Share of a winding's section that is copper, where nothing says how much: usual for round wire."""


@dataclass(frozen=True, repr=False)
class WindingFigures(Record):
    """One winding at a current, A.

    resistance, ohm: as the device states it, otherwise that of copper at 20 C (`resistance_is_stated` says which).
    voltage, V, and power, W, of the steady current. current_density: ampere-turns per area of the whole section,
    A/m^2; in the copper it is that divided by the share of copper. inductance, H: of this winding alone at the state,
    dlambda/di; time_constant, s: inductance by resistance. temperature_rise, K: power times a stated thermal
    resistance; None without one.
    """

    coil: str
    current: float
    resistance: float
    resistance_is_stated: bool
    voltage: float
    power: float
    current_density: float
    inductance: float
    time_constant: float
    temperature_rise: float | None


@dataclass(frozen=True, eq=False, repr=False)
class DesignFigures(Record):
    """A machine at currents (c,), A.

    inductance (c, c), H: derivatives of the flux linkages by the currents at this state. coil_forces: on each winding;
    iron_forces: on each connected piece of iron, named by its bodies; torques about the origin. bodies: flux density
    in each body, none without iron. power: of all windings, W.
    """

    device: str
    currents: Array
    windings: tuple[WindingFigures, ...]
    inductance: Array
    coil_forces: tuple[GroupForce, ...]
    iron_forces: tuple[GroupForce, ...]
    bodies: tuple[BodyFlux, ...]
    power: float
    assumptions: tuple[str, ...]


def winding_length(path: WindingPath) -> float:
    """Length of the middle line, m: arcs at their middle radius, and bars.

    >>> from fieldmap.device.model import CircularCoil
    >>> round(winding_length(CircularCoil("a", 0.02, 0.03, 0.01, 100).winding()), 6)
    0.15708
    """
    turned = 2.0 * path.arcs[:, 4] * 0.5 * (path.arcs[:, 5] + path.arcs[:, 6])
    return float(turned.sum() + 2.0 * path.bars[:, 4].sum())


def copper_resistance(coil: Coil, fill: float = FILL) -> float:
    """Resistance, ohm, of a winding of copper at 20 C: rho N^2 length / (fill section)."""
    path = coil.winding()
    section = fill * path.thickness * path.height
    return COPPER * coil.turns**2 * winding_length(path) / section


def design_figures(
    device: Device | PathLike,
    currents: Currents,
    field: LinearSolution | NonlinearSolver | None = None,
    thermal_resistance: float | None = None,
    fill: float = FILL,
) -> DesignFigures:
    """What a machine has, needs and bears at currents, A: see `DesignFigures`.

    field: the solution of the device, or its solver of saturating iron; a new solver where its iron saturates and a
    linear solution otherwise, if None. thermal_resistance: of each winding to its surroundings, K/W; the rise of the
    temperature is that times the power, with the resistance at 20 C. fill: share of copper in a winding's section,
    for windings whose resistance the device does not state. Raises InputError for currents that do not fit, and what
    the solvers raise.

    >>> import fieldmap as fm
    >>> figures = design_figures(fm.read_device("loop_and_sphere"), 1.0)
    >>> figures.windings[0].coil, figures.inductance.shape
    ('loop', (1, 1))
    """
    device = read_device(device)
    check_positive("design_figures", fill=fill)
    if thermal_resistance is not None:
        check_positive("design_figures", thermal_resistance=thermal_resistance)
    amperes = np.array(coil_currents(currents, device.coil_names))
    if field is None:
        used = {body.material for body in device.bodies}
        saturates = any(device.materials[name].saturates for name in used)
        if saturates:
            field = NonlinearSolver(device)
        else:
            from fieldmap.iron.solvers.linear import solve_linear

            field = solve_linear(device)
    state = field.at(amperes)
    if isinstance(field, NonlinearSolver):
        inductance = field.differential_inductance(field.at(amperes))
    else:
        inductance = field.inductance()
    windings = tuple(
        _winding(coil, current, own, thermal_resistance, fill)
        for coil, current, own in zip(device.coils, amperes, np.diag(inductance), strict=True)
    )
    return DesignFigures(
        device=device.name,
        currents=amperes,
        windings=windings,
        inductance=inductance,
        coil_forces=tuple(_force(state, (name,)) for name in device.coil_names),
        iron_forces=tuple(_force(state, names) for names in pieces_of_iron(state)),
        bodies=body_fluxes(state),
        power=float(sum(winding.power for winding in windings)),
        assumptions=(*state.assumptions, *_assumptions(windings, thermal_resistance, fill)),
    )


def pieces_of_iron(state: SolvedState) -> tuple[tuple[str, ...], ...]:
    """Names of the bodies of each connected piece of iron, in the order of the device."""
    return state.pieces_of_iron


def _force(state: SolvedState, names: tuple[str, ...]) -> GroupForce:
    return GroupForce(names, *state.force_and_torque_on(names, np.zeros(3)))


def _winding(
    coil: Coil, current: float, inductance: float, thermal_resistance: float | None, fill: float
) -> WindingFigures:
    path = coil.winding()
    stated = coil.resistance is not None
    resistance = copper_resistance(coil, fill) if coil.resistance is None else coil.resistance
    power = resistance * float(current) ** 2
    return WindingFigures(
        coil=coil.name,
        current=float(current),
        resistance=resistance,
        resistance_is_stated=stated,
        voltage=resistance * float(current),
        power=power,
        current_density=abs(coil.turns * float(current)) / (path.thickness * path.height),
        inductance=float(inductance),
        time_constant=float(inductance) / resistance,
        temperature_rise=None if thermal_resistance is None else thermal_resistance * power,
    )


def _assumptions(
    windings: tuple[WindingFigures, ...], thermal_resistance: float | None, fill: float
) -> tuple[str, ...]:
    found = ["resistances at 20 C, steady currents"]
    unstated = [winding.coil for winding in windings if not winding.resistance_is_stated]
    if unstated:
        found.append(f"resistance of {', '.join(unstated)}: copper in {100 * fill:g} % of the section")
    if thermal_resistance is not None:
        found.append(f"temperature rise: {thermal_resistance:g} K/W of each winding, as given")
    return tuple(found)
