"""S4: the single electromagnet of section 2.3, its exact and its simplified winding, and the sphere it levitates."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.iron import LinearSolution, solve_linear
from fieldmap.levitation import GRAVITY
from fieldmap.records import Record
from fieldmap.thesis.computation import Answers, Ours
from fieldmap.typing import Array

EXACT, SIMPLIFIED = "single_electromagnet", "single_electromagnet_simplified"
CURRENTS = {EXACT: np.array([1.0]), SIMPLIFIED: np.full(5, 100.0)}
_REFINEMENT = 1.5


@dataclass(frozen=True, eq=False, repr=False)
class AxisCurves(Record):
    """Figures 2-4 to 2-6 on the axis: depth (n,) below the core in m, B_z (n,) in T and dB_z/dz (n,) in T/m, z up, and
    the force (n,) on the sphere in N, for one winding."""

    depth: Array
    flux_density: Array
    gradient: Array
    force: Array


def solved(name: str, refinement: float = _REFINEMENT) -> LinearSolution:
    """The solved electromagnet with one of the two windings."""
    return _solved(name, refinement)


# A cache takes one refinement, said and left out, for two.
@cache
def _solved(name: str, refinement: float) -> LinearSolution:
    return solve_linear(read_device(name), refinement=refinement)


def axis_curves(name: str, depth: Array) -> AxisCurves:
    """Field, gradient and force on the sphere along the axis."""
    points = np.column_stack([0 * depth, 0 * depth, -depth])
    unit, moment = solved(name), _payload(name).moment
    gradient = unit.gradient(points, CURRENTS[name])[:, 2, 2]
    return AxisCurves(depth, unit.field(points, CURRENTS[name])[:, 2], gradient, moment * gradient)


def levitation_depth(name: str, refinement: float = _REFINEMENT) -> float:
    """Depth below the core, m, at which the force on the sphere balances its weight."""
    payload, unit = _payload(name), solved(name, refinement)

    def surplus(depth: float) -> float:
        gradient = unit.gradient(np.array([[0.0, 0.0, -depth]]), CURRENTS[name])[0, 2, 2]
        return float(payload.moment * gradient - payload.mass * GRAVITY)

    return float(brentq(surplus, 0.02, 0.1, xtol=1e-9))


def _payload(name: str) -> Any:
    payload = read_device(name).payload
    assert payload is not None
    return payload


def windings(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 2-1: the simplified winding keeps ampere-turns and current density of the wires."""
    ratio = (inputs["simplified_wire_mm"] / inputs["exact_wire_mm"]) ** 2
    current = ratio * inputs["exact_current_A"]
    return {
        "simplified_current": current,
        "simplified_turns": inputs["exact_turns"] * inputs["exact_current_A"] / current,
    }


def levitation(inputs: dict[str, Any]) -> Answers:
    """Where the sphere levitates; how far the two windings' fields differ (Fig. 2-4)."""
    depth = 1e-3 * np.linspace(inputs["near_mm"], inputs["far_mm"], 80)
    exact, simplified = (axis_curves(name, depth) for name in (EXACT, SIMPLIFIED))
    difference = np.abs(simplified.flux_density / exact.flux_density - 1).max()
    reported = solved(EXACT).report.assumptions
    numbers = {
        "depth_exact": Ours(1e3 * levitation_depth(EXACT), reported),
        "depth_simplified": Ours(1e3 * levitation_depth(SIMPLIFIED), reported),
        "difference_of_the_windings": Ours(100 * float(difference), reported),
    }
    curves = (_field_curves(), _gradient_curves(), _force_curves(inputs["printed_depth_mm"]))
    return Answers(numbers, curves, {"refinement": _REFINEMENT})


def _field_curves() -> Curves:
    depth = np.linspace(0.5e-3, 0.1, 200)
    windings = ((EXACT, "500 turns, 1 A"), (SIMPLIFIED, "5 turns, 100 A"))
    series = tuple(
        Series(label, 1e3 * depth, 1e3 * axis_curves(name, depth).flux_density) for name, label in windings
    )
    title, remark = "Fig. 2-4: exact and simplified winding", "The two lines lie on each other."
    return Curves(title, "depth below the core (mm)", "$B_z$ (mT)", series, remark)


def _gradient_curves() -> Curves:
    depth = np.linspace(0.5e-3, 0.1, 200)
    series = Series("500 turns, 1 A", 1e3 * depth, axis_curves(EXACT, depth).gradient)
    return Curves(
        "Fig. 2-5: gradient on the axis, z upwards",
        "depth below the core (mm)",
        r"$\partial B_z/\partial z$ (T/m)",
        (series,),
        log_y=True,
    )


def _force_curves(printed_mm: float) -> Curves:
    depth, at = np.linspace(0.03, 0.06, 120), levitation_depth(EXACT)
    weight = 1e3 * _payload(EXACT).mass * GRAVITY
    series = (
        Series("magnetic force", 1e3 * depth, 1e3 * axis_curves(EXACT, depth).force),
        Series("weight", 1e3 * depth[[0, -1]], np.full(2, weight)),
        Series(f"balance at {1e3 * at:.1f} mm", np.array([1e3 * at]), np.array([weight]), points=True),
        Series(
            f"the thesis's {printed_mm:g} mm",
            np.array([printed_mm]),
            np.array([weight]),
            "published",
            points=True,
        ),
    )
    return Curves("Fig. 2-6: force on the 1 mm sphere", "depth below the core (mm)", "force (mN)", series)
