"""Magnets in MuJoCo: bodies feel the wrench of a map's field at every step (pip install fieldmap[mujoco]).

MuJoCo has one passive-force callback for the whole process; `MagnetForces` takes it while it is entered as a context.
"""

from collections.abc import Mapping
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.extras import require
from fieldmap.lookup import FieldMap, FiniteMagnet
from fieldmap.typing import Array


class MagnetForces:
    """Force and torque of a map's field on bodies of a MuJoCo model.

    magnets: per body, by name, its moment (3,) in A m^2 in the body's frame, at the body's origin, or a `FiniteMagnet`
    with its centre there and magnetised along the body's z. currents (n_coils,), A: assign `currents` between steps,
    as a controller does. offset (3,), m: where the map's origin lies in the world. Axes of map and world are parallel,
    units SI. Raises InputError for a body that does not exist, FieldmapError without MuJoCo.

    A magnet that leaves the box feels nothing from there on, and `check`, or the end of the context, raises the
    OutsideMapError: an exception cannot pass through MuJoCo. With outside="clamp" it feels the field of the edge.

    >>> with MagnetForces(model, m, {"float": [0, 0, 0.8]}, currents) as magnets:          # doctest: +SKIP
    ...     for _ in range(1000):
    ...         magnets.currents = controller(data.qpos)
    ...         mujoco.mj_step(model, data)
    ...         magnets.check()
    """

    def __init__(
        self,
        model: Any,
        field: FieldMap,
        magnets: Mapping[str, FiniteMagnet | ArrayLike],
        currents: ArrayLike,
        offset: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        mujoco = require("mujoco", "mujoco", "MagnetForces")
        self._mujoco, self._field = mujoco, field
        self.currents = np.array(currents, dtype=np.float64)
        self._offset = np.array(offset, dtype=np.float64)
        self._bodies: list[tuple[int, FiniteMagnet | Array]] = []
        for name, magnet in magnets.items():
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            if body < 0:
                raise InputError(
                    Problem("MagnetForces, magnets", "bodies of the model", name, "check its name")
                )
            known = magnet if isinstance(magnet, FiniteMagnet) else np.array(magnet, dtype=np.float64)
            self._bodies.append((body, known))
        self._before: Any = None
        self._error: Exception | None = None

    def wrench(self, data: Any, body: int, magnet: FiniteMagnet | Array) -> Array:
        """Force and torque (6,) on a magnet about its body's origin, world frame."""
        position = data.xpos[body] - self._offset
        turn = data.xmat[body].reshape(3, 3)
        if isinstance(magnet, FiniteMagnet):
            return magnet.wrench(self._field, position, self.currents, turn)
        return self._field.wrench(position, turn @ magnet, self.currents)

    def __call__(self, model: Any, data: Any) -> None:
        """Add to the passive forces: what MuJoCo calls at every evaluation."""
        if self._error is not None:
            return
        try:
            for body, magnet in self._bodies:
                found = self.wrench(data, body, magnet)
                where = data.xpos[body]
                self._mujoco.mj_applyFT(model, data, found[:3], found[3:], where, body, data.qfrc_passive)
        except Exception as error:
            self._error = error

    def check(self) -> None:
        """Raise what went wrong in the callback since it was entered, if anything did."""
        if self._error is not None:
            raise self._error

    def __enter__(self) -> "MagnetForces":
        self._error = None
        self._before = self._mujoco.get_mjcb_passive()
        self._mujoco.set_mjcb_passive(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._mujoco.set_mjcb_passive(self._before)
        if error is None:
            self.check()
