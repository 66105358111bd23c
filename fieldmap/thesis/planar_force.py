"""S9: the force formulas of chapter 4 against the planar drive unit with the pole piece 8 mm thick."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldmap import planar
from fieldmap.curves import Curves, Series, percent
from fieldmap.device import read_device
from fieldmap.thesis import force_formulas
from fieldmap.thesis.computation import Answers, Ours
from fieldmap.thesis.force_formulas import AddedError, Fit, HorizontalForce, VerticalForce
from fieldmap.typing import Array

HALF_WIDTH = 0.15
"""Half the width of the fitted range, m; half the pole piece is 0.17 m."""
MIDDLE = 0.05
"""Half the width of the middle of the pole piece, m, where the forces of two electromagnets cancel."""
DEPTHS = (0.10, 0.11, 0.12, 0.13, 0.14, 0.15)
"""The vertical operating window of 4.2, m."""
_X0, _CURRENT = -0.17, 1e6


@cache
def unit() -> planar.PlanarSolution:
    """The solved unit of chapter 4, in its box."""
    return planar.solve_planar(planar.read_planar_device("planar_drive_unit_8mm"))


def force(currents: tuple[float, float], x: Array, z: Array) -> Array:
    """(F_x, F_z) (n, 2) in N on the vertical dipole of Table 4-1 at depths z; currents in units of 1e6 A."""
    solved = unit()
    assert solved.device.moment is not None
    gradient = solved.gradient(np.column_stack([x, -z]), _CURRENT * np.array(currents))
    return solved.device.moment * gradient[:, 1, :]


def grid(depths: tuple[float, ...] = DEPTHS) -> tuple[Array, Array]:
    """Places x and depths z (n,), m."""
    x, z = np.meshgrid(np.linspace(-HALF_WIDTH, HALF_WIDTH, 61), np.array(depths))
    return x.ravel(), z.ravel()


@cache
def horizontal_fit(
    depths: tuple[float, ...], a: float | None, current: float = _CURRENT
) -> Fit[HorizontalForce]:
    """(4-7) fitted to the left electromagnet's computed force at a current, A, which becomes the nominal current."""
    x, z = grid(depths)
    computed = force((current / _CURRENT, 0.0), x, z)[:, 0]
    return force_formulas.fit_horizontal_force(x, z, computed, current, _X0, a=a)


@cache
def vertical_fit() -> Fit[VerticalForce]:
    """(4-6) fitted to the left electromagnet's computed force in the operating window."""
    x, z = grid()
    return force_formulas.fit_vertical_force(x, z, force((1.0, 0.0), x, z)[:, 1], _CURRENT, _X0)


def added(formula: Any, currents: tuple[float, float], x: Array, z: Array) -> Array:
    """The formula of the left electromagnet and its mirror image, added; force (n,) in N."""
    left, right = (_CURRENT * current for current in currents)
    return np.asarray(formula(x, z, left) + formula.mirrored()(x, z, right))


def superposition_error(
    formula: HorizontalForce | VerticalForce, currents: tuple[float, float], depths: tuple[float, ...]
) -> AddedError:
    """Error of the added formulas against the computed force of both electromagnets."""
    x, z = grid(depths)
    computed = force(currents, x, z)[:, 0 if isinstance(formula, HorizontalForce) else 1]
    middle = np.abs(x) <= MIDDLE
    return force_formulas.added_error(currents, added(formula, currents, x, z), computed, middle)


def constants(inputs: dict[str, Any]) -> Answers:
    """Table 4-2: constants of (4-5) along the line of Fig. 4-5."""
    depth = (1e-3 * inputs["depth_mm"],)
    L0, a, b, c, current = (inputs[name] for name in ("L0_H", "a_m", "b_m", "c_N", "nominal_current_A"))
    fit = horizontal_fit(depth, a, current)
    printed = HorizontalForce(L0, a, b, c, _X0, current)
    x, z = grid(depth)
    error = printed(x, z, current) - force((current / _CURRENT, 0.0), x, z)[:, 0]
    formula = fit.formula
    ours = {"L0": formula.inductance, "b": formula.b, "c": formula.c}
    rms = {"rms_N": fit.rms, "printed_rms_N": float(np.sqrt(np.mean(error**2)))}
    curves = _formula_curves(printed, formula, depth[0])
    return Answers(_reported(ours), curves, {"half_width_mm": 1e3 * HALF_WIDTH, **rms})


def _reported(values: dict[str, float]) -> dict[str, Ours]:
    """The values with the assumptions of the solver's report."""
    return {name: Ours(value, unit().report.assumptions) for name, value in values.items()}


