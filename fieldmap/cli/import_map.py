"""`fieldmap import`: a table of measured or foreign flux densities becomes a map."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fieldmap.interop import MeasuredMap


def import_map(
    source: Annotated[
        Path,
        typer.Argument(metavar="CSV", help="Readings: x_mm, y_mm, z_mm, I_NAME_A ..., Bx_mT, By_mT, Bz_mT."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MAP", help="Where to write (.h5).")],
    spacing: Annotated[
        float, typer.Option("--spacing-mm", metavar="MM", help="Largest distance of the map's nodes.")
    ] = 5.0,
    degree: Annotated[
        int | None,
        typer.Option(
            "--degree",
            min=2,
            help="Of the polynomials; the lower, the smoother. Unless given, what foretells held-out readings best.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, SI units.")] = False,
) -> None:
    """Make a map from a table of flux densities, smoothed by harmonic polynomials; what they leave is printed."""
    from fieldmap.interop import fit_map, read_measurements
    from fieldmap.store import write_map

    _check(output)
    measured = fit_map(read_measurements(source), 1e-3 * spacing, degree=degree)
    write_map(output, measured.data)
    _show(measured, source, output, as_json)


def _check(output: Path) -> None:
    from fieldmap.errors import InputError, Problem

    if output.suffix.lower() not in (".h5", ".hdf5") or not output.parent.is_dir():
        must_hold = "must be a file .h5 in a folder that exists"
        raise InputError(Problem("--output", must_hold, str(output), "correct the name"))


def _show(measured: "MeasuredMap", source: Path, output: Path, as_json: bool) -> None:
    from fieldmap.cli.printing import facts, heading, print_json, print_page

    report, data = measured.report, measured.data
    if as_json:
        print_json({"map": output, "coils": data.coil_names, "report": report})
        return
    rows = [
        ("readings", f"{report.readings}, coils {', '.join(data.coil_names)}"),
        ("nodes", " x ".join(map(str, data.grid.shape))),
        ("degree", f"{report.degree}"),
        ("residual", f"{1e6 * report.residual:.3g} uT rms per component"),
        (
            "held out",
            f"{1e6 * report.held_out:.3g} uT rms, {1e6 * report.held_out_worst:.3g} uT at worst, of readings foretold "
            "without them",
        ),
        (
            "standard error",
            f"{1e6 * report.standard_error.flux_density:.3g} uT, {1e3 * report.standard_error.gradient:.3g} mT/m "
            "at the nodes, by scatter alone",
        ),
        ("assumed", "; ".join(text.removeprefix("measured: ") for text in data.provenance.assumptions[:2])),
    ]
    print_page(heading(str(output), f"from {source}"), facts(rows))
