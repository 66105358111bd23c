"""S5: the two-dimensional drive unit of section 2.4, in a box without flux and in open space."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from fieldmap import planar
from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.planar import PlanarDevice, PlanarSolution, PlanarState, read_planar_device
from fieldmap.thesis.computation import Answers, Ours
from fieldmap.typing import Array

WINDOW = 0.165
"""Half the width of the search for zeros, m; half the pole piece is 0.17 m."""
_NO_FORCE = 1e-3
"""Horizontal forces below this share of the lift come from the asymmetric mesh; the smallest real one is 5e-2."""


@cache
def unit(walls: bool) -> PlanarSolution:
    """The solved drive unit of section 2.4, in its box or in open space."""
    device = read_planar_device("planar_drive_unit")
    return planar.solve_planar(device if walls else replace(device, walls=None))


def currents(ratio: float, nominal: float) -> Array:
    """Currents (2,) of left and right with the ratio 1 : ratio and twice the nominal current as their sum."""
    return 2 * nominal * np.array([1.0, ratio]) / (1.0 + ratio)


def reached_from_the_middle(solved: PlanarSolution | PlanarState, amperes: Array, z: float) -> float:
    """Stable x, m, towards which the force pushes a lifted vertical dipole from x = 0; NaN if there is none.

    If the force at x = 0 vanishes, the stationary point nearest to x = 0, stable or not.
    """
    return _reached(solved, tuple(map(float, amperes)), z)


# Cached, because a table and its figures need the same values.
@cache
def _reached(solved: PlanarSolution | PlanarState, of_coils: tuple[float, ...], z: float) -> float:
    amperes = np.array(of_coils)
    points = planar.stationary_points(solved, amperes, z, -WINDOW, WINDOW)
    # dB_z/dx over |dB_z/dz| at x = 0, positive where a lifted dipole is pushed to the right.
    _, slope, _ = solved.derivatives([[0.0, z]], amperes)[:, 0]
    force = float(slope.imag / slope.real)
    if abs(force) < _NO_FORCE:
        return min(points, key=lambda point: abs(point.x)).x
    ahead = [point for point in points if point.stable and point.x * force > 0]
    return min(ahead, key=lambda point: abs(point.x)).x if ahead else float("nan")


def _places() -> dict[str, PlanarSolution]:
    """The unit in its box and in open space, by their names in figures."""
    return {"box without flux": unit(True), "open space": unit(False)}


def _in_both(compute: Callable[[PlanarSolution], dict[str, Any]]) -> dict[str, Ours]:
    """Numbers of the unit in its box and, under names that end in _in_open_space, in open space."""
    numbers: dict[str, Ours] = {}
    for suffix, solved in zip(("", "_in_open_space"), _places().values(), strict=True):
        reported = solved.report.assumptions
        numbers |= {name + suffix: Ours(value, reported) for name, value in compute(solved).items()}
    return numbers


def current_ratio(inputs: dict[str, Any]) -> Answers:
    """Table 2-3."""
    z, nominal = -1e-3 * inputs["depth_mm"], inputs["nominal_current_A"]

    divided = [currents(ratio, nominal) for ratio in inputs["exact_ratios"]]

    def positions(solved: PlanarSolution) -> dict[str, Any]:
        return {"equilibrium": [1e3 * reached_from_the_middle(solved, amperes, z) for amperes in divided]}

    states = [saturating(ratio, nominal) for ratio in inputs["exact_ratios"]]
    moved = [1e3 * reached_from_the_middle(state, state.currents, z) for state in states]
    numbers = _in_both(positions) | {"equilibrium_with_curve": Ours(moved, states[0].report.assumptions)}
    named = zip(("1:1", "1:1.22", "1:1.5", "1:3"), divided, inputs["table_2_3_mm"], strict=True)
    lines = [_Line(label, amperes, -z, float(mm)) for label, amperes, mm in named]
    title, table = f"{inputs['depth_mm']:g} mm below the pole piece", "Table 2-3"
    near = _flux_density_along_x(f"Fig. 2-10: close up, {title}", lines, table, (0.02, 0.09))
    return Answers(numbers, (*_flux_density_along_x(f"Fig. 2-9: {title}", lines, table), near[0]))


@cache
def saturating(ratio: float, nominal: float) -> PlanarState:
    """The unit in its box with the B-H curve of Appendix A-3, at a ratio of the currents."""
    return planar.solve_planar_state(_with_curve(), currents(ratio, nominal))


# One device for all states, so that they share its mesh.
@cache
def _with_curve() -> PlanarDevice:
    steel = read_device("drive_unit_a3").materials["steel"]
    return replace(read_planar_device("planar_drive_unit"), materials={"iron": steel})


def depth(inputs: dict[str, Any]) -> Answers:
    """Table 2-4."""
    amperes = currents(inputs["ratio"], inputs["nominal_current_A"])

    def positions(solved: PlanarSolution) -> dict[str, Any]:
        found = [reached_from_the_middle(solved, amperes, -1e-3 * mm) for mm in inputs["depths_mm"]]
        return {"equilibrium": 1e3 * np.array(found)}

    theirs = dict(zip(inputs["depths_mm"], inputs["table_2_4_mm"], strict=True))
    depths = (70.0, 85.0, 100.0, 125.0, 150.0, 200.0)
    lines = [_Line(f"{mm:g} mm deep", amperes, 1e-3 * mm, theirs.get(mm, np.nan)) for mm in depths]
    curves = _flux_density_along_x("Fig. 2-11: ratio 1:1.5 at several depths", lines, "Table 2-4")
    return Answers(_in_both(positions), curves)


def gradients(inputs: dict[str, Any]) -> Answers:
    """The three gradients that the text of section 2.4 states; depth counts downwards."""
    z, nominal = -1e-3 * inputs["depth_mm"], inputs["nominal_current_A"]
    names = ("vertical", "horizontal_large_ratio", "horizontal_small_ratio")

    def values(solved: PlanarSolution) -> dict[str, Any]:
        of_ratios = [currents(ratio, nominal) for ratio in (1.0, *inputs["exact_ratios"])]
        at = [solved.gradient([[0.0, z]], amperes)[0] for amperes in of_ratios]
        return dict(zip(names, (-at[0][1, 1], at[1][1, 0], at[2][1, 0]), strict=True))

    depths = np.linspace(0.06, 0.2, 200)

    def below(solved: PlanarSolution, label: str, ratio: float, x: float) -> Series:
        points = np.column_stack([np.full_like(depths, x), -depths])
        return Series(label, 1e3 * depths, 1e3 * solved.field(points, currents(ratio, nominal))[:, 1])

    middle = [below(solved, words, 1.0, 0.0) for words, solved in _places().items()]
    figures = {"Fig. 2-12: below the middle, ratio 1:1": middle}
    for words, solved in _places().items():
        sides = [below(solved, f"x = {1e3 * x:g} mm", 1.5, x) for x in (-0.1, -0.05, 0.0, 0.05, 0.1)]
        figures[f"Fig. 2-13: ratio 1:1.5, {words}"] = sides
    labels = ("depth below the pole piece (mm)", "$B_z$ (mT)")
    curves = tuple(Curves(title, *labels, tuple(lines)) for title, lines in figures.items())
    return Answers(_in_both(values), curves)


def zeros(inputs: dict[str, Any]) -> dict[str, Any]:
    """Number of points without horizontal gradient, near the pole piece and farther away."""
    solved = unit(True)
    amperes = currents(inputs["ratio"], inputs["nominal_current_A"])
    limits = 1e-3 * inputs["near_depth_mm"], 1e-3 * inputs["far_depth_mm"]
    above, below = (planar.stationary_points(solved, amperes, -depth, -WINDOW, WINDOW) for depth in limits)
    numbers = {
        "near": len(above),
        "near_unstable": sum(not point.stable for point in above),
        "far": len(below),
        "depth_of_the_change": 1e3 * fold_depth(solved, amperes, *limits),
    }
    return {name: Ours(value, solved.report.assumptions) for name, value in numbers.items()}


def fold_depth(solved: PlanarSolution, amperes: Array, near: float, far: float) -> float:
    """Depth, m, at which a stable and an unstable point meet on the weaker side and vanish.

    At this depth dB_z/dx has an extremum of value 0; `near` and `far` are depths with three points and with one.
    """

    def highest(depth: float) -> float:
        x = np.linspace(-WINDOW, 0.0, 400)
        second = solved.derivatives(np.column_stack([x, np.full(400, -depth)]), amperes)[2].imag
        k = int(np.flatnonzero(second[:-1] * second[1:] < 0)[-1])

        def bend(place: float) -> float:
            return float(solved.derivatives([[place, -depth]], amperes)[2].imag[0])

        top = float(brentq(bend, x[k], x[k + 1]))
        return float(solved.derivatives([[top, -depth]], amperes)[1].imag[0])

    return float(brentq(highest, near, far, xtol=1e-7))


class _Line(NamedTuple):
    """One line of constant depth, m; theirs: the equilibrium that the thesis prints for this line, mm, or NaN."""

    label: str
    amperes: Array
    depth: float
    theirs: float


def _flux_density_along_x(
    title: str, lines: list[_Line], table: str, window: tuple[float, float] = (-WINDOW, WINDOW)
) -> tuple[Curves, ...]:
    """B_z along x in a window, m, with the box and in open space."""
    remark = "Dots: equilibria reached from x = 0, at maxima of the field. Squares: those of the table, on our lines."
    figures = []
    for words, solved in _places().items():
        series, printed, ours = [], [], {}
        for line in lines:

            def upwards(x: Array, line: _Line = line, solved: PlanarSolution = solved) -> Array:
                points = np.column_stack([x, np.full_like(x, -line.depth)])
                return np.asarray(1e3 * solved.field(points, line.amperes)[:, 1])

            x = np.linspace(*window, 300)
            series.append(Series(line.label, 1e3 * x, upwards(x)))
            at = np.array([reached_from_the_middle(solved, line.amperes, -line.depth)])
            if at[0] >= window[0]:
                series.append(Series(line.label, 1e3 * at, upwards(at), points=True))
                ours[line.label] = 1e3 * at[0], line.theirs
            theirs = np.array([1e-3 * line.theirs])
            if theirs[0] >= window[0]:
                printed.append((1e3 * theirs[0], upwards(theirs)[0]))
        x, y = np.reshape(printed, (-1, 2)).T
        series.append(Series(table, x, y, "published", points=True))
        message = ""
        if len(ours) > 1:
            # Motion of the equilibrium from the first line to the last, and largest error of the table.
            (first, *_, last), places = ours, np.array(list(ours.values()))
            moved, off = abs(places[-1, 0] - places[0, 0]), np.nanmax(np.abs(np.diff(places)))
            message = (
                f"Equilibrium moves {moved:.0f} mm from {first} to {last}; {table} is within {off:.1f} mm"
            )
        labels = (f"{title}, {words}", "x (mm)", "$B_z$ (mT)")
        figures.append(Curves(*labels, tuple(series), remark, message=message))
    return tuple(figures)
