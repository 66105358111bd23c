"""A solved device as magpylib objects: iron as magnetised tetrahedra, coils as current sheets."""

from typing import Any

import numpy as np

from fieldmap.device.model import Coil
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from fieldmap.sources.magpylib_objects import magpylib_assembly, magpylib_coil, magpylib_tetrahedra
from fieldmap.typing import Array


def mean_polarisation(state: IronState, weights: Array) -> Array:
    """Mean mu0 M (e, 3) in T of every element, of the sources with these weights.

    Raises InputError for a state that was read back from a file, which keeps charges only.
    """
    if state.inside is None:
        received = "a solution read back from a file"
        raise InputError(
            Problem(
                "magnetisation", "the field inside the iron is needed", received, "solve the device again"
            )
        )
    points, shares = tetrahedron_rule(2)
    element = np.arange(state.flux_density.shape[1])
    mean = np.zeros((len(element), 3))
    for point, share in zip(points, shares, strict=True):
        value = state.inside.polarisation(element, np.tile(point, (len(element), 1)))
        mean += share * np.tensordot(weights, value, 1)
    return mean


def as_magpylib(
    coils: tuple[Coil, ...], currents: Array, mesh: IronMesh | None, state: IronState | None, weights: Array
) -> Any:
    """One Collection: a Collection of tetrahedra for every body, one of current sheets for every coil with current."""
    parts = []
    if state is not None:
        polarisation = mean_polarisation(state, weights)
        assert mesh is not None
        corners = mesh.points[mesh.tets]
        for k, name in enumerate(mesh.body_names):
            mine = mesh.body == k
            parts.append(magpylib_tetrahedra(corners[mine], polarisation[mine], name))
    for coil, current in zip(coils, currents, strict=True):
        if current != 0:
            parts.append(magpylib_coil(coil, float(current)))
    return magpylib_assembly(*parts)
