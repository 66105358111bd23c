"""Parts of the thesis that several files of tests look at: each is computed once in a process."""

from functools import cache

from fieldmap.thesis.computation import Comparison, PartResult, compute_part
from fieldmap.thesis.printed import parts_of


@cache
def computed(part: str) -> PartResult:
    """Of a part without a map; what it draws and its numbers are not to be changed."""
    return compute_part(part)


def numbers(row: str) -> list[Comparison]:
    """All numbers of a row, computed by the first test that asks: collecting tests stays quick."""
    return [number for part in parts_of([row]) for number in computed(part).comparisons]
