"""`fieldmap info`: what a map holds; `fieldmap map --summary` prints the same."""

from typing import TYPE_CHECKING

from fieldmap.cli.options import Json, MapArgument

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from os import PathLike

    from rich.console import RenderableType

    from fieldmap.cli.printing import Section
    from fieldmap.io.map_summary import LiftAtHeight, MapSummary
    from fieldmap.typing import Array


def info(
    source: MapArgument,
    json: Json = False,
) -> None:
    """Print what a map holds: device, grid, field, gradient, lift current, and how accurate it is."""
    print_summary(source, json)


def print_summary(path: "str | PathLike[str]", json: bool) -> None:
    """Open a map and print what it holds."""
    from fieldmap.cli.printing import print_result
    from fieldmap.io.map_summary import summarise_map

    print_result(summarise_map(path), _page, json)


def _page(summary: "MapSummary") -> "Iterator[Section]":
    from rich.console import Group
    from rich.text import Text

    from fieldmap.cli.printing import assumption_lines, facts, heading

    record = summary.info.provenance
    payload = () if summary.payload is None else summary.payload.assumptions
    yield Group(heading(str(summary.path), record.title), facts(_facts(summary)))
    yield _unit_table(summary)
    yield _lift_table(summary) if summary.lift else None
    yield facts(assumption_lines((*record.assumptions, *payload)))
    yield Text(summary.saturation, style="bold") if summary.saturation else None


def _facts(summary: "MapSummary") -> "Iterator[tuple[str, str]]":
    from fieldmap.cli.printing import count_of

    info, record, grid = summary.info, summary.info.provenance, summary.info.grid
    names = info.coil_names
    yield "device", f"{record.device_name}, {count_of(len(names), 'coil', 'coils')}: {', '.join(names)}"
    yield "iron", ", ".join(_solver_words(record.solver_report))
    shape = " x ".join(str(n) for n in grid.shape)
    steps = dict.fromkeys(grid.spacing.round(9).tolist())
    spacing = " x ".join(f"{1e3 * step:g}" for step in steps)
    corners = f"{_mm(grid.lower)} to {_mm(grid.upper)} mm"
    yield "grid", f"{shape} nodes, {spacing} mm apart, from {corners}"
    yield "file", f"{summary.size / 1e6:.2f} MB, made {record.created}"
    error = info.interpolation_error
    if error is not None:
        sizes = f"{1e6 * error.flux_density:.2g} uT and {1e3 * error.gradient:.2g} mT/m"
        where = f"at sampled points, {info.reference_current[0]:g} A in every coil"
        yield "interpolation", f"within {sizes} of the solver {where}; mesh error not included"
    bound = info.error_bounds.get("harmonic")
    if bound is not None:
        sizes = f"{1e6 * bound.flux_density:.2g} uT and {1e3 * bound.gradient:.2g} mT/m"
        below = " at all currents below; the errors of the current model come on top"
        currents = "" if summary.domain is None else below
        yield (
            "certified",
            f"lookups (harmonic) are within {sizes} of the solver anywhere in the box{currents}",
        )
    yield from _current_facts(summary)


def _current_facts(summary: "MapSummary") -> "Iterator[tuple[str, str]]":
    domain, solver = summary.domain, summary.info.provenance.solver_report
    if domain is None:
        return
    ranges, of = summary.signal_ranges(), domain.parametrisation
    if of.name == "independent" and len(set(ranges.values())) == 1:
        low, high = next(iter(ranges.values()))
        yield "currents", f"{low:g} to {high:g} A in every coil, independently"
    elif of.name == "independent":
        yield "currents", ", ".join(f"{name}: {low:g} to {high:g} A" for name, (low, high) in ranges.items())
    else:
        units = dict(zip(ranges, of.signal_units, strict=True))
        words = ", ".join(
            f"{name} {low:g} to {high:g}{' A' if units[name] == 'A' else ''}"
            for name, (low, high) in ranges.items()
        )
        given = ", ".join(
            f"{name} = {value:g}" for name, value in of.parameters.items() if isinstance(value, float)
        )
        yield "currents", f"{of.name}{f' ({given})' if given else ''}: {words}"
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


def _solver_words(solver: "Mapping[str, object]") -> list[str]:
    from collections.abc import Mapping

    from fieldmap.cli.solve import FORMS_IN_WORDS

    if solver.get("form") == "coils":
        return [FORMS_IN_WORDS["coils"]]
    words = ["saturating" if "modes" in solver else "linear"]
    if "form" in solver:
        words.append(FORMS_IN_WORDS.get(str(solver["form"]), str(solver["form"])))
    for key, text in (("tetrahedra", "tetrahedra"), ("surface_faces", "surface faces")):
        if key in solver:
            words.append(f"{solver[key]:,} {text}".replace(",", " "))
    # Of a reduced model these are of its mesh alone; the line of the cost says all.
    seconds = solver.get("seconds")
    if isinstance(seconds, Mapping) and "generation_seconds" not in solver:
        words.append(f"{sum(seconds.values()):.0f} s")
    return words


def _mm(point: "Array") -> str:
    return "(" + ", ".join(f"{1e3 * x:g}" for x in point.round(9)) + ")"


def _unit_table(summary: "MapSummary") -> "RenderableType":
    from fieldmap.cli.printing import table

    middle = summary.middle
    rows = (
        ("Bz, mT", *(f"{1e3 * value:.4f}" for value in middle.Bz)),
        ("dBz/dz, mT/m", *(f"{1e3 * value:.4f}" for value in middle.dBz_dz)),
    )
    if summary.domain is not None:
        amperes = ", ".join(f"{current:.4g}" for current in summary.info.reference_current)
        return table((f"at {_mm(middle.at)} mm", f"{amperes} A"), rows)
    names = [f"coil {name}" for name in summary.info.coil_names]
    return table((f"1 A, at {_mm(middle.at)} mm", *names, "all"), rows)


def _lift_table(summary: "MapSummary") -> "RenderableType":
    from rich.console import Group
    from rich.text import Text

    from fieldmap.cli.printing import table

    payload = summary.payload
    assert payload is not None
    title = f"lift {1e3 * payload.mass:.4g} g, {payload.moment:.3g} A m2"
    iron = "A per coil (linear)" if summary.domain is None else "A per coil"
    if not summary.lift_source:
        heights = ((f"magnet at z = {_mm_z(row)} mm", _amperes(row)) for row in summary.lift)
        return table((title, iron), heights)
    rows = (
        (
            f"sensor {row.sensor_mm:g} mm",
            _mm_z(row),
            _amperes(row),
            f"{row.measured:.3f}",
            "" if row.ratio is None else f"{row.ratio:.2f}",
        )
        for row in summary.lift
    )
    columns = (title, "magnet z, mm", iron, f"measured {summary.lift_source}", "ratio")
    ratio = "A ratio above 1: this model needs more current than was measured (docs/theory/equilibrium.md)."
    return Group(table(columns, rows), Text(f" {ratio}", style="dim"))


def _amperes(row: "LiftAtHeight") -> str:
    return "beyond the map" if row.current is None else f"{row.current:.3f}"


def _mm_z(row: "LiftAtHeight") -> str:
    return f"{1e3 * row.height:.1f}"
