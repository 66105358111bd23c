"""Comparison of printed numbers with ours. Parts of rows are computed one by one, so that one failure is not all."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.curves import Curves
from fieldmap.errors import FieldmapError
from fieldmap.extras import needs
from fieldmap.records import Record
from fieldmap.thesis import detail
from fieldmap.thesis.detail import FOLDER, MapMissing, available_map, maps_in
from fieldmap.thesis.printed import PrintedPart, figure_numbers, filled, parts_of, read_part, row_of
from fieldmap.typing import Progress


@dataclass(frozen=True, repr=False)
class Ours(Record):
    """Our number or array, and the assumptions of its computation, for example from a solver's report."""

    value: Any
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Answers(Record):
    """Results of a part that computes more than numbers.

    numbers: name of every printed number -> our number or `Ours`. curves: figures. facts: name -> value, for the
    explanations and assumptions of the row file, which may also name the part's inputs.
    """

    numbers: Mapping[str, Any]
    curves: tuple[Curves, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class Comparison(Record):
    """One number of the thesis and our number.

    id: the row; name: number in the row. deviation = ours / thesis - 1, None where the thesis prints 0. kind: "sharp"
    (arithmetic on stated inputs, must agree to the printed digits), "model" (our physics against theirs) or "measured"
    (against their experiment). agrees: whether a sharp number agrees to half a unit of the last printed digit; None
    for the other kinds. misprint: why the printed number cannot be right, or "".
    """

    id: str
    name: str
    quantity: str
    unit: str
    thesis: float
    ours: float
    deviation: float | None
    kind: str
    agrees: bool | None
    misprint: str
    place: str
    title: str
    assumptions: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """ "agrees" for a sharp number that agrees, otherwise the deviation; "" where the thesis prints 0."""
        return "agrees" if self.agrees else percent(self.deviation)


def percent(deviation: float | None) -> str:
    """A deviation in per cent, or as a factor ("12.5 times") from 1000 % on.

    >>> percent(0.0123), percent(-2e-5), percent(11.5), percent(None)
    ('+1.2 %', '-0.002 %', '12.5 times', '')
    """
    if deviation is None:
        return ""
    if abs(deviation) >= 10.0:
        return f"{1.0 + deviation:.3g} times"
    value = 100.0 * deviation
    return f"{value:+.1f} %" if abs(value) >= 0.1 else f"{value:+.1g} %"


def compared(part: str, printed: PrintedPart, answers: Answers) -> Iterator[Comparison]:
    """Compare every printed number of a part with the answer of the same name."""
    if odd := answers.numbers.keys() ^ printed.numbers.keys():
        raise LookupError(f"{part}: computed and printed differ: {odd}")
    values = {**printed.inputs, **answers.facts}
    for name, numbers in printed.numbers.items():
        found = answers.numbers[name]
        answer = found if isinstance(found, Ours) else Ours(found)
        declared = [*printed.assumptions.get("", ()), *printed.assumptions.get(name, ())]
        assumptions = tuple(
            dict.fromkeys([*answer.assumptions, *(filled(text, values) for text in declared)])
        )
        for number, value in zip(numbers, np.ravel(answer.value), strict=True):
            ours, sharp = float(value), number.kind == "sharp"
            yield Comparison(
                id=row_of(part),
                name=number.name,
                quantity=number.quantity,
                unit=number.unit,
                thesis=number.value,
                ours=ours,
                deviation=ours / number.value - 1.0 if number.value else None,
                kind=number.kind,
                # The margin allows for rounding errors of numbers exactly half a unit away.
                agrees=abs(ours - number.value) <= number.half_unit * (1 + 1e-6) if sharp else None,
                misprint=number.misprint,
                place=number.place,
                title=printed.title,
                assumptions=assumptions,
            )


def agreeing(comparisons: Iterable[Comparison]) -> tuple[int, int]:
    """Number of sharp numbers that agree to the printed digits, and of all sharp numbers without a misprint."""
    sharp = [c for c in comparisons if c.kind == "sharp" and not c.misprint]
    return sum(bool(c.agrees) for c in sharp), len(sharp)


@dataclass(frozen=True, eq=False, repr=False)
class PartResult(Record):
    """Outcome of one part of a row.

    explanations: name of a printed number, or "" for the part -> why ours differs. seconds: processor time.
    problem: why there are no numbers, or "". remedy: the command that helps, or "". map: recipe of the map that the
    part uses, or "". option: command-line option for the detail, " --quick" or "".
    """

    part: str
    title: str
    comparisons: tuple[Comparison, ...] = ()
    curves: tuple[Curves, ...] = ()
    explanations: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    problem: str = ""
    remedy: str = ""
    map: str = ""
    option: str = ""

    @property
    def row(self) -> str:
        """The row of the part."""
        return row_of(self.part)

    @property
    def state(self) -> str:
        """ "done", "no map", or "failed"."""
        if not self.problem:
            return "done"
        return "no map" if self.remedy else "failed"


def function_of(part: str) -> Callable[[dict[str, Any]], Answers | Mapping[str, Any]]:
    """The function that computes a part: `ours` of its row file.

    The function takes the part's inputs, name -> number or array in the units of the file. It returns name of every
    printed number -> our number (an array for a table), or `Ours` with assumptions; or `Answers`, which also hold
    figures and facts. If the file has `map = "division"`, inputs["map"] is the opened map of that recipe.
    """
    module, _, name = read_part(part).ours.partition(".")
    with needs("make", part):
        return getattr(import_module(f"fieldmap.thesis.{module}"), name)


def compare(rows: Iterable[str] = (), maps: Path = FOLDER) -> list[Comparison]:
    """Compare every number that the thesis prints for some rows with ours.

    Parameters
    ----------
    rows
        Names such as "S7"; by default all rows that need no map or have one.
    maps
        The folder of the maps.

    Returns
    -------
    list[Comparison]
        The numbers.

    Raises
    ------
    InputError
        For an unknown row.
    MapMissing
        For a named row without its map.

    Examples
    --------
    >>> [number] = [c for c in compare(["S7"]) if c.name == "global_deviation[0]"]
    >>> print(number.thesis, round(number.ours, 7), number.unit, number.agrees)
    0.00706 0.0070569 mm True
    """
    wanted = list(rows)
    comparisons: list[Comparison] = []
    for part in parts_of(wanted):
        try:
            comparisons += compute_part(part, maps).comparisons
        except MapMissing:
            if wanted:
                raise
    return comparisons


def compute_part(part: str, maps: Path = FOLDER) -> PartResult:
    """The numbers, figures and explanations of one part. Raises MapMissing and the errors of the part itself."""
    printed = read_part(part)
    with maps_in(maps):
        inputs = printed.inputs | ({"map": available_map(printed.map)} if printed.map else {})
        started = time.process_time()
        answers = function_of(part)(inputs)
    seconds = time.process_time() - started
    if not isinstance(answers, Answers):
        answers = Answers(answers)
    # The documentation takes its list of figures from the data files, so the two must agree.
    drawn = {number for one in answers.curves for number in figure_numbers(one.title)}
    if drawn != set(printed.figures):
        odd = ", ".join(sorted(drawn ^ set(printed.figures)))
        raise LookupError(f"{part}: figures of its data file and those that it draws differ in {odd}")
    values = {**printed.inputs, **answers.facts}
    return _result(
        part,
        printed,
        comparisons=tuple(compared(part, printed, answers)),
        curves=answers.curves,
        explanations={name: filled(text, values) for name, text in printed.explanations.items()},
        seconds=seconds,
    )


def attempt_part(part: str, maps: Path = FOLDER) -> PartResult:
    """`compute_part`, but any error becomes `problem`, because other parts do not depend on this one."""
    remedy = ""
    try:
        return compute_part(part, maps)
    except MapMissing as missing:
        problem, remedy = str(missing), missing.command
    except FieldmapError as error:
        problem = str(error)
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
    return _result(part, read_part(part), problem=problem, remedy=remedy)


def _result(part: str, printed: PrintedPart, **found: Any) -> PartResult:
    """The result with the map and the option of the present detail."""
    chosen = detail.current()
    return PartResult(part, printed.title, **found, map=chosen.map_name(printed.map), option=chosen.option)


def attempt_rows(
    rows: Iterable[str] = (),
    progress: Progress | None = None,
    attempt: Callable[[str], PartResult] = attempt_part,
) -> Iterator[PartResult]:
    """Compute the parts of some rows, one by one.

    Parameters
    ----------
    rows
        Names such as "S7"; all by default.
    progress
        Called as progress(part, share of the work done).
    attempt
        Computes one part.

    Yields
    ------
    PartResult
        The parts.
    """
    parts = parts_of(rows)
    costs = [expected_seconds(part) for part in parts]
    for k, part in enumerate(parts):
        if progress is not None:
            progress(part, sum(costs[:k]) / sum(costs))
        yield attempt(part)


def expected_seconds(part: str) -> float:
    """Approximate processor time of a part at the present detail, s."""
    printed = read_part(part)
    return printed.quick_seconds if detail.current().is_quick else printed.seconds
