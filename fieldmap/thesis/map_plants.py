"""S16, S17: linear plants from the unit's field at an operating point, compared with the identified plants."""

from functools import cache
from typing import Any

import numpy as np

from fieldmap.control import MapPlant, continuous, plant_from_map
from fieldmap.currents import LiftAndDirections
from fieldmap.device import Device, read_device
from fieldmap.field import Field, FieldOfStates, as_field
from fieldmap.iron import NonlinearSolution, NonlinearSolver, solve_linear
from fieldmap.levitation import lift_current
from fieldmap.store import Grid
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.drive_unit import as_dipole, harmonic_map
from fieldmap.thesis.equilibrium_shift import AXES
from fieldmap.thesis.vertical_sensor import magnet_height
from fieldmap.typing import Array

_REFINEMENT = 0.4
_DEVICE = "drive_unit"


# The cache of `NonlinearSolver.at` would start a solve from the state that was used last. The numbers of these rows
# come from solves that start from the last solved state; another start changes them within the solver's tolerance.
class _SolvedOnDemand(FieldOfStates):
    """Saturating iron at any currents. A solve starts from the state that was solved last."""

    def __init__(self, device: Device) -> None:
        self._solver = NonlinearSolver(device, _REFINEMENT)
        self._states: dict[bytes, NonlinearSolution] = {}
        self._last: NonlinearSolution | None = None

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self._solver.coil_names

    def at(self, currents: Any) -> NonlinearSolution:
        """The state at these currents."""
        amperes = np.asarray(currents, dtype=float)
        key = amperes.tobytes()
        if key not in self._states:
            self._last = self._states[key] = self._solver.solve(amperes, start=self._last)
        return self._states[key]


def _point(sensor_mm: float, offset_mm: float) -> Array:
    """The magnet's centre (3,), m."""
    return np.array([0.0, 0.0, magnet_height(sensor_mm, 1e-3 * offset_mm)])


@cache
def _linear_map(lower_z: float, upper_z: float) -> Field:
    """A small map of the unit with linear iron around the axis, 3 mm between its nodes."""
    unit = solve_linear(read_device(_DEVICE), refinement=_REFINEMENT)
    layers = int(np.ceil((upper_z - lower_z) / 3e-3)) + 1
    spacing = np.array([3e-3, 3e-3, (upper_z - lower_z) / (layers - 1)])
    grid = Grid(np.array([-6e-3, -6e-3, lower_z]), spacing, (5, 5, layers))
    return harmonic_map(grid, unit.coil_names, *unit.unit_fields(grid.points()))


@cache
def _linear_plant(sensor_mm: float, offset_mm: float, n: float) -> MapPlant:
    """The plant at the lift current of linear iron; signals u (A), x_ctrl, y_ctrl."""
    field = _linear_map(magnet_height(sensor_mm, 0.028), magnet_height(sensor_mm, 0.004))
    payload = as_dipole(read_device(_DEVICE))
    point = _point(sensor_mm, offset_mm)
    return _plant(field, point, lift_current(field, payload, point).current, n)


def _plant(
    field: Field, point: Array, current: float, n: float, steps: list[float] | None = None
) -> MapPlant:
    """The plant at equal currents in all coils."""
    currents = np.full(len(field.coil_names), current)
    signals = LiftAndDirections(n).derivative([current, 0.0, 0.0])
    return plant_from_map(
        field, as_dipole(read_device(_DEVICE)), point, currents, signals, signal_steps=steps
    )


@cache
def _states(sensor_mm: float, offset_mm: float) -> Field:
    """The unit with saturating iron around one point, for any currents."""
    point = _point(sensor_mm, offset_mm)
    return as_field(_SolvedOnDemand(read_device(_DEVICE)), (point - 5e-3, point + 5e-3))


