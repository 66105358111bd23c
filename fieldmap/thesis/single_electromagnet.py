"""S4: the single electromagnet of section 2.3, its exact and its simplified winding, and the sphere it levitates."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from fieldmap.device import read_device
from fieldmap.iron import solve_linear
from fieldmap.iron.solution import LinearSolution
from fieldmap.levitation.conventions import GRAVITY
from fieldmap.thesis.registry import Ours

Array = NDArray[np.float64]
EXACT, SIMPLIFIED = "single_electromagnet", "single_electromagnet_simplified"
CURRENTS = {EXACT: (1.0,), SIMPLIFIED: (100.0,) * 5}
_REFINEMENT = 1.5
_ASSUMED = (
    "open space: Appendix A-1 sets the edge of the workspace as magnetic insulation and does not say where it is",
    "40 mm is the diameter of the core, 90 mm its length; the winding is 18 mm thick and as long as the core",
    f"mesh sizes of the device file over {_REFINEMENT:g}",
)


@dataclass(frozen=True, eq=False)
class AxisCurves:
    """Figures 2-4 to 2-6 on the axis: depth (n,) below the core in m, B_z (n,) in T and dB_z/dz (n,) in T/m, z up, and
    the force (n,) on the sphere in N, for one winding."""

    depth: Array
    flux_density: Array
    gradient: Array
    force: Array


@cache
def solved(name: str, refinement: float = _REFINEMENT) -> LinearSolution:
    """The solved electromagnet with one of the two windings."""
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


def levitation(inputs: dict[str, Any]) -> dict[str, Any]:
    """Where the sphere levitates; how far the two windings' fields differ (Fig. 2-4)."""
    depth = 1e-3 * np.linspace(inputs["near_mm"], inputs["far_mm"], 80)
    exact, simplified = (axis_curves(name, depth) for name in (EXACT, SIMPLIFIED))
    difference = np.abs(simplified.flux_density / exact.flux_density - 1).max()
    words = (*solved(EXACT).report.assumptions, *_ASSUMED)
    return {
        "depth_exact": Ours(1e3 * levitation_depth(EXACT), words),
        "depth_simplified": Ours(
            1e3 * levitation_depth(SIMPLIFIED),
            (*words, "each round wire a square one of equal second moment"),
        ),
        "difference_of_the_windings": Ours(100 * float(difference), words),
    }
