"""Results that devices of one job share are made once: checks of their geometry, the mutual potentials of their iron's
faces, solutions, reactions."""

import hashlib
import pickle
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from fieldmap.device.coils import Coil
from fieldmap.device.model import Device
from fieldmap.iron.mesh.mesh import IronMesh

R = TypeVar("R")
# Most solutions, reactions and answers to sensors that are kept: the last ones used.
_MOST = 16
# Fields of a device that change neither its solves nor the check of its geometry.
_APART = ("title", "payload", "driver", "references", "sections", "provenance", "source", "text")


class SharedSolves:
    """The operators of the mesh that was solved last, and the last results of solves.

    Memory does not grow with the number of devices. Ask for devices with the same iron one after the other.
    """

    def __init__(self) -> None:
        self._mesh = ""
        self._operators: dict[str, Any] = {}
        self._solves: OrderedDict[str, Any] = OrderedDict()

    def operator(self, mesh: IronMesh, name: str, make: Callable[[], R]) -> R:
        """An operator that depends on the mesh alone.

        Parameters
        ----------
        mesh
            The mesh of the iron.
        name
            Name of the operator.
        make
            Makes the operator.

        Returns
        -------
        R
            The operator, kept from the last mesh if that is equal.
        """
        content = digest(mesh.points, mesh.tets, mesh.body, mesh.body_names, mesh.symmetry, mesh.sheets)
        if content != self._mesh:
            self._mesh = content
            self._operators.clear()
        if name not in self._operators:
            self._operators[name] = make()
        found: R = self._operators[name]
        return found

    def solve(self, depends_on: tuple[Any, ...], make: Callable[[], R]) -> R:
        """A result that depends on the last mesh given to `operator` and on plain data.

        Parameters
        ----------
        depends_on
            Arrays, records and numbers on which the result depends.
        make
            Makes the result.

        Returns
        -------
        R
            The result, kept from an earlier call with equal data.
        """
        return self.once((self._mesh, *depends_on), make)

    def once(self, depends_on: tuple[Any, ...], make: Callable[[], R]) -> R:
        """As `solve`, for a result that depends on this plain data alone, not on the mesh."""
        try:
            key = digest(*depends_on)
        except (AttributeError, TypeError, pickle.PicklingError):
            # Data with a local function of the user, as the field of a source in air, cannot be compared.
            return make()
        found: R = self._solves.pop(key) if key in self._solves else make()
        self._solves[key] = found
        while len(self._solves) > _MOST:
            self._solves.popitem(last=False)
        return found


def digest(*contents: Any) -> str:
    """SHA-256 of data: equal digests mean equal data."""
    return hashlib.sha256(pickle.dumps(contents)).hexdigest()


def windings(coils: tuple[Coil, ...]) -> tuple[Coil, ...]:
    """The coils without names, resistances and inductances, on which their fields per ampere do not depend."""
    unnamed = {"name": "", "resistance": None, "inductance": None}
    return tuple(replace(coil, **unnamed) for coil in coils)  # zuban: ignore[misc]


def what_is_solved(device: Device) -> tuple[Any, ...]:
    """The data of a device for its solves and the check of its geometry, with the names that appear in notes."""
    rest = {name: value for name, value in vars(device).items() if name not in (*_APART, "coils")}
    return device.coil_names, windings(device.coils), rest
