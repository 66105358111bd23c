"""Printed numbers beside ours."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fieldmap.thesis.printed import PrintedNumber, read_part
from fieldmap.thesis.registry import Ours, function_of, parts_of, row_of


@dataclass(frozen=True)
class Comparison:
    """One number of the thesis beside ours.

    id: the row; name: which number of it. deviation = ours / thesis - 1, None where the thesis prints 0. kind: "sharp"
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


def compare(rows: Iterable[str] = ()) -> list[Comparison]:
    """Every number that the thesis prints for these rows (all rows if none is given) beside ours.

    rows: names such as "S7". Raises InputError for a row that is not there.

    >>> [number] = [c for c in compare(["S7"]) if c.name == "global_deviation[0]"]
    >>> print(number.thesis, round(number.ours, 7), number.unit, number.agrees)
    0.00706 0.0070569 mm True
    """
    return [comparison for part in parts_of(rows) for comparison in _compare_part(part)]


def _compare_part(part: str) -> list[Comparison]:
    printed = read_part(part)
    answers = function_of(part)(printed.inputs)
    if answers.keys() != printed.numbers.keys():
        raise LookupError(f"{part}: computed and printed differ: {set(answers) ^ set(printed.numbers)}")
    comparisons = []
    for name, numbers in printed.numbers.items():
        answer = answers[name] if isinstance(answers[name], Ours) else Ours(answers[name])
        values = np.asarray(answer.value, dtype=float).ravel()
        for number, value in zip(numbers, values, strict=True):
            comparisons.append(_side_by_side(part, printed.title, number, float(value), answer.assumptions))
    return comparisons


def _side_by_side(
    part: str, title: str, number: PrintedNumber, ours: float, assumptions: tuple[str, ...]
) -> Comparison:
    # Half a unit, and the rounding of numbers that lie exactly between two.
    agrees = abs(ours - number.value) <= number.half_unit * (1 + 1e-6)
    return Comparison(
        id=row_of(part),
        name=number.name,
        quantity=number.quantity,
        unit=number.unit,
        thesis=number.value,
        ours=ours,
        deviation=ours / number.value - 1.0 if number.value else None,
        kind=number.kind,
        agrees=agrees if number.kind == "sharp" else None,
        misprint=number.misprint,
        place=number.place,
        title=title,
        assumptions=assumptions,
    )
