"""S11 to S13 and S15: the unit's coils, the levitation current, its division among the coils, and the range of the
magnet until a coil reaches the amplifier's limit or the magnet is no longer stable."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.errors import OutsideMapError
from fieldmap.field import FieldLike
from fieldmap.iron import LinearSolution, solve_linear
from fieldmap.levitation import GRAVITY, stationary_points
from fieldmap.sources import bare_inductance
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.drive_unit import PANELS, lift_share, payload, unit_rays, unit_states
from fieldmap.thesis.equilibrium_shift import DRAWN_H, Axis, Shift, sensitivity_at_origin, shift
from fieldmap.thesis.hysteresis import about_the_joints, joint_range, lift_law, shipped_unit
from fieldmap.thesis.vertical_sensor import SENSOR_ZERO_DEPTH, magnet_height, thesis_lift_current
from fieldmap.typing import Array

VARIANTS = {
    "drive_unit": "as it levitated",
    "drive_unit_no_centre_core": "without centre core",
    "drive_unit_a3": "Appendix A-3: 120 mm gap, 1350 turns",
    "disk_six_cores": "disk and six cores",
    "disk_six_cores_plate": "disk, six cores and upper plate",
}
REFINEMENT = 0.5
"""Divisor of the mesh sizes of the linear variants; their lift is within 2 % of the lift on the shipped mesh."""


@detail.cached
def linear_unit(name: str) -> LinearSolution:
    """A variant with linear iron (initial slope of its B-H table)."""
    return solve_linear(read_device(name), refinement=detail.refinement(REFINEMENT))


def coils(inputs: dict[str, Any]) -> Answers:
    """Inductances of Table 3-1; fields of each coil alone and of all coils, linear and saturating; lift of variants."""
    unit = linear_unit("drive_unit")
    numbers = {
        "on_its_core": 1e3 * _on_its_core(),
        "in_the_unit": 1e3 * np.diag(unit.inductance()),
        "without_iron": 1e3 * np.diag(bare_inductance(unit.coils)),
    }
    # Lift of the saturating unit over that of linear iron, at 1 A in all coils and in coil 5 alone.
    saturating, linear = (
        np.array([lift_share(field, 10.0, DRAWN_H, amperes) for amperes in (1.0, np.eye(6)[4])])
        for field in (unit_states(), unit)
    )
    shares = dict(zip(("share_of_all", "share_of_one"), saturating / linear, strict=True))
    return Answers(numbers, _coil_figures(unit), {"refinement": detail.refinement(REFINEMENT), **shares})


@detail.cached
def _on_its_core() -> Array:
    """Self-inductance (c,), H, of each winding on its own core, without the rest of the unit."""
    device = read_device("drive_unit")
    found = []
    for coil in device.coils:
        core = tuple(body for body in device.bodies if body.name == f"core {coil.name}")
        alone = replace(device, bodies=core, coils=(coil,), sections=())
        found.append(float(solve_linear(alone).inductance()[0, 0]))
    return np.array(found)


def _axis(z: Array) -> Array:
    return np.column_stack([np.zeros_like(z), np.zeros_like(z), z])


def _coil_figures(unit: LinearSolution) -> tuple[Curves, ...]:
    """dBz/dz of each coil alone over x at z_s = 10 mm, h = 15 mm; B_z per ampere on the axis, linear and saturating at
    several currents; and lift over weight of every variant."""
    x, z = np.linspace(-0.016, 0.016, 33), np.linspace(-0.130, -0.085, 46)
    at = np.column_stack([x, np.zeros_like(x), np.full_like(x, magnet_height(10.0, 0.015))])
    slopes = unit.unit_fields(at)[1][..., 2, 2]
    each = [Series(f"coil {name}", 1e3 * x, one) for name, one in zip(unit.coil_names, slopes, strict=True)]
    flux = [Series("linear iron", -1e3 * z, 1e3 * unit.field(_axis(z), np.ones(6))[:, 2])]
    for level in (1.0, 1.558, 2.2, 3.6):
        per_ampere = unit_rays().field(_axis(z), np.full(6, level))[:, 2] / level
        flux.append(Series(f"saturating, {level:g} A", -1e3 * z, 1e3 * per_ampere))
    per_weight, lifts = payload().moment / (payload().mass * GRAVITY), []
    for name, words in VARIANTS.items():
        inside = z[z > -0.118] if name == "drive_unit_a3" else z
        slope = linear_unit(name).gradient(_axis(inside), np.ones(6))[:, 2, 2]
        lifts.append(Series(words, -1e3 * inside, per_weight * slope))
    title, depth = (
        "dBz/dz of each coil alone, linear iron, 102 mm below the disk",
        "depth below the disk (mm)",
    )
    of_lift = "Lift of the microrobot per ampere in each coil, linear iron"
    return (
        Curves(title, "x (mm)", "dBz/dz (T/m/A)", tuple(each)),
        Curves("Bz on the axis per ampere in each coil", depth, "Bz (mT/A)", tuple(flux)),
        Curves(of_lift, depth, "lift over weight (1/A)", tuple(lifts)),
    )


@detail.cached
def lift_current(z_s: float, h: float, scale: float = 1.0) -> float:
    """Current in each coil, A, at which the saturating unit with its force scaled carries the microrobot on the axis;
    NaN outside 1.0 to 5.2 A."""
    low, high = PANELS[0][0], PANELS[-1][-1]
    try:
        return float(brentq(lambda i: scale * lift_share(unit_rays(), z_s, h, i) - 1.0, low, high, xtol=1e-6))
    except (ValueError, OutsideMapError):
        return float("nan")


def levitation_current(inputs: dict[str, Any]) -> Answers:
    """(7-18), (8-6)."""
    zs, hs, h = inputs["depths_mm"], inputs["offsets_mm"], inputs["offset_mm"]
    middle = inputs["middle_mm"]
    currents = np.array([lift_current(z, h) for z in zs])
    shares = np.array([[lift_share(unit_rays(), z, each, thesis_lift_current(z)) for z in zs] for each in hs])
    spread = np.ptp(shares, axis=1) / shares.mean(axis=1)
    numbers = {
        "current": currents,
        "total": 6.0 * lift_current(middle, h),
        "current_over_h": [lift_current(middle, each) for each in hs],
        "current_linear": [1.0 / lift_share(linear_unit("drive_unit"), z, h, 1.0) for z in zs],
        "relative_slope": [_relative_slope(middle, each) for each in hs[:-1]],
        "lift_over_weight": shares,
    }
    jointed = lift_law(shipped_unit(), zs)
    numbers |= {"lift_with_joints": jointed.shares, "slope_with_joints": jointed.relative_slope}
    best = int(np.argmin(spread))
    facts = {
        "refinement": detail.refinement(REFINEMENT),
        "least_share": shares.min(),
        "largest_share": shares.max(),
        "best_h_mm": hs[best],
        "spread": spread[best],
        "deepest_mm": zs[-1],
        "factor": 1.0 / shares[best].mean(),
        **about_the_joints(),
    }
    return Answers(numbers, _lift_figures(inputs, currents, shares), facts)


def _relative_slope(z_s: float, h: float) -> float:
    """d ln i / dz_s, percent per mm."""
    below, above = lift_current(z_s - 1.0, h), lift_current(z_s + 1.0, h)
    return 100.0 * (above - below) / 2.0 / lift_current(z_s, h)


def _lift_figures(inputs: dict[str, Any], currents: Array, shares: Array) -> tuple[Curves, ...]:
    zs, hs, x = inputs["depths_mm"], inputs["offsets_mm"], "sensor depth z_s (mm)"
    series = [Series("measured, (7-18)", zs, np.array([thesis_lift_current(z) for z in zs]), "measured")]
    series.append(Series(f"ours, saturating, h = {inputs['offset_mm']:g} mm", zs, currents))
    for h, row in zip(hs, shares, strict=True):
        # A force scaled so that (7-18) holds at the middle depth shows whether the law holds at other depths.
        scale = 1.0 / row[int(np.argmin(np.abs(zs - inputs["middle_mm"])))]
        scaled = np.array([lift_current(z, h, scale) for z in zs])
        series.append(Series(f"ours, force scaled by {scale:.2f}, h = {h:g} mm", zs, scaled))
    shown = tuple(Series(f"h = {h:g} mm", zs, row) for h, row in zip(hs, shares, strict=True))
    return (
        Curves("(7-18): levitation current", x, "current in each coil (A)", tuple(series)),
        Curves("Lift at the measured currents", x, "lift over weight", shown),
    )


def current_division(inputs: dict[str, Any]) -> dict[str, Any]:
    """(6-2), (6-3), Table 6-1: the division itself."""
    u, x, y, n = (inputs[name] for name in ("u", "x_signal", "y_signal", "n"))
    division = LiftAndDirections(n)
    slopes = division.derivative([1.0, 0.0, 0.0])
    return {
        "sum": float(division.currents([u, x, y]).sum() / u),
        "directions": np.sign(np.array([slopes[:, 1], -slopes[:, 1], slopes[:, 2], -slopes[:, 2]])),
    }


def directions(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 6-1 from the field: how the equilibrium moves with each coil's current."""
    moved = sensitivity_at_origin().at_held_height
    clear = np.abs(moved) > inputs["least_share"] * np.abs(moved).max(axis=1, keepdims=True)
    x, y = np.where(clear, np.sign(moved), 0.0)
    return {"directions": np.array([x, 0.0 - x, y, 0.0 - y])}


