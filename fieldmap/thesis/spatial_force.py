"""S10: the force formula (4-9) against the drive unit of Appendix A-3 in three dimensions."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.iron import LinearSolution, solve_linear
from fieldmap.thesis import force_formulas
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.force_formulas import AddedError, Fit, HorizontalForce
from fieldmap.typing import Array

_DEVICE, _REFINEMENT, _MU_R = "drive_unit_a3", 0.4, 4000.0
# Electromagnets 1 and 4 of Fig. 4-8, on the x axis, by coil name; and the sides of the poles of their formulas.
ONE, FOUR = "2", "5"
_SIDES = {ONE: 1, FOUR: -1}
_A = 2.2e-2
"""Fixed a, m, in the fits for all six magnets; its value does not change the curve at one depth."""
_START = (0.2, 0.01, 0.05)
_BESIDE = (10e-3, 20e-3, 30e-3, -10e-3)


@cache
def unit() -> LinearSolution:
    """The solved unit of Appendix A-3 with linear iron."""
    return solve_linear(read_device(_DEVICE), mu_r=_MU_R, refinement=_REFINEMENT)


def places(half_width: float) -> Array:
    """Positions x (n,), m, at a spacing of 1 mm or slightly less."""
    return np.linspace(-half_width, half_width, 2 * int(np.ceil(half_width / 2e-3)) + 1)


@cache
def unit_forces(depth: float, half_width: float, y: float) -> Array:
    """F_x (coils, n) in N on the unit's magnet at 1 A in each coil alone, along a line of constant y."""
    payload = read_device(_DEVICE).payload
    assert payload is not None
    x = places(half_width)
    points = np.column_stack([x, np.full_like(x, y), np.full_like(x, -depth)])
    return np.asarray(payload.moment * unit().unit_fields(points)[1][:, :, 2, 0])


def _index(coil: str) -> int:
    return unit().coil_names.index(coil)


