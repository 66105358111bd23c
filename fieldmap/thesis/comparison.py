"""Printed numbers beside ours."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.thesis.printed import PrintedNumber, PrintedPart
from fieldmap.thesis.registry import Ours, row_of


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


def compared(part: str, printed: PrintedPart, answers: Mapping[str, Any]) -> tuple[Comparison, ...]:
    """Every printed number of a part beside the answer of the same name."""
    if answers.keys() != printed.numbers.keys():
        raise LookupError(f"{part}: computed and printed differ: {set(answers) ^ set(printed.numbers)}")
    comparisons: list[Comparison] = []
    for name, numbers in printed.numbers.items():
        answer = answers[name] if isinstance(answers[name], Ours) else Ours(answers[name])
        comparisons += _table(part, printed.title, numbers, answer)
    return tuple(comparisons)


def agreeing(comparisons: Iterable[Comparison]) -> tuple[int, int]:
    """How many sharp numbers agree to the printed digits, and how many sharp numbers without a misprint there are."""
    sharp = [c for c in comparisons if c.kind == "sharp" and not c.misprint]
    return sum(bool(c.agrees) for c in sharp), len(sharp)


def _table(part: str, title: str, numbers: Iterable[PrintedNumber], answer: Ours) -> list[Comparison]:
    values = np.asarray(answer.value, dtype=float).ravel()
    return [
        _side_by_side(part, title, number, float(value), answer.assumptions)
        for number, value in zip(numbers, values, strict=True)
    ]


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
