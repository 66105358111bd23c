"""What devices of one job have in common is made once: checks of their geometry, the mutual potentials of their iron's
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
# Solutions, reactions and answers to sensors: charges of the surface, of those used last.
_MOST = 16
# Of a device: what decides neither its solves nor whether its geometry is sound.
_APART = ("title", "payload", "driver", "references", "sections", "provenance", "source", "text")


class SharedSolves:
    """The operators of the mesh of the iron that was solved last, and the last of what else was asked for.

    Memory does not grow with the number of devices. Ask for devices with the same iron one after the other.
    """

    def __init__(self) -> None:
        self._mesh = ""
        self._operators: dict[str, Any] = {}
        self._solves: OrderedDict[str, Any] = OrderedDict()

    def operator(self, mesh: IronMesh, name: str, make: Callable[[], R]) -> R:
        """What depends on the mesh and the name alone.

        Parameters
        ----------
        mesh
            Of the iron.
        name
            Of the operator.
        make
            Makes it.

        Returns
        -------
        R
            That of the mesh, or that of an equal mesh before it.
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
        """What depends on the mesh that `operator` was given last, and on this plain data.

        Parameters
        ----------
        depends_on
            Arrays, records and numbers that decide it.
        make
            Makes it.

        Returns
        -------
        R
            It, or what was made of equal data before.
        """
        return self.once((self._mesh, *depends_on), make)

    def once(self, depends_on: tuple[Any, ...], make: Callable[[], R]) -> R:
        """As `solve`, of what depends on this plain data alone, whatever the mesh."""
        try:
            key = digest(*depends_on)
        except (AttributeError, TypeError, pickle.PicklingError):
            # With a local function of the user, as the field of a source in air: nothing equals it.
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
    """What of coils decides their fields per ampere: without names and what is known of the copper."""
    unnamed = {"name": "", "resistance": None, "inductance": None}
    return tuple(replace(coil, **unnamed) for coil in coils)  # zuban: ignore[misc]


def what_is_solved(device: Device) -> tuple[Any, ...]:
    """What of a device decides its solves and whether its geometry is sound, with the names that notes tell."""
    rest = {name: value for name, value in vars(device).items() if name not in (*_APART, "coils")}
    return device.coil_names, windings(device.coils), rest
