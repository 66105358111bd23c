"""Parts of the thesis that several test files use: each is computed once in a process."""

from functools import cache

import numpy as np

from fieldmap.curves import Curves
from fieldmap.thesis.computation import Comparison, PartResult, compute_part
from fieldmap.thesis.printed import parts_of


@cache
def computed(part: str) -> PartResult:
    """The result of a part without a map; callers must not change it."""
    return compute_part(part)


def numbers(row: str) -> list[Comparison]:
    """All numbers of a row, computed at the first call, so that collecting tests stays quick."""
    return [number for part in parts_of([row]) for number in computed(part).comparisons]


def assert_drawn(curves: Curves, labels: tuple[str, str], lines: list, rtol: float = 1e-7) -> None:
    """Compare the labels of a figure, and name, kind, x and y of each series."""
    assert (curves.x_label, curves.y_label) == tuple(labels), curves.title
    assert [(one.name, one.kind) for one in curves.series] == [line[:2] for line in lines], curves.title
    for one, (*_, x, y) in zip(curves.series, lines, strict=True):
        np.testing.assert_allclose(one.x, x, rtol=1e-9, atol=1e-9, err_msg=f"{curves.title}: {one.name}")
        np.testing.assert_allclose(one.y, y, rtol=rtol, atol=1e-7, err_msg=f"{curves.title}: {one.name}")
