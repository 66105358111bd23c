"""A planar device file: its tables, and the reader that checks it and makes the frozen PlanarDevice in SI units."""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.materials import AnyMaterial, Curves, material_of
from fieldmap.device.reader import checked_contents
from fieldmap.errors import DeviceFileError
from fieldmap.inputs import tables
from fieldmap.inputs.declared import record_of, table_of
from fieldmap.inputs.document import Document
from fieldmap.inputs.kinds import FileKind
from fieldmap.planar.geometry import check_planar_geometry
from fieldmap.planar.model import PlanarBody, PlanarCoil, PlanarDevice, RectangularWire, RoundWire, Wire
from fieldmap.records import FrozenDict
from fieldmap.typing import PathLike

PlanarBodyKeys: Any = table_of(PlanarBody)
Sides = Annotated[list[tables.Length], Field(min_length=2, max_length=2)]
_COIL: Any = table_of(PlanarCoil)


class PlanarCoilKeys(_COIL):
    """Conductors in series, all of one section."""

    wire_diameter_mm: tables.Length | None = Field(default=None, description="diameter of round conductors")
    wire_size_mm: Sides | None = Field(
        default=None, validate_default=True, description="[width, height] of rectangular conductors"
    )

    @field_validator("wire_size_mm")
    @classmethod
    def _one_section(cls, value: list[float] | None, info: ValidationInfo) -> list[float] | None:
        given = [key is not None for key in (info.data.get("wire_diameter_mm"), value)]
        if "wire_diameter_mm" in info.data and sum(given) != 1:
            raise tables.broken(
                "a coil has round or rectangular conductors",
                "both wire_diameter_mm and wire_size_mm" if all(given) else "neither",
                "give wire_diameter_mm, or wire_size_mm = [width, height]",
            )
        return value

    def also_makes(self) -> dict[str, Wire]:
        """The section of the conductors."""
        if self.wire_diameter_mm is not None:
            return {"wire": RoundWire(0.5 * self.wire_diameter_mm * tables.MILLI)}
        assert self.wire_size_mm is not None
        width, height = self.wire_size_mm
        return {"wire": RectangularWire(width * tables.MILLI, height * tables.MILLI)}


class WallKeys(tables.Table):
    """A box around everything that no flux passes."""

    lower_mm: tables.PlanePoint = Field(description="[x, z] of the lower left corner")
    upper_mm: tables.PlanePoint = Field(description="[x, z] of the upper right corner")

    @field_validator("upper_mm")
    @classmethod
    def _above(cls, value: list[float], info: ValidationInfo) -> list[float]:
        lower = info.data.get("lower_mm")
        if lower is not None and not (lower[0] < value[0] and lower[1] < value[1]):
            raise tables.broken(
                "upper_mm must exceed lower_mm in x and in z", f"{value}", "exchange the corners"
            )
        return value


class PlanarPayloadKeys(tables.Table):
    """What is levitated."""

    moment_A_m2: tables.Positive = Field(description="magnitude of the vertical dipole moment")


class PlanarFile(tables.Table):
    """A planar device file."""

    format: tables.Format
    space: Literal["plane"] = Field(description="everything extends to infinity across the x-z plane")
    name: tables.Name = Field(description="short name of the device")
    title: tables.Text = Field(description="one line about the device")
    material: dict[tables.Name, AnyMaterial] = Field(default={}, description="[material.NAME] tables")
    body: list[PlanarBodyKeys] = Field(default=[], description="[[body]] tables: the iron")
    coil: Annotated[list[PlanarCoilKeys], Field(min_length=1)] = Field(
        description="[[coil]] tables; currents follow this order"
    )
    walls: WallKeys | None = Field(default=None, description="walls without flux; open space without them")
    payload: PlanarPayloadKeys | None = Field(default=None, description="the levitated body")
    provenance: dict[str, tables.Text] = Field(default={}, description='"key.path" = "source of the number"')


PLANAR_DEVICE = FileKind(
    "planar device",
    PlanarFile,
    DeviceFileError,
    "geometry",
    json_schema="planar.schema.json",
)


def read_planar_device(path_or_name: PathLike) -> PlanarDevice:
    """Read and check a planar device file.

    Lengths come out in m; x to the right, z up, y into the page.

    Parameters
    ----------
    path_or_name
        Path of a TOML file with `space = "plane"`, or the name of a shipped one.

    Returns
    -------
    PlanarDevice
        The device.

    Raises
    ------
    DeviceFileError
        With one Problem for every error of the file.
    GeometryError
        Where iron, conductors and walls do not fit together.

    Examples
    --------
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
    materials = {name: material_of(table, name, curves) for name, table in contents.material.items()}
    return PlanarDevice(
        name=contents.name,
        title=contents.title,
        coils=tuple(map(record_of, contents.coil)),
        bodies=tuple(map(record_of, contents.body)),
        materials=FrozenDict(materials),
        walls=None if contents.walls is None else _corners(contents.walls),
        moment=None if contents.payload is None else contents.payload.moment_A_m2,
        provenance=FrozenDict(dict(contents.provenance)),
        source=document.path,
    )


def _corners(walls: WallKeys) -> Any:
    (x1, z1), (x2, z2) = walls.lower_mm, walls.upper_mm
    return tables.read_only([[x1, z1], [x2, z1], [x2, z2], [x1, z2]], tables.MILLI)
