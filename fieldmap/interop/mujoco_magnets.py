"""Magnets in MuJoCo: the wrench of a map's field on bodies at every step (pip install "fieldmap[mujoco]").

MuJoCo has one passive-force callback for the whole process; `MagnetForces` uses it inside its context. For most maps
the callback is compiled, and MuJoCo calls it without Python. MuJoCo's structures differ between versions, so the
offset of an array in its data is found by a search for the address from its Python binding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_vector
from fieldmap.core import CoreMap
from fieldmap.core.mujoco import Layout, Magnet, Task, callback
from fieldmap.core.several_bodies import UNSETTLED
from fieldmap.errors import InputError
from fieldmap.extras import require
from fieldmap.field import coil_currents
from fieldmap.lookup import FieldMap, MagneticBody, core_map
from fieldmap.lookup.evaluation import outside_error
from fieldmap.lookup.magnetic_body import unsettled
from fieldmap.typing import Array

_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
_LIBRARIES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
# Size of MuJoCo's data that is searched for pointers, bytes; in version 3.17 they lie near 160 000.
_DATA_SIZE = 1 << 20


class MagnetForces:
    """Force and torque of a map's field on bodies of a MuJoCo model.

    magnets: for each body, by name, its moment (3,), A m^2, at the body's origin in the frame of the body, or a
    `MagneticBody` about the origin: magnets of finite size, soft iron (`fieldmap.lookup.magnetic_body`). currents
    (n_coils,), A: assign `currents` between steps, as a controller does. offset (3,), m: the map's origin in the
    world. Axes of map and world are parallel, units are SI. mutual: whether bodies act on each other, also by soft
    iron and through the iron's reaction. Raises InputError for a body that does not exist, and for moments, currents
    or an offset that are not finite numbers of these shapes; FieldmapError without MuJoCo.

    The callback is compiled (`compiled`) unless the map has saturating iron or another evaluator than the C core.
    compiled=False selects Python. The callback serves any data and threads of the model, with the same `currents`.

    After a magnet leaves the box, no forces are added, and `check`, or the end of the context, raises
    OutsideMapError, because an exception cannot pass through MuJoCo. A map with outside="clamp" has the field of the
    edge there. Overlapping soft iron of two bodies also ends all forces, with NotConverged.

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
        magnets: Mapping[str, MagneticBody | ArrayLike],
        currents: ArrayLike,
        offset: ArrayLike = (0.0, 0.0, 0.0),
        *,
        mutual: bool = False,
        compiled: bool = True,
    ) -> None:
        mujoco = require("mujoco", "mujoco", "MagnetForces")
        for name, value, kind in (("model", model, mujoco.MjModel), ("field", field, FieldMap)):
            must_hold, received = f"must be a {kind.__name__}", type(value).__name__
            check(isinstance(value, kind), f"MagnetForces({name})", must_hold, received, "give one")
        self._mujoco, self._field, self._model = mujoco, field, model
        self._currents = np.array(coil_currents(currents, field.coil_names), dtype=np.float64)
        self._offset = check_vector("MagnetForces(offset)", offset, "give x, y and z in m")
        must_hold, remedy = "must be moments by the name of a body", 'give for example {"float": [0, 0, 0.8]}'
        given = isinstance(magnets, Mapping) and bool(magnets)
        check(given, "MagnetForces(magnets)", must_hold, repr(magnets)[:80], remedy)
        self._bodies = [(self._body(name), _known(name, magnet)) for name, magnet in magnets.items()]
        self._before: Any = None
        self._error: Exception | None = None
        self._task = None
        core, library = _core_map(field) if compiled else None, _library(mujoco)
        if core is not None and library is not None:
            self._task = self._compiled_task(library, core, mutual)
        elif mutual:
            must_hold = "needs the compiled callback"
            raise InputError.of("MagnetForces(mutual)", must_hold, "one in Python", "leave it out")

    def _body(self, name: object) -> int:
        """Number of the body of this name. Raises InputError."""
        known = self._mujoco.mjtObj.mjOBJ_BODY
        body = self._mujoco.mj_name2id(self._model, known, name) if isinstance(name, str) else -1
        check(body >= 0, "MagnetForces(magnets)", "bodies of the model", name, "check its name")
        return int(body)

    def _compiled_task(self, library: ctypes.CDLL, core: CoreMap, mutual: bool) -> Task:
        """The task for the callback of the C core."""
        data, known = self._mujoco.MjData(self._model), []
        for body, magnet in self._bodies:
            if not isinstance(magnet, MagneticBody):
                magnet = MagneticBody.dipole(magnet)
            known.append(Magnet(magnet.core, body, _free_joint(self._mujoco, self._model, body)))
        layout = Layout(
            ctypes.cast(library.mj_applyFT, ctypes.c_void_p).value or 0,
            *(_offset_of(data, array) for array in (data.xpos, data.xmat, data.qfrc_passive)),
        )
        return Task(core, self._currents, known, layout, self._offset, mutual)

    @property
    def currents(self) -> Array:
        """Currents of the coils (n_coils,), A: assign to it, or to parts of it, between steps."""
        return self._currents

    @currents.setter
    def currents(self, amperes: ArrayLike) -> None:
        self._currents[:] = coil_currents(amperes, self._field.coil_names)

    @property
    def compiled(self) -> bool:
        """Whether the callback is compiled."""
        return self._task is not None

    def wrench(self, data: Any, body: int, magnet: MagneticBody | Array) -> Array:
        """Force and torque on a magnet about its body's origin, in the world's frame.

        Parameters
        ----------
        data
            MuJoCo's data.
        body
            Number of the body.
        magnet
            A `MagneticBody`, or a moment (3,), A m^2.

        Returns
        -------
        Array
            Force, N, and torque, N m (6,).

        Raises
        ------
        InputError
            For a moment of another shape, or a number without a body.
        """
        check(
            0 <= body < len(data.xpos),
            "wrench(body)",
            f"must be 0 to {len(data.xpos) - 1}",
            body,
            "see the model",
        )
        return self._wrench(data, body, _known(body, magnet))

    def _wrench(self, data: Any, body: int, magnet: MagneticBody | Array) -> Array:
        position = data.xpos[body] - self._offset
        turn = data.xmat[body].reshape(3, 3)
        if isinstance(magnet, MagneticBody):
            return magnet.wrench(self._field, position, self.currents, turn)
        return self._field.wrench(position, turn @ magnet, self.currents)

    def __call__(self, model: Any, data: Any) -> None:
        """Add to the passive forces. MuJoCo calls this at every evaluation."""
        if self._error is not None:
            return
        try:
            for body, magnet in self._bodies:
                found = self._wrench(data, body, magnet)
                where = data.xpos[body]
                self._mujoco.mj_applyFT(model, data, found[:3], found[3:], where, body, data.qfrc_passive)
        except Exception as error:
            self._error = error

    def check(self) -> None:
        """Raise the first error in the callback since the context was entered, if any."""
        fault = None if self._error is not None or self._task is None else self._task.fault()
        if fault is not None:
            status, _, place = fault
            self._error = outside_error(place[None], 1, self._field.lower, self._field.upper)
            if status == UNSETTLED:
                self._error = unsettled("MagnetForces")
        if self._error is not None:
            raise self._error

    def __enter__(self) -> MagnetForces:
        self._error = None
        self._before = self._mujoco.get_mjcb_passive()
        if self._task is None:
            self._mujoco.set_mjcb_passive(self)
            return self
        self._task.enter()
        self._mujoco.set_mjcb_passive(_callback())
        # This call tells the callback its model.
        self._mujoco.mj_forward(self._model, self._mujoco.MjData(self._model))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._mujoco.set_mjcb_passive(self._before)
        if self._task is not None:
            self._task.leave()
        if error is None:
            self.check()


