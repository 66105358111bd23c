"""Magnets in MuJoCo, through its callback for passive forces: fieldmap/core/mujoco.h."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from fieldmap.core.body import CoreBody
from fieldmap.core.library import LIBRARY
from fieldmap.core.map import CoreMap
from fieldmap.typing import Array


class Layout(NamedTuple):
    """apply: address of MuJoCo's mj_applyFT; xpos, xmat, passive: offsets of the pointers to xpos, xmat and
    qfrc_passive in its data, bytes."""

    apply: int
    xpos: int
    xmat: int
    passive: int


class Magnet(NamedTuple):
    """number: of the body in MuJoCo; freedom: first degree of freedom if its only joint is a free joint, else -1."""

    body: CoreBody
    number: int
    freedom: int


class Task:
    """The loads of magnets in the sum of a map's fields, which the callback adds to the passive forces of one model.

    weights: of the fields; each call of MuJoCo reads the present values; origin (3,), m: of the map in the world;
    mutual: whether the magnets and soft iron of different bodies act on each other, also through the iron of the map.
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
        """Let the callback add these loads from now on. Its next call only sets the model."""
        LIBRARY.mujoco_begin(self._task)
        self._before = LIBRARY.mujoco_activate(self._task)

    def leave(self) -> None:
        """Restore the task that was active before."""
        LIBRARY.mujoco_activate(self._before)
        self._before = None

    def fault(self) -> tuple[int, int, Array] | None:
        """Return the status of the first fault, the number of the magnet, and the point in the map (3,), m. The
        magnet left the map, or, with `UNSETTLED`, soft iron of bodies overlaps. No forces were added since."""
        return LIBRARY.mujoco_fault(self._task)


def callback() -> int:
    """Return the address of the callback: void (const mjModel *, mjData *)."""
    return int(LIBRARY.mujoco_callback())