def fitted(
    coil: str, depth: float, half_width: float, a: float, side: int, y: Array | None = None
) -> Fit[HorizontalForce]:
    """(4-9) fitted for one coil on y = 0, or with its term in |y| on lines of given y."""
    lines = np.zeros(1) if y is None else y
    x = np.tile(places(half_width), len(lines))
    force = np.concatenate([unit_forces(depth, half_width, float(line))[_index(coil)] for line in lines])
    beside = None if y is None else np.repeat(y, len(x) // len(y))
    about: dict[str, Any] = {"y": beside, "side": side, "a": a, "start": _START}
    return force_formulas.fit_horizontal_force(x, np.full_like(x, depth), force, 1.0, **about)


def best_line_fit(coil: str, depth: float, half_width: float) -> Fit[HorizontalForce]:
    """(4-9) on y = 0 for one coil, with its pole on the side that fits better."""
    return min((fitted(coil, depth, half_width, _A, side) for side in (1, -1)), key=lambda fit: fit.rms)


QUADRATIC, HORIZONTAL = "quadratic (4-10)", "(4-9)"


@cache
def line_formulas(depth: float, half_width: float) -> dict[str, Array]:
    """(4-9) and (4-10) fitted to each coil on y = 0, (coils, n) in N at 1 A, by the formula's name."""
    x, force = places(half_width), unit_forces(depth, half_width, 0.0)
    fits = [best_line_fit(name, depth, half_width) for name in unit().coil_names]
    return {
        HORIZONTAL: np.array([fit.formula(x, depth, 1.0) for fit in fits]),
        QUADRATIC: np.array([force_formulas.fit_quadratic_force(x, line).formula(x, 1.0) for line in force]),
    }


def added_errors(depth: float, half_width: float, formula: str = HORIZONTAL) -> tuple[AddedError, ...]:
    """Errors for one magnet (1), two (1 and 4), and all six, with a formula of `line_formulas`."""
    x, force = places(half_width), unit_forces(depth, half_width, 0.0)
    errors = []
    for chosen in ((ONE,), (ONE, FOUR), unit().coil_names):
        rows = [_index(name) for name in chosen]
        added, total = (of[rows].sum(axis=0) for of in (line_formulas(depth, half_width)[formula], force))
        errors.append(force_formulas.added_error((1.0,) * len(rows), added, total, np.abs(x) <= 0.0101))
    return tuple(errors)


def constants(inputs: dict[str, Any]) -> Answers:
    """Table 4-3, and the errors of the added formulas."""
    depth, half_width = 1e-3 * inputs["depth_mm"], 1e-3 * inputs["half_width_mm"]
    fits = [
        fitted(coil, depth, half_width, float(a), _SIDES[coil])
        for coil, a in zip((ONE, FOUR), inputs["a_m"], strict=True)
    ]
    y, a = 1e-3 * inputs["y_mm"], float(inputs["a_m"][0])
    plane = fitted(ONE, depth, half_width, a, _SIDES[ONE], y)
    names = {"L0": "inductance", "b": "b", "c": "c"}
    numbers: dict[str, Any] = {name: [getattr(fit.formula, of) for fit in fits] for name, of in names.items()}
    numbers["d"] = plane.formula.d
    facts = {
        "device": _DEVICE,
        "mu_r": _MU_R,
        "refinement": _REFINEMENT,
        "rms_mN": [1e3 * fit.rms for fit in fits],
        "plane_rms_mN": 1e3 * plane.rms,
        "formula": added_errors(depth, half_width),
        "quadratic": added_errors(depth, half_width, QUADRATIC),
    }
    return Answers(numbers, tuple(_figures(depth, half_width, fits, plane)), facts)


def _figures(
    depth: float, half_width: float, fits: list[Fit[HorizontalForce]], plane: Fit[HorizontalForce]
) -> Iterator[Curves]:
    """Figures of electromagnets 1 and 4 on the axis, computed and by the formula; of electromagnet 1 on lines of
    constant y; and of the added formulas of several electromagnets."""
    x, force = places(half_width), unit_forces(depth, half_width, 0.0)

    def along_x(title: str, lines: dict[str, Array], remark: str = "") -> Curves:
        series = tuple(Series(name, 1e3 * x, 1e3 * line) for name, line in lines.items())
        return Curves(f"{title}, {1e3 * depth:g} mm deep", "x (mm)", "$F_x$ (mN)", series, remark)

    lines = {}
    for name, coil, fit in (("1", ONE, fits[0]), ("4", FOUR, fits[1])):
        lines[f"electromagnet {name}"] = force[_index(coil)]
        lines[f"(4-9) fitted to {name}"] = fit.formula(x, depth, 1.0)
    remark = "The printed constants of Table 4-3 have a pole inside the range and are not drawn."
    yield along_x("Figs 4-10, 4-11: one electromagnet, y = 0", lines, remark)
    beside = {f"y = {1e3 * y:g} mm": unit_forces(depth, half_width, y)[_index(ONE)] for y in _BESIDE}
    beside["(4-9) fitted"] = plane.formula(x, depth, 1.0, y=_BESIDE[0])
    remark = "(4-9) fitted to all lines at once: its term in |y| comes out of no use, so that it says the same of each."
    yield along_x("Figs 4-12 to 4-15: electromagnet 1 beside the axis", beside, remark)
    formulas = line_formulas(depth, half_width).items()
    forces = {"computed": force} | {f"{name} fitted and added": lines for name, lines in formulas}
    two, six = "Figs 4-9, 4-16: electromagnets 1 and 4", "All six electromagnets"
    for title, chosen in ((two, (ONE, FOUR)), (six, unit().coil_names)):
        rows = [_index(name) for name in chosen]
        added = {name: of_coils[rows].sum(axis=0) for name, of_coils in forces.items()}
        yield along_x(f"{title}, 1 A each", added)
