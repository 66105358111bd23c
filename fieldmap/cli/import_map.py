"""`fieldmap import`: a map from a table of measured flux densities, or of another program's."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fieldmap.cli.printing import Section
    from fieldmap.interop import MeasuredMap


def import_map(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CSV", help="Table with columns x_mm, y_mm, z_mm, I_NAME_A ..., Bx_mT, By_mT, Bz_mT."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MAP", help="Map file to write (.h5).")],
    spacing: Annotated[
        float, typer.Option("--spacing-mm", metavar="MM", help="Largest distance between nodes of the map.")
    ] = 5.0,
    degree: Annotated[
        int | None,
        typer.Option(
            "--degree",
            min=2,
            help="Degree of the polynomials: lower is smoother. Default: the one that predicts held-out readings best.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Fit harmonic polynomials to a table of flux densities and write them as a map; print how well they fit."""
    from fieldmap.cli.printing import print_result
    from fieldmap.interop import fit_map, read_measurements
    from fieldmap.store import write_map

    _check(output)
    measured = fit_map(read_measurements(source), 1e-3 * spacing, degree=degree)
    write_map(output, measured.data)
    print_result(measured, partial(_page, source, output), json, map=output)


def _check(output: Path) -> None:
    from fieldmap.errors import InputError, Problem

    if output.suffix.lower() not in (".h5", ".hdf5") or not output.parent.is_dir():
        must_hold = "must be a file .h5 in a folder that exists"
        raise InputError(Problem("--output", must_hold, str(output), "correct the name"))


def _page(source: Path, output: Path, measured: "MeasuredMap") -> "Iterator[Section]":
    from fieldmap.cli.printing import facts, heading

    report, data = measured.report, measured.data
    held_out = f"{1e6 * report.held_out:.3g} uT rms, {1e6 * report.held_out_worst:.3g} uT at worst"
    error = report.standard_error
    at_nodes = f"{1e6 * error.flux_density:.3g} uT, {1e3 * error.gradient:.3g} mT/m at the nodes"
    yield heading(str(output), f"from {source}")
    yield facts(
        [
            ("readings", f"{report.readings}, coils {', '.join(data.coil_names)}"),
            ("nodes", " x ".join(map(str, data.grid.shape))),
            ("degree", f"{report.degree}"),
            ("residual", f"{1e6 * report.residual:.3g} uT rms per component"),
            ("held out", f"{held_out}, of readings predicted without them"),
            ("standard error", f"{at_nodes}, from scatter alone"),
            (
                "assumed",
                "; ".join(text.removeprefix("measured: ") for text in data.provenance.assumptions[:2]),
            ),
        ]
    )