def _formula_curves(printed: HorizontalForce, fitted: HorizontalForce, depth: float) -> tuple[Curves, ...]:
    """Figs 4-5 and 4-7: the computed force along x, and (4-7) with our constants and with the printed ones."""
    x = np.linspace(-HALF_WIDTH, HALF_WIDTH, 200)
    z = np.full_like(x, depth)
    figures = []
    for pair, title in (
        ((1.0, 0.0), "Fig. 4-5: left electromagnet alone"),
        ((1.5, 0.5), "Fig. 4-7: currents 3:1"),
    ):
        lines = (
            Series("computed", 1e3 * x, force(pair, x, z)[:, 0]),
            Series("(4-7), our constants", 1e3 * x, added(fitted, pair, x, z)),
            Series("(4-7), Table 4-2", 1e3 * x, added(printed, pair, x, z), "published"),
        )
        remark = f"{1e3 * depth:g} mm below the pole piece."
        size = float(np.ptp(lines[0].y))
        ours, theirs = (percent(float(np.abs(one.y - lines[0].y).max()) / size) for one in lines[1:])
        message = f"(4-7) is within {ours} of the computed force's range, with Table 4-2 within {theirs}"
        figures.append(Curves(title, "x (mm)", "$F_x$ (N)", lines, remark, message=message))
    return tuple(figures)


def superposition(inputs: dict[str, Any]) -> Answers:
    """Two electromagnets at 3:1 (Fig. 4-7): zeros of (4-7) + (4-8) and of the computed force."""
    depth = 1e-3 * inputs["depth_mm"]
    currents = (0.5 * inputs["ratio"], 0.5)
    amperes, along = _CURRENT * np.array(currents), horizontal_fit((depth,), inputs["a_m"]).formula
    (point,) = planar.stationary_points(unit(), amperes, -depth, -HALF_WIDTH, HALF_WIDTH)
    # Zero of the refitted (4-7) + (4-8), m.
    vanishes = brentq(
        lambda x: float(added(along, currents, np.array([x]), np.array([depth]))[0]), -0.12, 0.12
    )
    numbers = {"equilibrium": 1e3 * point.x, "equilibrium_of_refitted": 1e3 * float(vanishes)}
    # Lift at x = 0 with the B-H curve of Appendix A-3, over that with linear iron.
    steel, below = read_device("drive_unit_a3").materials["steel"], [[0.0, -depth]]
    saturating = planar.solve_planar_state(replace(unit().device, materials={"iron": steel}), amperes)
    share = saturating.gradient(below)[0, 1, 1] / unit().gradient(below, amperes)[0, 1, 1]
    # One electromagnet, two at 1:1, and two at the ratio of Fig. 4-7.
    pairs = ((1.0, 0.0), (1.0, 1.0), currents)
    facts = {
        "saturating_share": float(share),
        "horizontal": [superposition_error(along, pair, (depth,)) for pair in pairs],
        "vertical": [superposition_error(vertical_fit().formula, pair, DEPTHS) for pair in pairs],
    }
    return Answers(_reported(numbers), tuple(_vertical_curves()), facts)


def _vertical_curves() -> list[Curves]:
    """Figs 4-2 to 4-4: the vertical force of the left electromagnet over depth and over x; Fig. 4-6: of both."""
    z, x, formula = np.linspace(DEPTHS[0], DEPTHS[-1], 100), np.zeros(100), vertical_fit().formula
    few = np.linspace(DEPTHS[0], DEPTHS[-1], 40)
    alone = force((1.0, 0.0), np.zeros(40), few)[:, 1]
    lines = (
        Series("computed", 1e3 * few, alone),
        Series("a line through it", 1e3 * few, np.poly1d(np.polyfit(few, alone, 1))(few)),
        Series("(4-3) with (4-4), our constants", 1e3 * few, formula(np.zeros(40), few, _CURRENT)),
    )
    down = ("depth below the pole piece (mm)", "$F_z$ (N)")
    curves = [Curves("Fig. 4-2: left electromagnet alone, below the middle", *down, lines)]
    places, depths = np.linspace(-HALF_WIDTH, HALF_WIDTH, 31), np.array(DEPTHS)
    heights = np.array([force((1.0, 0.0), np.full_like(depths, one), depths)[:, 1] for one in places])
    fitted = np.polyfit(depths, heights.T, 1)
    for number, name, label, values, part in (
        ("4-3", "slope", "slope m (N/m)", fitted[0], formula.slope),
        ("4-4", "intercept", "intercept b (N)", fitted[1], formula.intercept),
    ):
        series = (
            Series("lines through the computed force", 1e3 * places, values, points=True),
            Series("(4-4), our constants", 1e3 * places, part(places)),
        )
        curves.append(Curves(f"Fig. {number}: {name} of the vertical force over x", "x (mm)", label, series))
    both = (1.0, 1.0)
    of_both = (
        Series("computed", 1e3 * z, force(both, x, z)[:, 1]),
        Series("(4-6), our constants", 1e3 * z, added(formula, both, x, z)),
    )
    curves.append(Curves("Fig. 4-6: two electromagnets, below the middle", *down, of_both))
    return curves