@cache
def _saturating_plant(
    sensor_mm: float, offset_mm: float, n: float, steps: tuple[float, float], current: float | None = None
) -> MapPlant:
    """The plant at equal currents in all coils, A; by default the lift current. Signals u (A), x_ctrl, y_ctrl. steps:
    of x_ctrl and y_ctrl, for the differences of the force."""
    field, at = _states(sensor_mm, offset_mm), _point(sensor_mm, offset_mm)
    if current is None:
        current = lift_current(field, as_dipole(read_device(_DEVICE)), at, first=3.5).current
    return _plant(field, at, current, n, [0.02, *steps])


def _plants(inputs: dict[str, Any]) -> tuple[MapPlant, MapPlant]:
    """The plants with linear and with saturating iron; steps are the signals of 6.4."""
    at = inputs["depth_mm"], inputs["offset_mm"], inputs["n"]
    return _linear_plant(*at), _saturating_plant(*at, (inputs["x_signal"], inputs["y_signal"]))


def vertical(inputs: dict[str, Any]) -> Answers:
    """Product of the poles, sign of the gain and slope of the equilibrium voltage, for (7-7) and (7-19)."""
    by_offset = [_linear_plant(inputs["depth_mm"], each, inputs["n"]) for each in inputs["offsets_mm"]]
    linear, saturating = _plants(inputs)
    gain = inputs["amplifier_A_per_V"]
    numbers = {
        "product": [p.pole_products[2] for p in by_offset],
        "product_saturating": saturating.pole_products[2],
        "sign_of_gain": [_sign_of_depth(linear), _sign_of_depth(saturating)],
        "slope": _volts_per_mm(linear, gain),
        "slope_saturating": _volts_per_mm(saturating, gain),
    }
    return Answers(numbers, facts=_facts(saturating=saturating))


def _facts(**plants: MapPlant) -> dict[str, Any]:
    """The plants, and lift over weight at the currents of each."""
    lifts = {f"{name}_lift": 1.0 + plant.imbalance[2] for name, plant in plants.items()}
    return {"refinement": _REFINEMENT, **plants, **lifts}


def _sign_of_depth(plant: MapPlant) -> float:
    """Sign of the depth's gain (downward) by the common current."""
    return float(-np.sign(plant.axis("z").B[1, 0]))


def _volts_per_mm(plant: MapPlant, amplifier: float) -> float:
    """Change of the lift voltage per mm of depth: K_zz dz = f di with z upward."""
    per_metre = -plant.stiffness[2, 2] / plant.force_per_signal[2, 0]
    return 1e-3 * per_metre / amplifier


def horizontal(inputs: dict[str, Any]) -> Answers:
    """Products of the horizontal poles, positions at rest, and the damping that gives the identified slow poles."""
    linear, saturating = _plants(inputs)
    at, steps = (
        (inputs["depth_mm"], inputs["offset_mm"], inputs["n"]),
        (inputs["x_signal"], inputs["y_signal"]),
    )
    measured = _saturating_plant(*at, steps, inputs["measured_current_A"])
    numbers = {
        "product": linear.pole_products[:2],
        "product_saturating": saturating.pole_products[:2],
        "damping": _damping(linear, inputs),
        "damping_saturating": _damping(saturating, inputs),
        "position": _positions(linear, inputs),
        "position_saturating": _positions(saturating, inputs),
        "position_1_558_A": _positions(measured, inputs),
    }
    return Answers(numbers, facts=_facts(saturating=saturating, measured=measured))


def _positions(plant: MapPlant, inputs: dict[str, Any]) -> list[float]:
    """Rest positions at the signals of 6.4, mm: force over stiffness."""
    return [
        1e3 * inputs[f"{axis}_signal"] * plant.force_per_signal[i, 1 + i] / plant.stiffness[i, i]
        for i, axis in enumerate("xy")
    ]


def _damping(plant: MapPlant, inputs: dict[str, Any]) -> list[float]:
    """Damping for x and y that gives the pole of the first-order models."""
    found = []
    for axis in AXES:
        model = inputs[f"{axis}_first_order"]
        denominator = continuous((model[:1], model[1:]), inputs["Ts_s"]).denominator
        found.append(plant.damping_for_pole(axis, float(-denominator[1] / denominator[0])))
    return found
