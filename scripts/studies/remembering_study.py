"""Does the hysteresis that was fitted to Table 6-4 of the thesis predict its dynamic tables?

    python scripts/studies/remembering_study.py [--only gains branches steps rests identified rows bars pictures]

The map of maps/remembering.toml is used with its memory and without (the same model without its cells). gains: shift
and lift of the magnet per unit of a signal, over the size of a loop. branches: Tables 6-4 to 6-7 by the map and by the
full solver. steps: Tables 7-1 and 7-2. rests: rest positions under PD control, 6.5. identified: Table 5-2 and the
integral times of 6.7 from steps of the unit. rows: other parts of `fieldmap thesis` on the unit. bars: standard
deviations of gains and steps from those of the three fitted numbers; needs the map of another joint,
`fieldmap map remembering --set parameters.joint=0.137 -o maps/out/remembering_joint.h5`. pictures: into a folder.
docs/remembering_study.md discusses the figures.
"""

import argparse
import os
from collections.abc import Callable, Mapping
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from dataclasses import dataclass, replace  # noqa: E402

import numpy as np  # noqa: E402
from remembering import bars as fit_bars  # noqa: E402
from remembering import experiments, pictures, places  # noqa: E402
from remembering.unit import Unit, unit  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from fieldmap.iron import HysteresisSolver  # noqa: E402

CONSOLE = Console(width=150)
AMPLITUDES = (0.005, 0.02, 0.05, 0.1, 0.2)
LEVEL_LOOPS = (0.001, 0.006, 0.02, 0.06, 0.12)
DERIVATIVES, NOISES = ("measurement", "error"), {"with memory": (1.0, 0.2, 0.0), "without": (1.0,)}
"""Factors of the noise of Table 3-8. Iron without memory needs one only, because noise does not change its results."""
PARTS = (
    "S18_spikes",
    "S18_combined",
    "S18_sway",
    "S18_regulator",
    "S18_heights",
    "S18_range",
)


@dataclass(frozen=True)
class Given:
    """Arguments of the command line."""

    map: str
    joint_map: str
    parts: tuple[str, ...]
    folder: Path

    @property
    def both(self) -> dict[str, Unit]:
        """The unit with memory and without."""
        return {"with memory": unit(self.map), "without": unit(self.map, 0.0)}


def gains(given: Given) -> None:
    """Print slopes between the ends of the second of two loops of each size, after the history "shaken"; and from the
    start to a signal on the first way out, as in Tables 6-4 and 6-6."""
    both = given.both
    for axis in places.AXES:
        table = Table("loop of the signal", *both, title=f"{axis} of the magnet, mm per unit of its signal")
        for size in AMPLITUDES:
            row = (f"{places.gain(one, axis, size):.1f}" for one in both.values())
            table.add_row(f"+- {size:g}", *row)
        row = (f"{places.way_out(one, axis, AMPLITUDES[3]):.1f}" for one in both.values())
        table.add_row(f"first way out to {AMPLITUDES[3]:g}", *row)
        CONSOLE.print(table)
    table = Table("loop of all currents", *both, title="d ln(lift) / d ln(current)")
    for share in LEVEL_LOOPS:
        row = (f"{places.gain_of_lift(one, share):.3f}" for one in both.values())
        table.add_row(f"+- {100 * share:g} %", *row)
    CONSOLE.print(table)


def branches(given: Given) -> None:
    """Print the largest difference between map and full solver along Tables 6-4 to 6-7, with the lift held."""
    one = unit(given.map)
    solver = HysteresisSolver(one.device, None, places.REFINEMENT)
    table = Table(
        "table", "largest difference, mm", "largest shift, mm", title="branches by map and full solver"
    )
    for number, which in enumerate(places.BRANCHES):
        full = places.branch_of_solver(one, solver, *which)
        difference = np.abs(places.branch(one, *which) - full).max()
        table.add_row(f"6-{4 + number}", f"{difference:.3f}", f"{np.abs(full).max():.2f}")
    CONSOLE.print(table)


def steps(given: Given) -> None:
    """Print Tables 7-1 and 7-2 for several noises of the sensors and both derivatives of the controllers: means of some
    runs, and their standard deviations."""
    for step in experiments.STEPS:
        table = Table("iron", "derivative of", "noise", *experiments.FIGURES, title=step.name)
        table.add_row("rig", "", "", *(f"{number:.3g}" for number in step.rig))
        for name, one in given.both.items():
            for derivative in DERIVATIVES:
                for noise in NOISES[name]:
                    found = experiments.step_figures(replace(one, derivative=derivative, noise=noise), step)
                    # The settling time of a run that does not settle is infinite, and its deviation NaN.
                    with np.errstate(invalid="ignore"):
                        mean, spread = found.mean(axis=0), found.std(axis=0)
                    row = (f"{m:.3g} ({s:.1g})" for m, s in zip(mean, spread, strict=True))
                    table.add_row(name, derivative, f"{noise:g}", *row)
        CONSOLE.print(table)


