"""S15: how far the magnet can be moved before a coil reaches the amplifier's limit or a place is no longer stable."""

from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series
from fieldmap.errors import OutsideMapError
from fieldmap.field import FieldLike
from fieldmap.levitation import stationary_points
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.detail import available_map
from fieldmap.thesis.drive_unit import lift_share, payload, unit_states
from fieldmap.thesis.equilibrium_shift import DRAWN_H, Axis, Shift, shift
from fieldmap.thesis.hysteresis import about_the_joints, joint_range
from fieldmap.thesis.vertical_sensor import SENSOR_ZERO_DEPTH, magnet_height, thesis_lift_current

SIGNALS = np.arange(0.05, 0.551, 0.05)
X_END = 0.45
"""The x signal to which runs with joints go: a coil reaches the limit before."""
SIDES: tuple[tuple[Axis, float], ...] = (("x", 1.0), ("x", -1.0), ("y", 1.0))
"""y < 0 mirrors y > 0."""


def ranges(inputs: dict[str, Any]) -> Answers:
    """7.2.3."""
    limit, hs = inputs["current_limit_A"], inputs["offsets_mm"]
    numbers: dict[str, Any] = {}
    curves: list[Curves] = []
    ends: dict[Axis, float] = {"x": X_END, "y": inputs["largest_y_signal"]}
    for z_s, name in zip(inputs["depths_mm"], ("upper", "lower"), strict=True):
        right, left, up = ([_side(*side, z_s, h, limit, ends["y"]) for h in hs] for side in SIDES)
        numbers[f"x_range_{name}"] = [a + b for a, b in zip(right, left, strict=True)]
        numbers[f"y_range_{name}"] = [2.0 * side for side in up]
        for axis, largest in ends.items():
            numbers[f"{axis}_range_{name}_joints"] = joint_range(axis, z_s, limit, largest)
        series = []
        for axis, way in SIDES:
            found = _followed(axis, way, z_s, DRAWN_H)
            words = f"{'-' if way < 0 else ''}{axis}"
            series.append(Series(words, found.largest, 1e3 * np.abs(found.along)))
        title = f"Reach against the largest coil current, z_s = {z_s:g} mm, h = {DRAWN_H:g} mm"
        labels = (title, "largest coil current (A)", "distance from the origin (mm)")
        curves.append(Curves(*labels, tuple(series)))
    for name, scaled in (("vertical_range", True), ("vertical_range_unscaled", False)):
        numbers[name] = [_deepest(h, limit, scaled) for h in hs]
    stable = all(
        _followed(axis, way, z_s, DRAWN_H).all_stable for axis, way in SIDES for z_s in inputs["depths_mm"]
    )
    facts = {
        "stability": "stable sideways" if stable else "not stable sideways",
        "off_mm": _checked_at_half(),
        **about_the_joints(),
    }
    return Answers(numbers, tuple(curves), facts)


@detail.cached
def _followed(axis: Axis, way: float, z_s: float, h: float) -> Shift:
    """As far as the map's box goes."""
    signals = SIGNALS
    while True:
        try:
            fields = (available_map("division", outside_currents="evaluate"),)
            return shift(fields, way * signals, axis, z_s=z_s, h=h, far=np.inf)
        except OutsideMapError:
            signals = signals[:-1]


def _side(axis: Axis, way: float, z_s: float, h: float, limit: float, largest_y: float) -> float:
    """Reach to one side, mm: to the signal at which a coil carries the limit."""
    found = _followed(axis, way, z_s, h)
    signals, along = np.abs(found.signals), 1e3 * np.abs(found.along)
    last = float(np.interp(limit, found.largest, signals))
    if axis == "y":
        last = min(last, largest_y)
    return float(np.interp(last, signals, along))


def _deepest(h: float, limit: float, scaled: bool) -> float:
    """Largest z_s, mm, at which the limit in every coil carries the weight; the force scaled so that (7-18) carries it
    at z_s = 10 mm, or as computed."""
    field = available_map("division", outside_currents="evaluate")
    scale = 1.0 / lift_share(field, 10.0, h, thesis_lift_current(10.0)) if scaled else 1.0
    end = -1e3 * float(field.lower[2]) - 1e3 * SENSOR_ZERO_DEPTH - h - 0.01

    def excess(z_s: float) -> float:
        return scale * lift_share(field, z_s, h, limit) - 1.0

    if excess(0.0) < 0.0:
        return 0.0
    return end if excess(end) > 0.0 else float(brentq(excess, 0.0, end, xtol=1e-4))


def _checked_at_half() -> float:
    """Distance, mm, of the equilibria at y = 0.5, u = 2.2 A, of the extrapolated map and of a solved state."""
    currents = LiftAndDirections(1.25).currents([2.2, 0.0, 0.5])
    height = magnet_height(11.5, 1e-3 * DRAWN_H)
    window = ([-5e-3, 0.0], [5e-3, 15.9e-3])
    extended = available_map("division", outside_currents="evaluate")
    sources: tuple[FieldLike, ...] = (extended, unit_states())
    places = [stationary_points(f, currents, payload(), height, window, samples=8).points for f in sources]
    return 1e3 * float(np.linalg.norm(places[0][0].position - places[1][0].position))