SIGNALS = np.arange(0.05, 0.551, 0.05)
X_END = 0.45
"""Last x signal of runs with joints; a coil reaches its current limit before."""
SIDES: tuple[tuple[Axis, float], ...] = (("x", 1.0), ("x", -1.0), ("y", 1.0))
"""Axes and signs of the computed sides; y < 0 mirrors y > 0."""


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
    """The shift up to the last signal at which the magnet is inside the map's box."""
    signals = SIGNALS
    while True:
        try:
            fields = (detail.available_map("division", outside_currents="evaluate"),)
            return shift(fields, way * signals, axis, z_s=z_s, h=h, far=np.inf)
        except OutsideMapError:
            signals = signals[:-1]


def _side(axis: Axis, way: float, z_s: float, h: float, limit: float, largest_y: float) -> float:
    """Reach to one side, mm, up to the signal at which a coil carries the limit."""
    found = _followed(axis, way, z_s, h)
    signals, along = np.abs(found.signals), 1e3 * np.abs(found.along)
    last = float(np.interp(limit, found.largest, signals))
    if axis == "y":
        last = min(last, largest_y)
    return float(np.interp(last, signals, along))


def _deepest(h: float, limit: float, scaled: bool) -> float:
    """Largest z_s, mm, at which the current limit in every coil carries the weight. scaled: whether the force is scaled
    so that (7-18) carries the weight at z_s = 10 mm."""
    field = detail.available_map("division", outside_currents="evaluate")
    scale = 1.0 / lift_share(field, 10.0, h, thesis_lift_current(10.0)) if scaled else 1.0
    end = -1e3 * float(field.lower[2]) - 1e3 * SENSOR_ZERO_DEPTH - h - 0.01

    def excess(z_s: float) -> float:
        return scale * lift_share(field, z_s, h, limit) - 1.0

    if excess(0.0) < 0.0:
        return 0.0
    return end if excess(end) > 0.0 else float(brentq(excess, 0.0, end, xtol=1e-4))


def _checked_at_half() -> float:
    """Distance, mm, between the equilibria of the extrapolated map and of a solved state at y = 0.5, u = 2.2 A."""
    currents = LiftAndDirections(1.25).currents([2.2, 0.0, 0.5])
    height = magnet_height(11.5, 1e-3 * DRAWN_H)
    window = ([-5e-3, 0.0], [5e-3, 15.9e-3])
    extended = detail.available_map("division", outside_currents="evaluate")
    sources: tuple[FieldLike, ...] = (extended, unit_states())
    places = [stationary_points(f, currents, payload(), height, window, samples=8).points for f in sources]
    return 1e3 * float(np.linalg.norm(places[0][0].position - places[1][0].position))