def rests(given: Given) -> None:
    """Print rest positions under PD control on the path of 6.5, mm, for several noises."""
    asked = [f"{place:g}" for place in experiments.ASKED.values()]
    for axis, rig in experiments.RESTS.items():
        title = f"{axis} under PD control, asked to go to 1 mm, to -1 mm and back by steps of 0.1 mm"
        table = Table("iron", "noise", *asked, title=title)
        table.add_row("rig", "", *(f"{rig[k]:.3f}" if k in rig else "" for k in experiments.ASKED))
        for name, one in given.both.items():
            for noise in NOISES[name]:
                found = experiments.rests(replace(one, noise=noise), axis)
                table.add_row(name, f"{noise:g}", *(f"{place:.3f}" for place in found))
        CONSOLE.print(table)


def identified(given: Given) -> None:
    """Print Table 5-2 and the integral times of 6.7, from steps of the unit."""
    table = Table(
        "iron", "derivative of", "K_c, V/mm", "slowest pair", "zero", title="(5-15) by the thesis's estimator"
    )
    times = Table("iron", "derivative of", "model's integral times, s", title="6.7; rig 0.125, 0.098, 0.14")
    for name, one in given.both.items():
        for derivative in DERIVATIVES:
            made = replace(one, derivative=derivative)
            for gain, pair, zero in zip(*experiments.poles(made), strict=True):
                words = f"{pair.real:.4f} +- {pair.imag:.4f}i"
                table.add_row(name, derivative, f"{gain:g}", words, f"{zero:.4f}")
            times.add_row(name, derivative, ", ".join(f"{t:.3f}" for t in experiments.integral_times(made)))
    CONSOLE.print(table, times)


def rows(given: Given) -> None:
    """Print parts of `fieldmap thesis` on the unit, with the derivative of the measurement and Table 3-8's noise."""
    both = given.both
    for part in given.parts:
        table = Table("quantity", "thesis", *both, title=part)
        found = [list(experiments.rows(one, part)) for one in both.values()]
        for pair in zip(*found, strict=False):
            # Different words of the columns are both shown, in the order of the columns.
            words = " | ".join(dict.fromkeys(text for text, *_ in pair))
            table.add_row(words, f"{pair[0][1]:.4g}", *(f"{number:.4g}" for *_, number in pair))
        CONSOLE.print(table)


def bars(given: Given) -> None:
    """Print standard deviations of predictions from those of joint, coercive field and h."""
    each = fit_bars.units(given.map, given.joint_map)
    CONSOLE.print("factor on the force:", {name: round(float(one.scale), 3) for name, one in each.items()})
    found = fit_bars.covariance(each)
    words = dict(zip(fit_bars.FITTED, found.deviations.round(4).tolist(), strict=True))
    CONSOLE.print(f"Table 6-4 on this mesh: off by {found.misfit:.2f} mm rms; standard deviations", words)
    CONSOLE.print("correlation", found.correlation.round(2).tolist())
    _show_bars("gains", fit_bars.gains(each), found)
    for derivative in DERIVATIVES:
        _show_bars(f"steps, derivative of the {derivative}", fit_bars.steps(each, derivative), found)


def _show_bars(
    title: str, numbers: Mapping[str, Mapping[str, np.ndarray]], found: fit_bars.Covariance
) -> None:
    changed = [f"{name.split(',')[0]} {after:g}" for name, (_, after) in fit_bars.FITTED.items()]
    table = Table("figure", "as fitted", *changed, "+-", title=title)
    for words, by_unit in numbers.items():
        row = (f"{number:.3g}" for number in by_unit.values())
        table.add_row(words, *row, f"{float(fit_bars.bar(found, by_unit)):.2g}")
    CONSOLE.print(table)


def draw(given: Given) -> None:
    """Draw both pictures of the page."""
    for path in pictures.draw(given.both, given.folder):
        CONSOLE.print(path)


GROUPS: dict[str, Callable[[Given], None]] = {
    "gains": gains,
    "branches": branches,
    "steps": steps,
    "rests": rests,
    "identified": identified,
    "rows": rows,
    "bars": bars,
    "pictures": draw,
}


def main() -> None:
    """Print the selected tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    parser.add_argument("--map", default="maps/out/remembering.h5")
    parser.add_argument("--joint-map", default="maps/out/remembering_joint.h5", help="for bars")
    parser.add_argument("--parts", nargs="+", default=list(PARTS), help="of `fieldmap thesis`, for rows")
    parser.add_argument("--folder", default="docs/images", type=Path, help="for pictures")
    options = parser.parse_args()
    given = Given(options.map, options.joint_map, tuple(options.parts), options.folder)
    for name in options.only:
        GROUPS[name](given)


if __name__ == "__main__":
    main()
