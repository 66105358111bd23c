"""The solver's report in words, and the flux density in the iron."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from fieldmap.cli.assumptions import saturates
from fieldmap.cli.printing import count_of, table
from fieldmap.device.model import Device

FORM_WORDS = {
    "potential": "second-order potential form",
    "flux": "second-order flux form",
    "coils": "none: coils alone",
}


def report_rows(report: Any, device: Device, nonlinear: bool) -> Iterator[tuple[str, str]]:
    """Rows for `facts` from a SolverReport."""
    words = FORM_WORDS.get(report.form, report.form)
    if report.tetrahedra == 0:
        yield "iron", words
        return
    yield "iron", f"{'nonlinear' if nonlinear else 'linear'}, {words}"
    pieces = count_of(report.magnetic_bodies, "magnetic body", "magnetic bodies")
    sizes = f"{report.tetrahedra:,} tetrahedra, {report.surface_faces:,} surface faces"
    yield "mesh", f"{sizes}, {report.unknowns:,} unknowns, {pieces}"
    yield "symmetry", report.symmetry
    steps = "Newton steps" if nonlinear else "iterations"
    yield (
        "solution",
        f"{report.iterations} {steps} to a residual of {report.residual:.1e}{report.steps_text}",
    )
    if report.error is not None:
        yield "error", str(report.error)
    if report.refinement:
        meshes = (f"{100 * error:.2g} % at {faces:,}" for faces, error in report.refinement)
        yield "refinement", f"estimates of B: {', '.join(meshes)} surface faces"
    yield "matrix", f"{report.matrix_bytes / 1e6:,.0f} MB, {report.storage or 'none'}"
    steps = ", ".join(f"{step} {seconds:.1f}" for step, seconds in report.seconds.items())
    yield "seconds", f"{report.total_seconds:.1f}: {steps}"
    if nonlinear:
        yield "B-H law", _table_words(report, device)


def _table_words(report: Any, device: Device) -> str:
    if not saturates(device):
        return "none: all iron of this device is linear"
    total = report.tetrahedra
    if not report.beyond_table and not report.below_table:
        return "no element leaves the range of its points or formula"
    words = []
    for count, side in (
        (report.below_table, "below its first point"),
        (report.beyond_table, "above its last"),
    ):
        share = 100 * count / total
        words.append(f"{count:,} elements ({share:.3g} %) {side}" if count else f"none {side}")
    return f"{', '.join(words)}; there its stated extensions hold"


def state_notes(report: Any, device: Device) -> tuple[str, ...]:
    """What a nonlinear state rests on, with how far its iron is driven."""
    driven = f"iron up to {report.largest_flux_density:.2f} T; B-H law: {_table_words(report, device)}"
    return (*report.assumptions, driven)


def body_rows(solution: Any) -> list[dict[str, Any]]:
    """Flux density in every body of a nonlinear state, T: volume mean of |B|, its largest element, mean of B."""
    flux_density = solution.state.iron.flux_density[0]
    size = np.linalg.norm(flux_density, axis=1)
    mesh = solution.mesh
    corners = mesh.points[mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    rows = []
    for index, name in enumerate(mesh.body_names):
        mine = mesh.body == index
        rows.append(
            {
                "body": name,
                "mean_magnitude": float(volume[mine] @ size[mine] / volume[mine].sum()),
                "largest_magnitude": float(size[mine].max()),
                "mean": solution.flux_density(name),
            }
        )
    return rows


def body_table(rows: list[dict[str, Any]]) -> Any:
    """Flux density in the bodies."""
    cells = (
        (
            row["body"],
            f"{row['mean_magnitude']:.3f}",
            f"{row['largest_magnitude']:.3f}",
            *(f"{round(value, 3) + 0.0:.3f}" for value in row["mean"]),
        )
        for row in rows
    )
    columns = ("in the iron, T", "mean |B|", "largest |B|", "mean Bx", "mean By", "mean Bz")
    return table(columns, cells)
