"""S12 and S14 together: named calibrations, and whether one of them makes one picture of both."""

from typing import Any

import numpy as np

from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series
from fieldmap.levitation import Calibration, LiftReadings, PositionReadings, calibrate
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers, Ours
from fieldmap.thesis.drive_unit import payload
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.thesis.workspace import extended_map
from fieldmap.typing import Array

FITS: dict[str, tuple[tuple[str, ...], str]] = {
    "scale": (("field_scale",), ""),
    "scale_and_h": (("field_scale", "magnet_offset"), ""),
    "with_x": (("field_scale", "magnet_offset", "current_scale"), "x"),
    "with_x_and_y": (("field_scale", "magnet_offset", "current_scale"), "xy"),
}
"""Name -> free parameters, and the axes whose positions are fitted besides (7-18). Held otherwise: h = 15 mm, 1, 1."""
OFFSET_LIMITS = (5e-3, 30e-3)
"""m: the magnet is 10 mm tall and lies inside the body."""


class _Said:
    """A fit as the row file speaks of it: its values in one line, its fitted values, and both misfits."""

    def __init__(self, fit: Calibration) -> None:
        deviations = fit.deviations
        self._values = fit.values
        self.misfit, self.misfit_before = fit.misfit, fit.misfit_before
        self.fitted = ", ".join(
            f"{key} = {fit.values[key]:.4g} +- {deviations[key]:.1g}" for key in fit.fitted
        )

    def __format__(self, spec: str) -> str:
        v = self._values
        return (
            f"force times {v['field_scale']:.2f}, h = {1e3 * v['magnet_offset']:.1f} mm, currents times "
            f"{v['current_scale']:.2f}, misfit {self.misfit:.1f} deviations"
        )


def calibrations(inputs: dict[str, Any]) -> Answers:
    """(7-18) and Tables 6-4, 6-6 before and after each fit."""
    found = {name: _fit(name, *_frozen(inputs)) for name in FITS}
    numbers: dict[str, Any] = {}
    for name, fit in found.items():
        lifts, x, y = _computed(fit, inputs)
        numbers[f"current_{name}"] = Ours(
            [thesis_lift_current(z) / lift for z, lift in lifts], fit.assumptions
        )
        numbers[f"x_{name}"] = Ours(x, fit.assumptions)
        numbers[f"y_{name}"] = Ours(y, fit.assumptions)
    return Answers(numbers, _figures(found, inputs), {name: _Said(fit) for name, fit in found.items()})


def _frozen(inputs: dict[str, Any]) -> tuple[Any, ...]:
    names = ("depths_mm", "x_signals", "x_mm", "y_signals", "y_mm")
    tables = tuple(tuple(float(v) for v in inputs[name]) for name in names)
    return (*tables, inputs["lift_deviation"], inputs["position_deviation_mm"])


@detail.cached
def _fit(
    name: str, depths: Any, xs: Any, x_mm: Any, ys: Any, y_mm: Any, lift: float, place: float
) -> Calibration:
    free, axes = FITS[name]
    return calibrate(
        extended_map(),
        payload(),
        lift=_lift_readings(np.array(depths), lift),
        positions=_position_readings(axes, (xs, x_mm), (ys, y_mm), place) if axes else None,
        fit=free,
        limits={"magnet_offset": OFFSET_LIMITS},
    )


def _lift_readings(depths: Array, deviation: float) -> LiftReadings:
    currents = np.outer([thesis_lift_current(z) for z in depths], np.ones(6))
    return LiftReadings([magnet_height(z) for z in depths], currents, deviation)


def _position_readings(axes: str, of_x: Any, of_y: Any, deviation_mm: float) -> PositionReadings:
    """Rising branches; the first reading is that of signal 0, from which the others are counted."""
    currents, places = [np.full(6, thesis_lift_current(10.0))], [[0.0, 0.0]]
    for axis, (signals, mm) in zip("xy", (of_x, of_y), strict=True):
        if axis not in axes:
            continue
        for signal, place in zip(signals[1:], mm[1:], strict=True):
            x, y = (signal, 0.0) if axis == "x" else (0.0, signal)
            currents.append(LiftAndDirections(1.25).currents([thesis_lift_current(10.0), x, y]))
            moved = 1e-3 * (place - mm[0])
            places.append([moved, np.nan] if axis == "x" else [np.nan, moved])
    sensed = np.full(len(places), magnet_height(10.0))
    return PositionReadings(sensed, currents, places, 1e-3 * deviation_mm, height_held=True, from_first=True)


def _computed(fit: Calibration, inputs: dict[str, Any]) -> tuple[list[tuple[float, float]], Array, Array]:
    """(z_s, lift over weight at the measured current) and the places of both tables, mm, at the fit's values."""
    tables = ((inputs["x_signals"], inputs["x_mm"]), (inputs["y_signals"], inputs["y_mm"]))
    rig = calibrate(
        extended_map(),
        payload(),
        lift=_lift_readings(inputs["depths_mm"], 0.01),
        positions=_position_readings("xy", *tables, 1.0),
        fit=("field_scale",),
        given=fit.values,
    )
    count = len(inputs["depths_mm"])
    lifts = [row.before for row in rig.table[:count]]
    moved = [1e3 * row.before for row in rig.table[count + 2 :]]
    split = len(inputs["x_signals"]) - 1
    x = inputs["x_mm"][0] + np.array([0.0, *moved[:split]])
    y = inputs["y_mm"][0] + np.array([0.0, *moved[split:]])
    return list(zip(inputs["depths_mm"].tolist(), lifts, strict=True)), x, y


def _figures(found: dict[str, Calibration], inputs: dict[str, Any]) -> tuple[Curves, ...]:
    computed = {name: _computed(fit, inputs) for name, fit in found.items()}
    z = inputs["depths_mm"]
    lift = [Series("measured, (7-18)", z, np.ones(len(z)), "measured")]
    lift += [Series(f"fit `{name}`", z, np.array([s for _, s in of[0]])) for name, of in computed.items()]
    figures = [
        Curves(
            "Lift at the measured currents, after each fit",
            "sensor depth z_s (mm)",
            "lift over weight",
            tuple(lift),
        )
    ]
    for k, axis in enumerate("xy", start=1):
        signals = inputs[f"{axis}_signals"]
        lines = [Series(f"fit `{name}`", signals, np.asarray(of[k])) for name, of in computed.items()]
        points = Series("measured, rising", signals, inputs[f"{axis}_mm"], "measured", points=True)
        figures.append(
            Curves(
                f"Shift along {axis} after each fit",
                f"{axis} control signal",
                f"{axis} (mm)",
                (points, *lines),
            )
        )
    return tuple(figures)
