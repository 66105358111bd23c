"""The machine and all its parts: frozen data, SI units, right-handed frame with z up.

The same rules check a `Device` that is made in Python and one that `fieldmap.device.read_device` reads from a file.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field

from fieldmap.device.background import Background as Background
from fieldmap.device.coils import AnyCoil
from fieldmap.device.coils import Coil as Coil
from fieldmap.device.coils.circular import CircularCoil as CircularCoil
from fieldmap.device.coils.magpylib import MagpylibCoil as MagpylibCoil
from fieldmap.device.coils.path import PathCoil as PathCoil
from fieldmap.device.coils.rounded_rectangle import RoundedRectangleCoil as RoundedRectangleCoil
from fieldmap.device.cross_checks import cross_findings
from fieldmap.device.made import Made
from fieldmap.device.magpylib_model import device_arguments
from fieldmap.device.materials import MATERIAL_KEYS, AnyMaterial
from fieldmap.device.materials import Material as Material
from fieldmap.device.materials import SaturatingMaterial as SaturatingMaterial
from fieldmap.device.materials.arctangent import Arctangent as Arctangent
from fieldmap.device.materials.bh_table import BHTable as BHTable
from fieldmap.device.materials.flux_barrier import FluxBarrier as FluxBarrier
from fieldmap.device.materials.froehlich import Froehlich as Froehlich
from fieldmap.device.materials.linear import LinearMaterial as LinearMaterial
from fieldmap.device.materials.marrocco import Marrocco as Marrocco
from fieldmap.device.materials.permanent_magnet import PermanentMagnet as PermanentMagnet
from fieldmap.device.parts import AnyBody, AnyReference, AnyWorkspace
from fieldmap.device.parts import Body as Body
from fieldmap.device.parts import Driver as Driver
from fieldmap.device.parts import FieldSensor as FieldSensor
from fieldmap.device.parts import Joint as Joint
from fieldmap.device.parts import Part as Part
from fieldmap.device.parts import Reference as Reference
from fieldmap.device.parts import Section as Section
from fieldmap.device.parts import Workspace as Workspace
from fieldmap.device.parts import WorkspaceBox as WorkspaceBox
from fieldmap.device.parts import WorkspaceCylinder as WorkspaceCylinder
from fieldmap.device.patterns import Image, Repeat, with_short_forms
from fieldmap.device.payload import OF_PIECES, AnyPayload
from fieldmap.device.payload import MagnetBlock as MagnetBlock
from fieldmap.device.payload import MagnetCylinder as MagnetCylinder
from fieldmap.device.payload import MagnetSphere as MagnetSphere
from fieldmap.device.payload import Payload as Payload
from fieldmap.device.payload import PayloadPiece as PayloadPiece
from fieldmap.device.payload import SoftEllipsoid as SoftEllipsoid
from fieldmap.device.payload import SoftSphere as SoftSphere
from fieldmap.device.placement import Placement as Placement
from fieldmap.device.placement import placed as placed
from fieldmap.device.shapes import Shape as Shape
from fieldmap.device.shapes import ShapeOfFile
from fieldmap.device.shapes.meshes import MeshFile as MeshFile
from fieldmap.device.shapes.meshes import VolumeMesh as VolumeMesh
from fieldmap.device.shapes.prisms import Box as Box
from fieldmap.device.shapes.prisms import ExtrudedPolygon as ExtrudedPolygon
from fieldmap.device.shapes.step_file import StepFile as StepFile
from fieldmap.device.shapes.triangle_surface import TriangleSurface as TriangleSurface
from fieldmap.device.shapes.turned import Cylinder as Cylinder
from fieldmap.device.shapes.turned import RevolvedProfile as RevolvedProfile
from fieldmap.device.shapes.turned import Ring as Ring
from fieldmap.device.shapes.turned import Sphere as Sphere
from fieldmap.device.toml_text import toml_text
from fieldmap.errors import InputError, Problem
from fieldmap.field import Bounds
from fieldmap.inputs.declared import Key, default_of, table_of
from fieldmap.inputs.document import schema_findings
from fieldmap.inputs.explain import REQUIRED
from fieldmap.inputs.findings import Finding, shown
from fieldmap.inputs.key_paths import Location, dotted, matches, value_at
from fieldmap.inputs.tables import Format, Name, Text
from fieldmap.inputs.writing import Writing
from fieldmap.records import FrozenDict, card

_EMPTY: Mapping[str, str] = FrozenDict({})
BACKGROUND, DRIVER, JOINT, SECTION, SENSOR = map(table_of, (Background, Driver, Joint, Section, FieldSensor))
CHANGED = "# Changed as it was read: "
"""What the text of a device begins with, of whose file keys were set to other values; which ones follows."""
_SEQUENCES = ("coils", "bodies", "references", "sections", "joints", "sensors")


@dataclass(frozen=True, eq=False, repr=False)
class Device(Made):
    """A whole machine, checked when it is made: InputError with one Problem for everything that is wrong.

    title: one line about the device; "" stands for the name. materials: by the names that bodies use; a material with
    another name is renamed. background: a field that nothing in the device drives. joints: thin gaps between bodies
    that touch. sensors: of the flux density. provenance: source of each number, by its key path in the file.
    Map files record `text` and `included`: `text` is the file as read, or the text of `to_toml`; `included` maps each
    file that it names to its text (material files) or to "sha256:..." of its bytes (STEP and mesh files).

    >>> coil = CircularCoil("coil", inner_radius=0.02, outer_radius=0.03, height=0.01, turns=100)
    >>> Device("pair", "Two coils", coils=coil.along([0.0, 0.0, 0.03], 2)).coil_names
    ('coil_1', 'coil_2')
    >>> Device("none", "No turns", coils=[CircularCoil("a", 0.02, 0.03, 0.01, turns=-100)])
    Traceback (most recent call last):
    fieldmap.errors.InputError: Device "none", coil "a": coils[0].turns: must be greater than 0; received -100; ...
    """

    name: Annotated[str, Key(Name, "short name of the device")]
    title: Annotated[str, Key(Text, "one line about the device")]
    coils: Annotated[
        tuple[Coil, ...], Key(list[AnyCoil], "[[coil]] tables; currents follow this order", name="coil")
    ] = ()
    bodies: Annotated[
        tuple[Body, ...], Key(list[AnyBody], "[[body]] tables: the iron and the magnets", name="body")
    ] = ()
    materials: Annotated[
        Mapping[str, Material], Key(dict[Name, AnyMaterial], "[material.NAME] tables", name="material")
    ] = field(default_factory=dict)
    payload: Annotated[Payload | None, Key(AnyPayload | None, "the levitated body")] = None
    driver: Annotated[Driver | None, Key(DRIVER | None, "the amplifiers of the coils")] = None
    workspace: Annotated[Workspace | None, Key(AnyWorkspace | None, "where the payload may go")] = None
    references: Annotated[
        tuple[Reference, ...], Key(list[AnyReference], "[[reference]] tables: known values", name="reference")
    ] = ()
    sections: Annotated[
        tuple[Section, ...], Key(list[SECTION], "[[section]] tables: cross-sections of iron", name="section")
    ] = ()
    provenance: Annotated[
        Mapping[str, str], Key(dict[str, Text], '"key.path" = "source of the number"; * means any one step')
    ] = field(default_factory=lambda: _EMPTY)
    source: Path | None = None
    text: str = field(default="", repr=False)
    included: Mapping[str, str] = field(default_factory=lambda: _EMPTY, repr=False)
    background: Annotated[
        Background | None, Key(BACKGROUND | None, "a field that nothing in the device drives")
    ] = None
    joints: Annotated[
        tuple[Joint, ...],
        Key(list[JOINT], "[[joint]] tables: thin gaps between bodies that touch", name="joint"),
    ] = ()
    sensors: Annotated[
        tuple[FieldSensor, ...],
        Key(list[SENSOR], "[[sensor]] tables: Hall and fluxgate elements", name="sensor"),
    ] = ()

    def __post_init__(self) -> None:
        problems = []
        for name in _SEQUENCES:
            given = getattr(self, name)
            if isinstance(given, str) or not hasattr(given, "__iter__"):
                remedy = "write it in brackets"
                problems.append(Problem(f"Device.{name}", "must be a sequence", type(given).__name__, remedy))
                continue
            object.__setattr__(self, name, tuple(given))
        for name in ("materials", "provenance", "included"):
            given = getattr(self, name)
            if not isinstance(given, Mapping):
                remedy = "write { name: value }"
                problems.append(Problem(f"Device.{name}", "must be a mapping", type(given).__name__, remedy))
                continue
            object.__setattr__(self, name, FrozenDict(given))
        if problems:
            raise InputError(*problems)
        self._name_materials()
        self._take_materials_of_payload()
        written = _checked(self)
        if not self.text and not written.unwritten:
            object.__setattr__(self, "text", toml_text(written.data))
            object.__setattr__(self, "included", FrozenDict(hashes_of_files(self.bodies, Path())))

    def _name_materials(self) -> None:
        renamed = {
            # Compared as texts: callers may give anything as a name, even an array.
            name: replace(one, name=name)  # zuban: ignore[misc]
            if isinstance(one, Material) and str(one.name) != name
            else one
            for name, one in self.materials.items()
        }
        object.__setattr__(self, "materials", FrozenDict(renamed))

    def _take_materials_of_payload(self) -> None:
        """Replace material names in the payload's pieces by the device's materials. Add the pieces' own to these."""
        if not isinstance(self.payload, Payload) or not isinstance(self.payload.pieces, tuple):
            return
        payload = self.payload.with_materials(self.materials) if self.payload.pieces else self.payload
        own = [getattr(getattr(piece, "shape", None), "material", None) for piece in payload.pieces]
        new = {one.name: one for one in own if isinstance(one, Material) and one.name not in self.materials}
        object.__setattr__(self, "payload", payload)
        object.__setattr__(self, "materials", FrozenDict({**self.materials, **new}))

    @classmethod
    def unchecked(cls, **values: Any) -> Self:
        """A device whose values are not checked: a file's keys were checked already, or materials of bodies are
        left out on purpose.

        Parameters
        ----------
        **values
            Arguments of the class.

        Returns
        -------
        Self
            The device.
        """
        device = object.__new__(cls)
        defaults = {one.name: default_of(one) for one in fields(cls)}
        for name, value in (defaults | {"title": ""} | values).items():
            object.__setattr__(device, name, value)
        return device

    @classmethod
    def from_magpylib(cls, model: Any, **options: Any) -> Self:
        """The device of a magpylib source or Collection: see
        `fieldmap.device.magpylib_model.device_arguments`.

        Currents become coils. Objects with a susceptibility or B-H curve become iron, and magnets without
        either become a background.

        Parameters
        ----------
        model
            A magpylib source or Collection.
        **options
            Options of `device_arguments`.

        Returns
        -------
        Self
            The device.

        Raises
        ------
        InputError
            For a model that cannot become a device.
        """
        return cls(**device_arguments(model, **options))

    @property
    def nominal_currents(self) -> dict[str, float]:
        """Current of each coil in its original model, A, by the coil's name; only for coils that have one."""
        known = {coil.name: getattr(coil, "nominal_current", None) for coil in self.coils}
        return {name: current for name, current in known.items() if current is not None}

    def _repr_html_(self) -> str:
        from fieldmap.device.drawing import small_picture

        rows = {
            "coils": f"{len(self.coils)}: {', '.join(self.coil_names)}",
            "bodies": f"{len(self.bodies)}: {', '.join(body.name for body in self.bodies)}",
            "materials": ", ".join(f"{name}: {one.description}" for name, one in self.materials.items()),
        }
        if self.joints:
            rows["joints"] = ", ".join(joint.description for joint in self.joints)
        if self.background is not None:
            rows["background"] = self.background.description
        if self.payload is not None:
            rows["payload"] = f"{1e3 * self.payload.mass:.4g} g, {self.payload.description}"
        if self.bounds is not None:
            corners = (" x ".join(f"{1e3 * x:g}" for x in corner) for corner in self.bounds)
            rows["workspace"] = " to ".join(corners) + " mm"
        return card(f"{self.name}: {self.title}", rows, small_picture(self.bodies, self.coils))

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of currents."""
        return tuple(coil.name for coil in self.coils)

    @property
    def fixed_sources(self) -> tuple[str, ...]:
        """Names of the field sources that no current drives: permanent magnets among the bodies, and "background"."""
        magnets = [body.name for body in self.bodies if self.materials[body.material].role == "magnet"]
        return tuple(magnets) if self.background is None else (*magnets, "background")

    @property
    def bounds(self) -> Bounds | None:
        """Corners of the axis-parallel box around the workspace, m; None without a workspace."""
        return None if self.workspace is None else self.workspace.bounds

    @property
    def texts(self) -> tuple[str, ...]:
        """The texts that define the device: its file, then name and text (or hash) of each file that it names."""
        return (self.text, *(part for pair in sorted(self.included.items()) for part in pair))

    @property
    def changed(self) -> str:
        """The keys of its file that were set to other values as it was read, and what the file states; empty without
        any.

        >>> import fieldmap as fm
        >>> fm.read_device("desk_levitator", {"payload.mass_g": 13.0}).changed
        'desk_levitator.toml with payload.mass_g = 13.0 (12.0 in the file)'
        """
        first, _, _ = self.text.partition("\n")
        return first.removeprefix(CHANGED).removesuffix(".") if first.startswith(CHANGED) else ""

    def replace(self, **changes: Any) -> Device:
        """The device with other values, checked anew; its text is the text of `to_toml`.

        Entries of `provenance` for numbers that no longer exist are removed.

        Parameters
        ----------
        **changes
            Arguments of the class.

        Returns
        -------
        Device
            The device.

        Raises
        ------
        InputError
            For values that a device cannot have.

        Examples
        --------
        >>> import fieldmap as fm
        >>> fm.read_device("loop_and_sphere").replace(name="mine").name
        'mine'
        """
        about: dict[str, Any] = {"source": None, "text": "", "included": {}} | changes
        bare = replace(self, **{**about, "provenance": {}})
        data = written_device(bare).data
        wanted = about.get("provenance") or {
            path: text for path, text in self.provenance.items() if matches(data, path)
        }
        return replace(bare, provenance=wanted, text="") if wanted else bare

    def to_toml(self) -> str:
        """The text of a device file that reads back as this device, with all tables written out and lengths in mm.

        Raises InputError for coils and materials of classes that have no keys.
        """
        written = written_device(self.replace() if self.text else self)
        if written.unwritten:
            received = ", ".join(written.unwritten)
            remedy = "give its class keys (docs/extend.md)"
            must_hold = "coils and materials that a device file can hold"
            raise InputError.of(f'Device "{self.name}"', must_hold, received, remedy)
        return toml_text(written.data)


def hashes_of_files(bodies: tuple[Body, ...], folder: Path) -> dict[str, str]:
    """SHA-256 of the STEP and mesh files that bodies name, by their paths relative to a folder."""
    shapes = [part.shape for body in bodies for part in body.parts]
    files = {shape.path for shape in shapes if isinstance(shape, ShapeOfFile)}
    return {
        os.path.relpath(path, folder): "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(files)
    }


# ---- the file of a device, and checks of a device ----

_DEVICE: Any = table_of(Device, "", "DeviceKeys")


class DeviceFile(_DEVICE):
    """A device file."""

    format: Format
    parameters: dict[str, Any] = Field(
        default={}, description='numbers, texts and lists that expressions such as "= 2*gap" use'
    )

    @classmethod
    def model_json_schema(cls, *arguments: Any, **named: Any) -> dict[str, Any]:
        """With the short forms that `fieldmap.device.expansion` writes out."""
        schemas = (one.model_json_schema(*arguments, **named) for one in (super(), Repeat, Image))
        return with_short_forms(*schemas)


def written_device(device: Device, whole: bool = True) -> Writing:
    """The data of a device, even of one with wrong values. whole: with sections, known values and provenance."""
    written = Writing("see help(fieldmap.Device)")
    without = () if whole else ("sections", "references", "provenance")
    written.data = {"format": 1} | written.table(device, DeviceFile, without=without)
    if isinstance(device.title, str) and not device.title and isinstance(device.name, str):
        written.data["title"] = device.name
    _check_payload(written, device)
    return written


def _check_payload(written: Writing, device: Device) -> None:
    """A moment given with magnets must be the moment of these magnets, and a piece's material must be the device's
    material of that name."""
    payload = device.payload
    if not isinstance(payload, Payload):
        return
    if not payload.pieces:
        if payload.magnet is not None:
            _check_moment(written, payload, "the magnet", magnet=payload.magnet)
        return
    if payload.magnet is not None:
        written.refuse(("payload", "magnet"), "payload.magnet", "must be one of the pieces", payload.magnet)
    if payload.direction != "up":
        written.refuse(("payload", "direction"), "payload.direction", OF_PIECES, payload.direction)
    _check_moment(written, payload, "the magnets among the pieces", pieces=payload.pieces)
    for k, piece in enumerate(payload.pieces):
        material = getattr(getattr(piece, "shape", None), "material", None)
        if isinstance(material, Material) and not _are_alike(material, device.materials.get(material.name)):
            place: Location = ("payload", "piece", k, "material")
            must_hold = "must be the material that the device has by this name"
            received = f'another material called "{material.name}"'
            written.findings.append(Finding(place, must_hold, received, "give one of the two another name"))


def _check_moment(written: Writing, payload: Payload, whose: str, **magnets: Any) -> None:
    try:
        moment = Payload(mass=1.0, **magnets).moment
        agree = abs(payload.moment - moment) <= 1e-9 * abs(moment)
    except (TypeError, ValueError, AttributeError, OverflowError):
        return  # the magnet's own error is reported
    if not agree:
        must_hold = f"must be that of {whose}, {moment:.6g}: volume times remanence over mu0"
        place = ("payload", "moment_A_m2")
        written.paths[place] = "payload.moment"
        remedy = f"leave the moment out, or {whose}"
        written.findings.append(Finding(place, must_hold, shown(payload.moment), remedy))


def _are_alike(one: Material, other: object) -> bool:
    """Whether two materials are written alike in a file; always true for classes without keys."""
    keys = MATERIAL_KEYS.get(getattr(one, "kind", ""))
    if one is other or keys is None or keys.makes is not type(one):
        return True
    return type(one) is type(other) and Writing("").table(one, keys) == Writing("").table(other, keys)


def _checked(device: Device) -> Writing:
    """The data of a device. Raises InputError with one Problem for everything that is wrong with it."""
    # Sections, references and provenance of a device that was read refer to its text, not to parts replaced since.
    read = bool(device.text)
    written = written_device(device, whole=not read)
    findings = list(written.findings)
    if not findings:
        findings = schema_findings(DeviceFile, written.data)
        missing = {dotted(written.data, one.location) for one in findings if one.must_hold == REQUIRED}
        findings += [
            one
            for one in cross_findings(written.data, Path(), missing)
            if not _follows_from_what_is_left_out(one, written, read and not device.materials)
        ]
    if findings:
        raise InputError(*(_problem(written, finding) for finding in findings))
    return written


def _follows_from_what_is_left_out(finding: Finding, written: Writing, without_materials: bool) -> bool:
    """Whether a finding only comes from parts of classes without keys, or from the missing materials of a recorded
    device."""
    place = finding.location
    if place[-1:] == ("material",):
        return without_materials or value_at(written.data, place) in written.unwritten
    return bool(written.unwritten) and place[:1] in ((), ("reference",))


def _problem(written: Writing, finding: Finding) -> Problem:
    location = finding.location
    title = f'Device "{written.data.get("name")}"'
    if len(location) > 1 and location[0] in ("body", "coil", "section", "sensor", "material"):
        at = (*location[:2], "name")
        name = location[1] if location[0] == "material" else value_at(written.data, at)
        title += f', {location[0]} "{name}"' if isinstance(name, str) else ""
    if location[:1] == ("provenance",):  # its next step is a key path
        path = f"provenance[{location[1]!r}]" if len(location) > 1 else "provenance"
        return Problem(f"{title}: {path}", finding.must_hold, finding.received, finding.remedy)
    return written.problem(finding, title)
