"""Currents and magnets in air as shapes of the CAD kernel, mm: edges, faces, points, and magnets as solids.

The solver uses the field of such a source in free space. Inside a body that field is wrong: these methods have no
solution for a current in iron, and a magnet would fill the same space as the iron.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fieldmap.device.air_fields import faces_of, segments_of, sheet_of
from fieldmap.device.air_sources import OTHER, SOLIDS, AirSource
from fieldmap.device.magpylib_model import parts_of
from fieldmap.device.model import Body, Device, FieldSensor, Placement
from fieldmap.errors import InputError
from fieldmap.iron.geometry.shapes import MILLIMETRES, occ, place, point, polygon_face, positive, segment
from fieldmap.iron.geometry.solids import body_solid


def sources_in_air(device: Device) -> Iterator[tuple[str, str, AirSource, Placement]]:
    """Kind in words, name of the coil or "", source, and the placement of its coil, of every source in air."""
    for coil in device.coils:
        for number, source in enumerate(coil.filaments, 1):
            yield f"source {number} ({source.kind}) of coil", coil.name, source, coil.placement
    sources = () if device.background is None else device.background.sources
    for number, source in enumerate(sources, 1):
        yield f"source {number} ({source.kind}) of the background", "", source, Placement()


def has_known_place(source: AirSource) -> bool:
    """False for an object of a class outside magpylib: the place of its currents is not known."""
    return source.kind != OTHER


def source_shape(source: AirSource, frame: Placement) -> occ.TopoDS_Shape:
    """A source with a known place in the global frame, mm; frame: of the coil. Raises one of
    `fieldmap.iron.geometry.shapes.kernel_errors` where it cannot be built."""
    if source.kind in SOLIDS:
        try:
            return place(body_solid(Body("", "", parts_of("shape", source))), frame)
        except InputError as error:
            faults = (f"{problem.must_hold}: {problem.received}" for problem in error.problems)
            raise ValueError("; ".join(faults)) from error
    return place(place(_thin(source), source.placement), frame)


def sensor_spot(sensor: FieldSensor) -> occ.TopoDS_Shape:
    """The place of a sensor in the global frame, mm."""
    return occ.Vertex(point(*(MILLIMETRES * sensor.position)))


def _thin(source: AirSource) -> occ.TopoDS_Shape:
    """A source without volume in its local frame."""
    if source.kind == "Dipole":
        return occ.Vertex(point(0.0, 0.0, 0.0))
    if source.kind == "Circle":
        (diameter,) = positive(diameter=source.diameter or 0.0)
        return occ.Circle(point(0.0, 0.0, 0.0), occ.Z, diameter / 2)
    if source.kind == "Polyline":
        ends = MILLIMETRES * np.stack(segments_of(source), axis=1)
        return occ.Compound([segment(*pair) for pair in ends])
    corners = faces_of(source) if source.kind == "Triangle" else sheet_of(source)[0]
    return occ.Compound([polygon_face(MILLIMETRES * triangle) for triangle in corners])
