"""S11 to S13: the unit's coils, the current that levitates, and how it is divided."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.errors import OutsideMapError
from fieldmap.iron import LinearSolution, solve_linear
from fieldmap.levitation import GRAVITY
from fieldmap.sources import bare_inductance
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.drive_unit import PANELS, lift_share, payload, unit_rays, unit_states
from fieldmap.thesis.equilibrium_shift import sensitivity_at_origin
from fieldmap.thesis.hysteresis import about_the_joints, lift_law, shipped_unit
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.typing import Array

VARIANTS = {
    "drive_unit": "as it levitated",
    "drive_unit_no_centre_core": "without centre core",
    "drive_unit_a3": "Appendix A-3: 120 mm gap, 1350 turns",
    "disk_six_cores": "disk and six cores",
    "disk_six_cores_plate": "disk, six cores and upper plate",
}
REFINEMENT = 0.5
"""Of the linear variants: their lift is within 2 % of the shipped mesh's."""


@detail.cached
def linear_unit(name: str) -> LinearSolution:
    """A variant with linear iron (initial slope of its B-H table)."""
    return solve_linear(read_device(name), refinement=detail.refinement(REFINEMENT))


def coils(inputs: dict[str, Any]) -> Answers:
    """Table 3-1's inductances, and the field of each coil alone and of all, linear and saturating, of every variant."""
    unit = linear_unit("drive_unit")
    numbers = {
        "on_its_core": 1e3 * _on_its_core(),
        "in_the_unit": 1e3 * np.diag(unit.inductance()),
        "without_iron": 1e3 * np.diag(bare_inductance(unit.coils)),
    }
    # Lift of the saturating unit over that of linear iron, at 1 A in all coils and in coil 5 alone.
    saturating, linear = (
        np.array([lift_share(field, 10.0, 15.0, amperes) for amperes in (1.0, np.eye(6)[4])])
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
    """dBz/dz over x at z_s = 10 mm, h = 15 mm, of each coil alone; on the axis B_z per ampere, linear and saturating at
    several currents, and the lift of every variant in weights."""
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
    """Current in each coil at which the saturating unit, its force scaled, carries the microrobot on the axis, A; NaN
    beyond 5.2 A."""
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
        # Where force is scaled so that (7-18) holds at the middle: the same law at every depth?
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
