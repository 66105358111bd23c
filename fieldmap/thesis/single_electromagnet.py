"""S3, S4, S6: magnets; the single electromagnet of section 2.3 with its exact and its simplified winding and its
levitated sphere; and the lumped model of levitation."""

from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap.constants import MU0
from fieldmap.control import lumped_magnet_from_lift_currents
from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.iron import LinearSolution, solve_linear
from fieldmap.levitation import GRAVITY
from fieldmap.thesis.computation import Answers, Ours
from fieldmap.typing import Array

EXACT, SIMPLIFIED = "single_electromagnet", "single_electromagnet_simplified"
CURRENTS = {EXACT: np.array([1.0]), SIMPLIFIED: np.full(5, 100.0)}
_REFINEMENT = 1.5


@cache
def solved(name: str, refinement: float) -> LinearSolution:
    """The solved electromagnet with one of the two windings."""
    return solve_linear(read_device(name), refinement=refinement)


def axis_curves(name: str, depth: Array) -> tuple[Array, Array]:
    """B_z (n,), T, and dB_z/dz (n,), T/m, z up, at depths (n,), m, below the core."""
    points = np.column_stack([0 * depth, 0 * depth, -depth])
    unit, currents = solved(name, _REFINEMENT), CURRENTS[name]
    return unit.field(points, currents)[:, 2], unit.gradient(points, currents)[:, 2, 2]


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
    """Levitation depth of the sphere, and difference of the two windings' fields (Fig. 2-4)."""
    depth = 1e-3 * np.linspace(inputs["near_mm"], inputs["far_mm"], 80)
    exact, simplified = (axis_curves(name, depth)[0] for name in (EXACT, SIMPLIFIED))
    difference = np.abs(simplified / exact - 1).max()
    reported = solved(EXACT, _REFINEMENT).report.assumptions
    answers = {
        "depth_exact": 1e3 * levitation_depth(EXACT),
        "depth_simplified": 1e3 * levitation_depth(SIMPLIFIED),
        "difference_of_the_windings": 100 * float(difference),
    }
    numbers = {name: Ours(value, reported) for name, value in answers.items()}
    depth, near = np.linspace(depth[0], depth[-1], 200), np.linspace(0.03, 0.06, 120)
    label = "500 turns, 1 A"
    (exact, slope), (simplified, _) = (axis_curves(name, depth) for name in (EXACT, SIMPLIFIED))
    lines = {label: exact, "5 turns, 100 A": simplified}
    flux = tuple(Series(name, 1e3 * depth, 1e3 * one) for name, one in lines.items())
    carried, at, printed = _payload(EXACT), answers["depth_exact"], inputs["printed_depth_mm"]
    weight = 1e3 * carried.mass * GRAVITY
    force = (
        Series("magnetic force", 1e3 * near, 1e3 * (carried.moment * axis_curves(EXACT, near)[1])),
        Series("weight", 1e3 * near[[0, -1]], np.full(2, weight)),
        Series(f"balance at {at:.1f} mm", np.array([at]), np.array([weight]), points=True),
        Series(
            f"the thesis's {printed:g} mm", np.array([printed]), np.array([weight]), "published", points=True
        ),
    )
    x, title = "depth below the core (mm)", "Fig. 2-4: exact and simplified winding"
    rise = ("Fig. 2-5: gradient on the axis, z upwards", x, r"$\partial B_z/\partial z$ (T/m)")
    curves = (
        Curves(title, x, "$B_z$ (mT)", flux, "The two lines lie on each other."),
        Curves(*rise, (Series(label, 1e3 * depth, slope),), log_y=True),
        Curves("Fig. 2-6: force on the 1 mm sphere", x, "force (mN)", force),
    )
    return Answers(numbers, curves, {"refinement": _REFINEMENT})


def sphere_and_microrobot(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 2-2 and 3.8: volumes of sphere and cylinder, mass, and the moment (2-12)."""
    sphere = np.pi / 6.0 * (1e-3 * inputs["sphere_diameter_mm"]) ** 3
    cylinder = np.pi / 4.0 * (1e-3 * inputs["magnet_diameter_mm"]) ** 2 * 1e-3 * inputs["magnet_height_mm"]
    payload = _payload("drive_unit")
    return {
        "sphere_volume": sphere,
        "sphere_mass": inputs["sphere_density"] * sphere,
        "sphere_moment": inputs["sphere_remanence_T"] * sphere / MU0,
        "magnet_moment": inputs["magnet_remanence_T"] * cylinder / MU0,
        "payload_mass": 1e3 * payload.mass,
        "payload_moment": payload.moment,
    }


def lumped_model(inputs: dict[str, Any]) -> dict[str, Any]:
    """(2-18)..(2-22) against finite differences of the nonlinear equation, and against the identified plant."""
    magnet = lumped_magnet_from_lift_currents(
        inputs["current_at_zero_A"], 1e3 * inputs["slope_A_per_mm"], 1e-3 * inputs["mass_g"]
    )
    z = 1e-3 * inputs["depth_mm"]
    current, plant = magnet.equilibrium_current(z), magnet.plant(z)
    dz, di = 1e-5 * z, 1e-5 * current
    by_z = (magnet.acceleration(z + dz, 0, current) - magnet.acceleration(z - dz, 0, current)) / (2 * dz)
    by_i = (magnet.acceleration(z, 0, current + di) - magnet.acceleration(z, 0, current - di)) / (2 * di)
    return {
        "stiffness_term": plant.A[1, 0] / by_z,
        "current_term": plant.B[1, 0] / by_i,
        "sign_of_gain": float(np.sign(plant.B[1, 0])),
        "sign_of_damping": float(np.sign(inputs["identified_denominator"][1])),
        "product_of_poles": float(np.linalg.det(plant.A)),
    }
