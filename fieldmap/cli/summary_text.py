"""The summary of a map, for people: at most 100 columns and about 25 lines."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Group
from rich.text import Text

from fieldmap.cli.assumptions import payload_assumptions
from fieldmap.cli.printing import assumption_lines, count_of, facts, heading, print_page, table
from fieldmap.cli.report_text import FORM_WORDS

RATIO = "A ratio above 1: this model needs more current than was measured (docs/theory/equilibrium.md)."

# By whether the map holds for all currents.
_CERTIFIED_CURRENTS = {True: "", False: " at all currents below; the errors of the current model come on top"}


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
    bound = summary["error_bounds"].get("harmonic")
    if bound is not None:
        sizes = f"{1e6 * bound.flux_density:.2g} uT and {1e3 * bound.gradient:.2g} mT/m"
        where = "anywhere in the box" + _CERTIFIED_CURRENTS[summary["current_domain"] is None]
        yield "certified", f"lookups (harmonic) are within {sizes} of the solver {where}"
    yield from _current_facts(summary)


def _current_facts(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    domain, solver = summary["current_domain"], summary["solver"]
    if domain is None:
        return
    ranges = list(domain["ranges"].items())
    exponent = domain["division_exponent"]
    if exponent is not None:
        words = ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in ranges)
        yield "currents", f"division (6-3) with n = {exponent:g}: {words} (u in A)"
    elif len({bounds for _, bounds in ranges}) == 1 and [*domain["ranges"]] == [*summary["coil_names"]]:
        yield "currents", f"{ranges[0][1][0]:g} to {ranges[0][1][1]:g} A in every coil, independently"
    else:
        yield "currents", ", ".join(f"{name}: {low:g} to {high:g} A" for name, (low, high) in ranges)
    yield (
        "reduced model",
        (
            f"{solver['modes']} modes and {solver['sample_points']} points from {solver['states_trained_on_solved']} "
            f"solved states, {solver['corners_trained_on']} of them corners of the domain; with mirror images "
            f"{solver['states_trained_on']}"
        ),
    )
    for name, tried in solver["states_tried"].items():
        yield (
            f"error {name}",
            (
                f"B within {100 * tried['flux_density_share']:.2g} %, gradient within "
                f"{100 * tried['gradient_share']:.2g} % of the largest of the state in the workspace, on "
                f"{tried['states']} states not trained on, {tried['solved']} of them solved"
            ),
        )
    yield (
        "cost",
        (
            f"{solver['states_solved']} states solved; {solver['generation_seconds'] / 60:.1f} minutes, "
            f"{solver['generation_processor_seconds'] / 60:.1f} of processor time, for the whole map"
        ),
    )
    for number, reason in solver["states_failed"].items():
        yield f"state {number}", f"not solved: {reason}"


def _solver_words(solver: dict[str, Any]) -> list[str]:
    if solver.get("form") == "coils":
        return [FORM_WORDS["coils"]]
    words = ["saturating" if "modes" in solver else "linear"]
    if "form" in solver:
        words.append(FORM_WORDS.get(solver["form"], str(solver["form"])))
    for key, text in (("tetrahedra", "tetrahedra"), ("surface_faces", "surface faces")):
        if key in solver:
            words.append(f"{solver[key]:,} {text}".replace(",", " "))
    # Of a reduced model these are of its mesh alone; the line of the cost says all.
    if isinstance(solver.get("seconds"), Mapping) and "generation_seconds" not in solver:
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
    if summary["current_domain"] is not None:
        amperes = ", ".join(f"{current:.4g}" for current in summary["reference_current"])
        return table((f"at {_mm(middle['at'])} mm", f"{amperes} A"), rows)
    names = [f"coil {name}" for name in summary["coil_names"]]
    return table((f"1 A, at {_mm(middle['at'])} mm", *names, "all"), rows)


def _lift_table(summary: dict[str, Any]) -> Any:
    payload = summary["payload"]
    title = f"lift {1e3 * payload.mass:.4g} g, {payload.moment:.3g} A m2"
    iron = "A per coil (linear)" if summary["current_domain"] is None else "A per coil"
    if summary["lift"][0]["thesis"] is None:
        lifts = summary["lift"]
        heights = ((f"magnet at z = {_mm_z(row)} mm", _amperes(row)) for row in lifts)
        return table((title, iron), heights)
    rows = (
        (
            f"sensor {row['sensor_mm']:g} mm",
            _mm_z(row),
            _amperes(row),
            f"{row['thesis']:.3f}",
            "" if row["ratio"] is None else f"{row['ratio']:.2f}",
        )
        for row in summary["lift"]
    )
    columns = (title, "magnet z, mm", iron, "thesis (7-18), measured", "ratio")
    return Group(table(columns, rows), Text(f" {RATIO}", style="dim"))


def _amperes(row: dict[str, Any]) -> str:
    return "beyond the map" if row["current"] is None else f"{row['current']:.3f}"


def _mm_z(row: dict[str, Any]) -> str:
    return f"{1e3 * row['height']:.1f}"