def _known(name: object, magnet: MagneticBody | ArrayLike) -> MagneticBody | Array:
    if isinstance(magnet, MagneticBody):
        return magnet
    return check_vector(f"MagnetForces(magnets[{name!r}])", magnet, "give a moment (3,) in A m^2")


def _free_joint(mujoco: ModuleType, model: Any, body: int) -> int:
    """First degree of freedom of a body whose only joint is a free joint, else -1."""
    joint = int(model.body_jntadr[body])
    alone = int(model.body_jntnum[body]) == 1 and int(model.body_parentid[body]) == 0
    free = alone and int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE)
    return int(model.jnt_dofadr[joint]) if free else -1


@cache
def _callback() -> Any:
    """The callback: one object, because MuJoCo has one at a time."""
    return _CALLBACK(callback())


def _core_map(field: FieldMap) -> CoreMap | None:
    """The map for the C core, or None if its coils' fields do not superpose, or another evaluator is used."""
    if not field.affine:
        return None
    try:
        return core_map(field)
    except InputError:
        return None


def _library(mujoco: ModuleType) -> ctypes.CDLL | None:
    """The library of the MuJoCo package; None for single precision, which the C core does not support."""
    if getattr(mujoco, "MJTNUM_DTYPE", np.float64) is not np.float64:
        return None
    folder = Path(str(mujoco.__file__)).parent
    found = [path for pattern in _LIBRARIES for path in sorted(folder.glob(pattern))]
    return ctypes.CDLL(str(found[0])) if found else None


def _offset_of(data: Any, array: Array) -> int:
    """Offset of the pointer to an array in MuJoCo's data, bytes."""
    wanted, start = array.ctypes.data, int(data._address)
    for offset in range(0, _DATA_SIZE, 8):
        if ctypes.c_size_t.from_address(start + offset).value == wanted:
            return offset
    must_hold = "must keep pointers to its arrays in the structure of its data"
    raise InputError.of("MagnetForces", must_hold, "another version of MuJoCo", "use compiled=False")
