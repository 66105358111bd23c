"""Read a planar device file, check all of it, and make the frozen PlanarDevice in SI units."""

from pathlib import Path
from types import MappingProxyType
from typing import Any

from fieldmap.device.materials import Curves
from fieldmap.device.reader import checked_contents
from fieldmap.inputs.document import Document
from fieldmap.inputs.tables import MILLI, read_only
from fieldmap.planar.geometry_checks import check_planar_geometry
from fieldmap.planar.model import PlanarDevice
from fieldmap.planar.schema import PLANAR_DEVICE, PlanarFile, WallKeys


def read_planar_device(path_or_name: str | Path) -> PlanarDevice:
    """Read and check a planar device file.

    path_or_name: path of a TOML file with `space = "plane"`, or the name of a shipped one. Lengths come out in m;
    x to the right, z up, y into the page. Raises DeviceFileError with one Problem for every error of the file, and
    GeometryError where iron, conductors and walls do not fit together.

    >>> device = read_planar_device("planar_drive_unit")
    >>> device.coil_names
    ('left', 'right')
    """
    document = PLANAR_DEVICE.load(PLANAR_DEVICE.find(path_or_name))
    contents, curves, _ = checked_contents(document, PlanarFile)
    device = _build(contents, document, curves)
    check_planar_geometry(device)
    return device


def _build(contents: PlanarFile, document: Document, curves: Curves) -> PlanarDevice:
    materials = {name: table.to_model(name, curves) for name, table in contents.material.items()}
    return PlanarDevice(
        name=contents.name,
        title=contents.title,
        coils=tuple(coil.to_model() for coil in contents.coil),
        bodies=tuple(body.to_model() for body in contents.body),
        materials=MappingProxyType(materials),
        walls=None if contents.walls is None else _corners(contents.walls),
        moment=None if contents.payload is None else contents.payload.moment_A_m2,
        provenance=MappingProxyType(dict(contents.provenance)),
        source=document.path,
    )


def _corners(walls: WallKeys) -> Any:
    (x1, z1), (x2, z2) = walls.lower_mm, walls.upper_mm
    return read_only([[x1, z1], [x2, z1], [x2, z2], [x1, z2]], MILLI)
