"""The summary of a map, for people: at most 100 columns and about 25 lines."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Group
from rich.text import Text

from fieldmap.cli.assumptions import payload_assumptions
from fieldmap.cli.printing import assumption_lines, count_of, facts, heading, print_page, table
from fieldmap.cli.report_text import FORM_WORDS

RATIO = "A ratio above 1: this model needs more current than was measured (docs/theory/equilibrium.md)."


def print_text(summary: dict[str, Any]) -> None:
    """Print a summary made by `fieldmap.cli.summary.summarise`."""
    assumptions = (*summary["assumptions"], *payload_assumptions(summary["payload"]))
    print_page(
        Group(heading(summary["path"], summary["title"]), facts(_facts(summary))),
        _unit_table(summary),
        _lift_table(summary) if summary["lift"] else None,
        facts(assumption_lines(assumptions)),
        Text(summary["saturation"], style="bold") if summary["saturation"] else None,
    )


def _facts(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    grid, solver = summary["grid"], summary["solver"]
    names = summary["coil_names"]
    yield "device", f"{summary['device']}, {count_of(len(names), 'coil', 'coils')}: {', '.join(names)}"
    yield "iron", ", ".join(_solver_words(solver))
    shape = " x ".join(str(n) for n in grid["shape"])
    steps = dict.fromkeys(grid["spacing"].round(9))
    spacing = " x ".join(f"{1e3 * step:g}" for step in steps)
    corners = f"{_mm(grid['lower'])} to {_mm(grid['upper'])} mm"
    yield "grid", f"{shape} nodes, {spacing} mm apart, from {corners}"
    yield "file", f"{summary['size'] / 1e6:.2f} MB, made {summary['created']}"
    error = summary["interpolation_error"]
    if error is not None:
        sizes = f"{1e6 * error.flux_density:.2g} uT and {1e3 * error.gradient:.2g} mT/m"
        where = f"at sampled points, {summary['reference_current'][0]:g} A in every coil"
        yield "interpolation", f"within {sizes} of the solver {where}; mesh error not included"


def _solver_words(solver: dict[str, Any]) -> list[str]:
    if solver.get("form") == "coils":
        return [FORM_WORDS["coils"]]
    words = ["linear"]
    if "form" in solver:
        words.append(FORM_WORDS.get(solver["form"], str(solver["form"])))
    for key, text in (("tetrahedra", "tetrahedra"), ("surface_faces", "surface faces")):
        if key in solver:
            words.append(f"{solver[key]:,} {text}".replace(",", " "))
    if isinstance(solver.get("seconds"), Mapping):
        words.append(f"{sum(solver['seconds'].values()):.0f} s")
    return words


def _mm(point: Any) -> str:
    return "(" + ", ".join(f"{1e3 * x:g}" for x in point.round(9)) + ")"


def _unit_table(summary: dict[str, Any]) -> Any:
    middle = summary["middle"]
    rows = (
        ("Bz, mT", *(f"{1e3 * value:.4f}" for value in middle["Bz"])),
        ("dBz/dz, mT/m", *(f"{1e3 * value:.4f}" for value in middle["dBz_dz"])),
    )
    names = [f"coil {name}" for name in summary["coil_names"]]
    return table((f"1 A, at {_mm(middle['at'])} mm", *names, "all"), rows)


def _lift_table(summary: dict[str, Any]) -> Any:
    payload = summary["payload"]
    title = f"lift {1e3 * payload.mass:.4g} g, {payload.moment:.3g} A m2"
    if summary["lift"][0]["thesis"] is None:
        lifts = summary["lift"]
        heights = ((f"magnet at z = {_mm_z(row)} mm", f"{row['current']:.3f}") for row in lifts)
        return table((title, "A per coil (linear)"), heights)
    rows = (
        (
            f"sensor {row['sensor_mm']:g} mm",
            _mm_z(row),
            f"{row['current']:.3f}",
            f"{row['thesis']:.3f}",
            f"{row['ratio']:.2f}",
        )
        for row in summary["lift"]
    )
    columns = (title, "magnet z, mm", "A per coil (linear)", "thesis (7-18), measured", "ratio")
    return Group(table(columns, rows), Text(f" {RATIO}", style="dim"))


def _mm_z(row: dict[str, Any]) -> str:
    return f"{1e3 * row['height']:.1f}"
