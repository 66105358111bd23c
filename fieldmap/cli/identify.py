"""`fieldmap identify`: a model of a rig, with its uncertainty, from a log."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.arguments import raise_all
from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_pairs
from fieldmap.cli.options import option
from fieldmap.errors import InputError, Problem

if TYPE_CHECKING:
    from fieldmap.control.identification import IdentifiedLog, Log


def identify(
    log: Annotated[Path, typer.Argument(metavar="LOG")],
    source: Annotated[str | None, option("--from", "NAME")] = None,
    target: Annotated[str | None, option("--to", "NAME")] = None,
    reference: Annotated[str | None, option("--reference", "NAME")] = None,
    time: Annotated[str | None, option("--time", "NAME")] = None,
    sampling: Annotated[float | None, option("--sampling-ms", "MS")] = None,
    units: options.Units = None,
    delimiter: Annotated[str | None, option("--delimiter", "NAME")] = None,
    decimal: Annotated[str | None, option("--decimal", "MARK")] = None,
    poles: Annotated[int, option("--poles", "N")] = 2,
    zeros: Annotated[int, option("--zeros", "N")] = 1,
    dead_time: Annotated[int, option("--dead-time", "N")] = 0,
    method: Annotated[str, option("--method", "NAME")] = "direct",
    rest: Annotated[int | None, option("--rest", "N")] = None,
    json: options.Json = False,
) -> None:
    """Identify the model from an input to an output in a log of a rig, in open or closed loop; print it with errors.

    The exit code is 2 with every problem of the file at once, 1 if the estimate does not settle.

    Example: fieldmap identify rig.csv --from control --to position

    Parameters
    ----------
    log
        Text file of columns below a line of names, such as CSV.
    source
        Column of the input. Default: recognised by its name.
    target
        Column of the output. Default: recognised.
    reference
        Column of the reference, if there is one.
    time
        Column of the time. Default: recognised.
    sampling
        Sampling time of a log without time.
    delimiter
        comma, semicolon, tab or blanks. Default: recognised.
    decimal
        point or comma. Default: recognised.
    poles
        Poles of the sampled model.
    zeros
        Zeros of the sampled model.
    dead_time
        Samples of dead time beyond the poles less the zeros.
    method
        direct; armax, for coloured noise; two-stage, with a reference; least-squares, biased by noise.
    rest
        Samples at rest at the beginning. Default: those before the reference moves, or one.
    """
    from fieldmap.control.identification import METHODS, ROLES, Orders, identify_log, read_log

    names = {"input": source, "output": target, "reference": reference, "time": time}
    unit_of, problems = parse_pairs(units, "--unit", "NAME=UNIT", "position=mm")
    decimals = {"point": ".", "comma": ",", ".": ".", ",": ","}
    if decimal is not None and decimal not in decimals:
        problems.append(Problem("--decimal", "must be point or comma", decimal, "choose one"))
    if method not in METHODS:
        problems.append(Problem("--method", f"must be one of {', '.join(METHODS)}", method, "choose one"))
    orders = recognised = None
    with _collected(problems):
        orders = Orders(poles, zeros, dead_time)
    with _collected(problems):
        recognised = read_log(
            log,
            ROLES,
            required=("input", "output", *(("reference",) if method == "two-stage" else ())),
            names={role: name for role, name in names.items() if name is not None},
            units=unit_of,
            delimiter=delimiter,
            decimal=None if decimal is None else decimals.get(decimal),
            sampling_time=None if sampling is None else 1e-3 * sampling,
            options=_GIVEN_BY,
        )
    raise_all(problems)
    assert orders is not None
    assert recognised is not None
    found = identify_log(recognised, orders, method, rest)
    page.print_result(found, partial(_page, log, recognised), json, log=log)


# Property of a log -> the option that states it.
_GIVEN_BY = {
    **{"delimiter": "--delimiter", "units": "--unit", "input": "--from", "output": "--to"},
    **{"reference": "--reference", "time": "--time"},
}


@contextmanager
def _collected(problems: list[Problem]) -> Iterator[None]:
    """Context that collects the problems of an InputError in the list."""
    try:
        yield
    except InputError as error:
        problems += error.problems


def _page(log: Path, recognised: Log, found: IdentifiedLog) -> Iterator[page.Section]:
    estimate, columns = found.estimate, found.columns
    units = {role: column.unit for role, column in columns.items()}
    per = f"{units['output']}/{units['input']}"
    at = (f"{columns[role].name} {mean:.6g} {units[role]}" for role, mean in found.operating_point.items())
    read = f"{found.samples} samples every {1e3 * estimate.Ts:.6g} ms; {recognised.delimiter}"
    mark = "decimal comma" if recognised.decimal == "," else "decimal point"
    yield page.heading(f"from {columns['input'].name} to {columns['output'].name}", str(log))
    yield page.facts(
        [
            ("read", f"{read}, {mark}"),
            ("at rest", f"{', '.join(at)}: mean of the first {found.rest}"),
            ("method", f"{estimate.method}, {estimate.iterations} iterations"),
            ("gain", f"{estimate.gain:.6g} {per} in front; at rest {estimate.steady_gain:.6g} {per}"),
            ("left over", f"{estimate.residual_rms:.4g} {units['output']} RMS, of the last equation"),
        ]
    )
    poles = zip(estimate.poles, estimate.pole_errors, *found.continuous_poles, strict=False)
    zeros = zip(estimate.zeros, estimate.zero_errors, strict=True)
    lines = [("pole", _with_error(q, e), _with_error(s, of_s)) for q, e, s, of_s in poles]
    lines += [("zero", _with_error(q, e), "") for q, e in zeros]
    yield page.table(("", "in q", "1/s"), lines)
    rows = [(name, f"{value:.8g}", f"{error:.2g}") for name, value, error in found.coefficients]
    yield page.table(("coefficient", "value", "standard error"), rows)
    if found.rest == 1:
        yield page.remark(
            "The first sample alone was taken for the operating point: --rest N takes the mean of N."
        )
    yield page.assumed(estimate.assumptions)


def _with_error(value: complex, error: float) -> str:
    number = f"{value.real:.6g}" if abs(value.imag) < 1e-12 else f"{value.real:.6g} {value.imag:+.6g}i"
    return f"{number} ± {error:.2g}" if isfinite(error) else number
