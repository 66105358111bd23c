"""The summary of a map, for people: at most 100 columns and about 25 lines."""

from collections.abc import Iterator
from typing import Any

from fieldmap.cli.assumptions import payload_assumptions
from fieldmap.cli.printing import console, facts, heading, table


def print_text(summary: dict[str, Any]) -> None:
    """Print a summary made by `fieldmap.cli.summary.summarise`."""
    out = console()
    out.print(heading(summary["path"], summary["title"]))
    out.print(facts(_facts(summary)))
    out.print(_unit_table(summary))
    if summary["lift"]:
        out.print(_lift_table(summary))
    assumptions = (*summary["solver"].get("assumptions", ()), *payload_assumptions(summary["payload"]))
    out.print(facts(("assumes" if index == 0 else "", text) for index, text in enumerate(assumptions)))
    if summary["saturation"]:
        out.print(summary["saturation"], style="bold")


def _facts(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    grid, solver = summary["grid"], summary["solver"]
    names = summary["coil_names"]
    yield "device", f"{summary['device']}, {len(names)} coils: {', '.join(names)}"
    yield "iron", ", ".join(_solver_words(solver))
    shape = " x ".join(str(n) for n in grid["shape"])
    spacing = " x ".join(f"{1e3 * d:g}" for d in dict.fromkeys(grid["spacing"].round(9)))
    corners = f"{_mm(grid['lower'])} to {_mm(grid['upper'])} mm"
    yield "grid", f"{shape} nodes, {spacing} mm apart, from {corners}"
    yield "file", f"{summary['size'] / 1e6:.2f} MB, made {summary['created']}"
    error = summary["interpolation_error"]
    if error is not None:
        yield (
            "interpolation",
            f"off by at most {1e6 * error.flux_density:.2g} uT and {1e3 * error.gradient:.2g} mT/m at sampled "
            "points (1 A in each coil)",
        )


def _solver_words(solver: dict[str, Any]) -> list[str]:
    words = ["linear"]
    for key, text in (("faces", "{} boundary faces"), ("elements", "{} elements")):
        if key in solver:
            words.append(text.format(solver[key]))
    if "seconds" in solver:
        words.append(f"{solver['seconds']:.0f} s")
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
        heights = ((f"magnet at z = {_mm_z(row)} mm", f"{row['current']:.3f}") for row in summary["lift"])
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
    return table(columns, rows)


def _mm_z(row: dict[str, Any]) -> str:
    return f"{1e3 * row['height']:.1f}"
