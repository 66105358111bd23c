"""Figures of the thesis's chapters 2 and 4 with our curves: matplotlib, no window."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldmap.thesis import planar_force, planar_unit, single_electromagnet

_WIDTH, _HEIGHT = 6.4, 4.4
_RATIOS = ((1.0, "1:1"), (11 / 9, "1:1.22"), (1.5, "1:1.5"), (3.0, "1:3"))


def save_thesis_figures(folder: str | Path) -> list[Path]:
    """Draw all figures into a folder, which is made if it is not there; returns the paths of the PNG files."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    return [_save(draw, target / f"{name}.png") for name, draw in FIGURES.items()]


def _save(draw: Callable[[Figure], None], path: Path) -> Path:
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained", dpi=130)
    FigureCanvasAgg(figure)
    draw(figure)
    figure.savefig(path)
    return path


def _axes(figure: Figure, x: str, y: str, title: str) -> Axes:
    axes = figure.add_subplot()
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, fontsize=10)
    axes.grid(color="0.9")
    return axes


def _curves(name: str, far: float) -> single_electromagnet.AxisCurves:
    return single_electromagnet.axis_curves(name, np.linspace(0.5e-3, far, 200))


def electromagnet_field(figure: Figure) -> None:
    """Fig. 2-4."""
    axes = _axes(figure, "depth below the core (mm)", "$B_z$ (mT)", "Fig. 2-4: exact and simplified winding")
    for name, style, label in (
        (single_electromagnet.EXACT, "-", "500 turns, 1 A"),
        (single_electromagnet.SIMPLIFIED, "--", "5 turns, 100 A"),
    ):
        curves = _curves(name, 0.1)
        axes.plot(1e3 * curves.depth, 1e3 * curves.flux_density, style, label=label)
    axes.legend()


def electromagnet_gradient(figure: Figure) -> None:
    """Fig. 2-5."""
    axes = _axes(
        figure, "depth below the core (mm)", r"$\partial B_z/\partial z$ (T/m)", "Fig. 2-5: gradient, z up"
    )
    curves = _curves(single_electromagnet.EXACT, 0.1)
    axes.semilogy(1e3 * curves.depth, curves.gradient)


def electromagnet_force(figure: Figure) -> None:
    """Fig. 2-6."""
    axes = _axes(figure, "depth below the core (mm)", "force (mN)", "Fig. 2-6: force on the 1 mm sphere")
    name = single_electromagnet.EXACT
    curves = single_electromagnet.axis_curves(name, np.linspace(0.03, 0.06, 120))
    depth = single_electromagnet.levitation_depth(name)
    weight = float(np.interp(depth, curves.depth, curves.force))
    axes.plot(1e3 * curves.depth, 1e3 * curves.force, label="magnetic force")
    axes.axhline(1e3 * weight, color="0.3", linestyle="--", label="weight")
    axes.plot(1e3 * depth, 1e3 * weight, "ko")
    axes.annotate(f"{1e3 * depth:.1f} mm", (1e3 * depth, 1e3 * weight), (8, 8), textcoords="offset points")
    axes.legend()


def planar_ratios(figure: Figure) -> None:
    """Figs 2-9, 2-10: B_z along x at 100 mm, its maxima being the equilibria; with the box and in open space."""
    x = np.linspace(-planar_unit.WINDOW, planar_unit.WINDOW, 300)
    _planar_panels(
        figure, "Figs 2-9, 2-10: 100 mm below the pole piece", x, [(r, 0.1, t) for r, t in _RATIOS]
    )


def planar_depths(figure: Figure) -> None:
    """Fig. 2-11: B_z along x at several depths, ratio 1:1.5."""
    x = np.linspace(-planar_unit.WINDOW, planar_unit.WINDOW, 300)
    depths = [(1.5, depth, f"{1e3 * depth:g} mm") for depth in (0.07, 0.085, 0.1, 0.125, 0.15, 0.2)]
    _planar_panels(figure, "Fig. 2-11: ratio 1:1.5 at several depths", x, depths)


def _planar_panels(figure: Figure, title: str, x: Any, lines: list[tuple[float, float, str]]) -> None:
    for k, (walls, words) in enumerate(((True, "box without flux"), (False, "open space"))):
        axes = figure.add_subplot(1, 2, k + 1)
        solved = planar_unit.unit(walls)
        for ratio, depth, label in lines:
            amperes = planar_unit.currents(ratio, 1000.0)
            field = solved.field(np.column_stack([x, np.full_like(x, -depth)]), amperes)[:, 1]
            (line,) = axes.plot(1e3 * x, 1e3 * field, label=label)
            place = planar_unit.reached_from_the_middle(solved, amperes, -depth)
            if np.isfinite(place):
                height = solved.field([[place, -depth]], amperes)[0, 1]
                axes.plot(1e3 * place, 1e3 * height, "o", color=line.get_color())
        axes.set(xlabel="x (mm)", ylabel="$B_z$ (mT)" if not k else "")
        axes.set_title(words, fontsize=9)
        axes.grid(color="0.9")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=len(lines), fontsize=8)
    figure.suptitle(title, fontsize=10)


def planar_formula(figure: Figure) -> None:
    """Figs 4-5, 4-7: one electromagnet, and two at 3:1; computed, with Table 4-2, and refitted."""
    depth = 0.125
    x = np.linspace(-planar_force.HALF_WIDTH, planar_force.HALF_WIDTH, 200)
    z = np.full_like(x, depth)
    fitted = planar_force.horizontal_fit((depth,), 0.22).formula
    printed = replace(fitted, inductance=-2e-13, a=0.22, b=0.05, c=-0.08)
    for k, (pair, words) in enumerate(
        (((1.0, 0.0), "Fig. 4-5: left one alone"), ((1.5, 0.5), "Fig. 4-7: 3:1"))
    ):
        axes = figure.add_subplot(1, 2, k + 1)
        axes.plot(1e3 * x, planar_force.force(pair, x, z)[:, 0], "k", label="computed")
        axes.plot(1e3 * x, planar_force.added(printed, pair, x, z), "--", label="(4-7), Table 4-2")
        axes.plot(1e3 * x, planar_force.added(fitted, pair, x, z), ":", label="(4-7), our constants")
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.set(xlabel="x (mm)", ylabel="$F_x$ (N)" if not k else "")
        axes.set_title(words, fontsize=9)
        axes.grid(color="0.9")
    axes.legend(fontsize=8)


FIGURES: dict[str, Callable[[Figure], None]] = {
    "figure_2_4_field": electromagnet_field,
    "figure_2_5_gradient": electromagnet_gradient,
    "figure_2_6_force": electromagnet_force,
    "figure_2_9_current_ratio": planar_ratios,
    "figure_2_11_depth": planar_depths,
    "figure_4_7_formula": planar_formula,
}
"""File name without ending -> what draws it."""
