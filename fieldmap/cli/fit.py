"""`fieldmap fit`: numbers of a device that nobody knows, from what was measured on the machine."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json, fits

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from fieldmap.cli.printing import Section
    from fieldmap.studies import Fit, MachineFit


def fit(
    file: Annotated[
        str,
        typer.Argument(metavar="FIT", help="Fit file, or the name of a shipped one.", autocompletion=fits),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Device file to write, with the values found."),
    ] = None,
    json: Json = False,
) -> None:
    """Find unknown numbers of a device from measurements on it: values with their errors, what the readings cannot tell
    apart, and every reading beside what the fitted device gives.

    Each solve is of the whole device: some ten for each unknown.
    """
    from fieldmap.cli.printing import print_result
    from fieldmap.io import refuse_directory
    from fieldmap.progress import Progress
    from fieldmap.studies import read_fit

    refuse_directory(file)
    asked = read_fit(file)
    if output is not None:
        _refuse(output, asked)
    with Progress("fit") as progress:
        found = asked.run(_told(progress, asked))
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(found.device.to_toml(), encoding="utf-8")
    print_result(found, partial(_page, asked, output), json, file=asked.path, written=output)


def _refuse(output: Path, asked: "Fit") -> None:
    """Raise InputError for a file that is not to be written."""
    from fieldmap.errors import InputError, Problem

    if output.suffix != ".toml" or output.is_dir():
        raise InputError(
            Problem("--output", "must be a device file to write", str(output), "end it with .toml")
        )
    if output.exists() and any(output.samefile(path) for path in (asked.path, asked.device_path)):
        must_hold = "must not be the file that is read"
        raise InputError(Problem("--output", must_hold, str(output), "give another name"))


def _told(progress: "Callable[[str, float], None]", asked: "Fit") -> "Callable[[Mapping[str, float]], None]":
    """What is called after each solve. Nobody knows how many a fit takes: 8 steps, with errors at the end."""
    expected, done = 10 * (len(asked.unknowns) + 1), 0

    def solved(values: "Mapping[str, float]") -> None:
        nonlocal done
        done += 1
        words = ", ".join(f"{key} {value:.5g}" for key, value in values.items())
        progress(f"solve {done}: {words}", done / (done + expected))

    return solved


def _page(asked: "Fit", output: Path | None, found: "MachineFit") -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading, remark, table

    yield heading(asked.title, f"{asked.device_path.name}, {found.solves} solves")
    starts = {one.key: one.start for one in asked.unknowns}
    yield table(
        ("unknown", "value", "±", "before"),
        (
            (key, f"{value:.6g}", f"{found.deviations[key]:.2g}", f"{starts[key]:.6g}")
            for key, value in found.values.items()
        ),
    )
    keys = list(found.values)
    if len(keys) > 1:
        rows = (
            (key, *(f"{one:.2f}" for one in row)) for key, row in zip(keys, found.correlation, strict=True)
        )
        yield table(("correlation", *(f"({k + 1})" for k in range(len(keys)))), rows)
    for group in found.indistinct:
        yield remark(f"The readings cannot tell apart: {', '.join(group)}. A prior or other readings would.")
    for one in found.tables:
        unit, size = asked.units[one.name]
        yield heading(
            one.name,
            f"{'fitted' if one.used else 'predicted'}, {unit}: off by {one.misfit:.2g} deviations,"
            f" {one.misfit_before:.2g} before",
        )
        numbers = zip(one.measured, one.after, one.uncertainty, one.before, strict=True)
        yield table(
            ("", "measured", "computed", "±", "before"),
            (
                (
                    label,
                    *(_number(value / size) for value in row[:2]),
                    f"{row[2] / size:.2g}",
                    _number(row[3] / size),
                )
                for label, row in zip(asked.labels[one.name], numbers, strict=True)
            ),
        )
    yield facts(assumption_lines(found.assumptions))
    yield facts([("written", str(output))]) if output is not None else None


def _number(value: float) -> str:
    return f"{value:.5g}"
