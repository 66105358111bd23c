"""Objects of magpylib as data: an `AirSource` of each, at the last pose of its path.

They are known by their attributes and the names of their classes, so nothing here imports magpylib.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from fieldmap.device.air_sources import NEEDS, OTHER, AirSource
from fieldmap.device.placement import Placement
from fieldmap.errors import InputError, Problem

SOLIDS = ("Cuboid", "Cylinder", "CylinderSegment", "Sphere", "Tetrahedron", "TriangularMesh")

_AXES = {
    **dict.fromkeys(("current", "diameter"), 0),
    **dict.fromkeys(("dimension", "polarization", "moment"), 1),
    **dict.fromkeys(("vertices", "current_densities"), 2),
}
"""Axes of an attribute without a path."""


def sources_of(model: Any) -> list[AirSource]:
    """The sources of a model. Raises InputError for what is no source, and for a model without any."""
    problems: list[Problem] = []
    sources = [source_of(thing, problems) for thing in leaves(model)]
    if problems or not sources:
        none = Problem("from_magpylib, model", "at least one source", "none", "add a source")
        raise InputError(*(problems or [none]))
    return [source for source in sources if source is not None]


def per_ampere(source: AirSource, nominal: float | None) -> AirSource:
    """A source with its share of a current, A; None where no current is known: 1 A in each."""
    if source.current is not None:
        return replace(source, current=1.0 if nominal is None else source.current / nominal)
    if source.current_densities is not None and nominal is not None:
        return replace(source, current_densities=source.current_densities / nominal)
    return source


def leaves(model: Any) -> Iterable[Any]:
    """All sources of a Collection, nested ones too, of a sequence, or the source itself; sensors are left out."""
    if hasattr(model, "sources_all"):
        return list(model.sources_all)
    if isinstance(model, list | tuple):
        return [leaf for one in model for leaf in leaves(one)]
    if type(model).__name__ == "Sensor":
        return []
    if not hasattr(model, "getB") or not hasattr(model, "orientation"):
        received = type(model).__name__
        remedy = "give a Collection or a list of sources"
        raise InputError.of("from_magpylib, model", "magpylib sources and Collections", received, remedy)
    return [model]


def _last(thing: Any, name: str) -> Any:
    """An attribute at the end of the path, None where it is not set."""
    value = getattr(thing, name, None)
    if value is None:
        return None
    array = np.asarray(value, dtype=float)
    if array.ndim > _AXES[name]:
        array = array[-1]
    return float(array) if array.ndim == 0 else array


def source_of(thing: Any, problems: list[Problem]) -> AirSource | None:
    """The object as data, at its last pose."""
    position = np.atleast_2d(thing.position)[-1]
    rotation = np.atleast_3d(thing.orientation.as_matrix()).reshape(-1, 3, 3)[-1]
    placement = Placement(np.array(position), np.array(rotation))
    kind = type(thing).__name__
    if type(thing).__module__.split(".")[0] != "magpylib" or kind not in NEEDS:
        return AirSource(OTHER, live=thing)
    values = {name: _last(thing, name) for name in NEEDS[kind] if name in _AXES}
    missing = [name for name, value in values.items() if value is None]
    if missing:
        must_hold, received = f"{', '.join(missing)} must be set", "None"
        label = getattr(thing.style, "label", None) or kind
        problems.append(Problem(f"from_magpylib, {label}", must_hold, received, "set it in magpylib"))
        return None
    if kind == "CylinderSegment":
        values["dimension"], values["angles"] = values["dimension"][:3], values["dimension"][3:]
    if "faces" in NEEDS[kind]:
        values["faces"] = np.array(thing.faces, dtype=np.int64)
    return AirSource(kind, placement, **values)
