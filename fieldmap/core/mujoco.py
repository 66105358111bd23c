"""Magnets in MuJoCo: what its callback for passive forces does, fieldmap/core/mujoco.h."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from fieldmap.core.body import CoreBody
from fieldmap.core.library import LIBRARY
from fieldmap.core.map import CoreMap
from fieldmap.typing import Array


class Layout(NamedTuple):
    """apply: address of MuJoCo's mj_applyFT; xpos, xmat, passive: where in its data the pointers to xpos, xmat and
    qfrc_passive lie, bytes."""

    apply: int
    xpos: int
    xmat: int
    passive: int


class Magnet(NamedTuple):
    """number: of the body in MuJoCo; freedom: its first degree of freedom where a free joint is all that it hangs on,
    else -1."""

    body: CoreBody
    number: int
    freedom: int


class Task:
    """The loads of magnets in the sum of a map's fields, which the callback adds to the passive forces of one model.

    weights: of the fields, read where they lie whenever MuJoCo calls; origin (3,), m: of the map in the world; mutual:
    whether magnets and soft iron act on those of other bodies, also by the iron that they magnetise.
    """

    def __init__(
        self,
        of: CoreMap,
        weights: Array,
        magnets: Sequence[Magnet],
        layout: Layout,
        origin: Array,
        mutual: bool,
    ) -> None:
        rows = tuple((magnet.body.body, magnet.number, magnet.freedom) for magnet in magnets)
        self._task = LIBRARY.mujoco_task(of.map, weights, rows, layout, origin, mutual)
        self._before: Any = None

    def enter(self) -> None:
        """From now on the callback adds these loads. Its next call says which model they are for, and adds none."""
        LIBRARY.mujoco_begin(self._task)
        self._before = LIBRARY.mujoco_activate(self._task)

    def leave(self) -> None:
        """Back to the task of before."""
        LIBRARY.mujoco_activate(self._before)
        self._before = None

    def fault(self) -> tuple[int, int, Array] | None:
        """A status, the number of the first magnet at fault, and where in the map (3,), m: that it left, or, by
        `UNSETTLED`, that its soft iron overlaps another. Nothing feels a force since."""
        return LIBRARY.mujoco_fault(self._task)


def callback() -> int:
    """The address of what MuJoCo calls: void (const mjModel *, mjData *)."""
    return int(LIBRARY.mujoco_callback())
