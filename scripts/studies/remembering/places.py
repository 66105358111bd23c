"""Rest positions of the magnet and lift along paths of the currents: gains and branches."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import fsolve

from fieldmap.iron import HysteresisSolver
from fieldmap.lookup import FieldMap
from fieldmap.thesis.equilibrium_shift import AXES, Axis, divided
from fieldmap.thesis.hysteresis import Protocol, prepared, walk
from fieldmap.thesis.printed import read_part
from fieldmap.typing import Array

from .unit import Unit, begun, pull

REFINEMENT = 0.4
BRANCHES: tuple[tuple[Axis, str], ...] = tuple((a, s) for a in AXES for s in ("positive", "negative"))
"""Tables 6-4 to 6-7."""
# Squared relative step of differences. Shorter steps would show the tolerance of the iron model, 5e-7.
_STEP = 1e-10


def gain(unit: Unit, axis: Axis, size: float) -> float:
    """Slope between the ends of the second of two loops of a signal, mm per unit."""
    protocol, place, places = replace(unit.protocol, axis=axis), np.zeros(2), []
    memory = begun(unit.field, protocol)
    for signal in size * np.array([0.5, 1.0, 0.0, -1.0, 0.0, 0.5, 1.0, 0.0, -1.0]):
        currents = protocol.currents(protocol.level, float(signal))
        memory = _stepped(memory, currents)
        place = _rest(memory, currents, protocol.height, place)
        places.append(float(place["xy".index(axis)]))
    return 1e3 * (places[6] - places[8]) / (2.0 * size)


def gain_of_lift(unit: Unit, share: float) -> float:
    """d ln(lift) / d ln(current) in the second of two loops of all currents."""
    protocol = unit.protocol
    memory, point, lifts = begun(unit.field, protocol), np.array([0.0, 0.0, protocol.height]), []
    levels = protocol.level * (1.0 + share * np.array([1.0, -1.0, 1.0, -1.0]))
    for level in levels:
        currents = np.full(6, level)
        memory = _stepped(memory, currents)
        lifts.append(pull(memory, point, currents)[2])
    return float(np.log(lifts[3] / lifts[2]) / np.log(levels[3] / levels[2]))


def _stepped(memory: FieldMap, currents: Array) -> FieldMap:
    return memory.step(currents) if memory.remembers else memory


def _rest(field: FieldMap, currents: Array, height: float, near: Array) -> Array:
    """Position (2,), m, at which an upright magnet has no lateral force."""

    def aside(place: Array) -> Array:
        return pull(field, np.array([*place, height]), currents)[:2]

    return np.asarray(fsolve(aside, near, xtol=1e-7))


def there_and_back(axis: Axis, side: str) -> Array:
    """Signals of a table, out and back."""
    signals = read_part(f"S14_{axis}_branches").inputs[f"{side}_signals"]
    return np.concatenate([signals, signals[-2::-1]])


def branch(unit: Unit, axis: Axis, side: str) -> Array:
    """Positions at the signals of a table, mm, relative to the first."""
    protocol = replace(unit.protocol, axis=axis)
    along = np.array(list(_walked(unit.field, there_and_back(axis, side), protocol)))[:, "xy".index(axis)]
    return 1e3 * (along - along[0])


def way_out(unit: Unit, axis: Axis, signal: float) -> float:
    """Slope from the start to a signal of its table on the first way out, mm per unit."""
    k = int(np.argmin(np.abs(there_and_back(axis, "positive") - signal)))
    return float(branch(unit, axis, "positive")[k] / signal)


def branch_of_solver(unit: Unit, solver: HysteresisSolver, axis: Axis, side: str) -> Array:
    """Positions at the signals of a table by the full solver, mm, relative to the first."""
    protocol = replace(unit.protocol, axis=axis)
    memory = prepared(solver, "shaken", protocol, 0.4)
    return 1e3 * walk(solver, memory, there_and_back(axis, side), protocol).shift(axis)


def _walked(opened: FieldMap, signals: Array, protocol: Protocol) -> Iterator[Array]:
    """Positions (2,), m, at signals, with the level adjusted to keep the lift at the first signal."""
    memory, known, lift = begun(opened, protocol), np.array([0.0, 0.0, protocol.level]), np.nan
    for signal in signals:
        known = fsolve(_left, known, (memory, float(signal), protocol, lift), xtol=1e-7, epsfcn=_STEP)
        currents = divided(known[2], float(signal), protocol.axis, protocol.n)
        if np.isnan(lift):
            lift = pull(memory, np.array([*known[:2], protocol.height]), currents)[2]
        memory = _stepped(memory, currents)
        yield known[:2]


def _left(unknowns: Array, memory: FieldMap, signal: float, protocol: Protocol, lift: float) -> Array:
    """Residual: lateral force, and deviation of the lift, or of the level from the protocol's if no lift is known."""
    currents = divided(unknowns[2], signal, protocol.axis, protocol.n)
    force = pull(memory, np.array([*unknowns[:2], protocol.height]), currents)
    return np.array([*force[:2], unknowns[2] - protocol.level if np.isnan(lift) else force[2] - lift])
