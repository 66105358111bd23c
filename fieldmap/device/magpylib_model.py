"""A device of a magpylib model: currents become coils, soft objects iron, magnets bodies or a background.

An object becomes a body if it or a Collection that holds it has a `susceptibility`, as in magpylib-material-response:
J = polarization + susceptibility mu0 H. For a B-H curve, `susceptibility` is a material of this package or an object
with arrays H and B. A magnet without a susceptibility has a fixed magnetisation, and its exact field is part of the
background.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from fieldmap.device.air_sources import SOLIDS, AirSource, leaves, per_ampere, source_of
from fieldmap.device.background import Background
from fieldmap.device.coils.magpylib import MagpylibCoil
from fieldmap.device.materials import Material, keys_of_table, material_of
from fieldmap.device.parts import Body, Part
from fieldmap.device.placement import Placement
from fieldmap.device.shapes.prisms import Box, ExtrudedPolygon
from fieldmap.device.shapes.triangle_surface import TriangleSurface
from fieldmap.device.shapes.turned import Cylinder, Ring, Sphere
from fieldmap.device.tetrahedra import OUTWARD
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.document import schema_findings
from fieldmap.typing import Array

# Elements along the largest extent of a body; element edge over the size of the first layer at sharp edges.
_MESH, _LAYER = 5.0, 4.0


def device_arguments(
    model: Any,
    name: str = "magpylib",
    title: str = "",
    materials: Mapping[str, Any] | None = None,
    mesh_size: float | Mapping[str, float] | None = None,
    coils: str = "each",
    **more: Any,
) -> dict[str, Any]:
    """Arguments of `Device` for a magpylib source, a Collection, or a sequence of them, at the last pose of the paths.

    materials: a material, susceptibility or curve for objects or Collections by their `style.label`, in place of their
    own `susceptibility`. mesh_size: largest element edge, m, of all bodies or by label; a fifth of the body's largest
    extent if not given, and no more than its smallest. coils: "each" makes a coil of every current, "collections" one
    coil of the currents that a Collection holds directly. more: other arguments of `Device`, such as `workspace`.

    Coils and bodies are named by label, or by class and number. A coil's field is that of 1 A;
    `Device.nominal_currents` are the currents of the model. Sensors are left out. Raises InputError with one Problem
    for every object that cannot be converted.

    >>> import fieldmap as fm
    >>> import magpylib
    >>> loop = magpylib.current.Circle(current=3.0, diameter=0.04, position=(0, 0, 0.01))
    >>> core = magpylib.magnet.Cylinder(polarization=(0, 0, 0), dimension=(0.01, 0.02))
    >>> core.susceptibility = 999.0
    >>> device = fm.Device.from_magpylib(magpylib.Collection(loop, core))
    >>> device.nominal_currents, device.bodies[0].name, device.materials["Cylinder 1"].mu_r
    ({'Circle_1': 3.0}, 'Cylinder 1', 1000.0)
    """
    if coils not in ("each", "collections"):
        remedy = 'give "each" or "collections"'
        raise InputError.of("from_magpylib, coils", 'must be "each" or "collections"', repr(coils), remedy)
    found = _Found(dict(materials or {}), mesh_size)
    groups: dict[int, list[Any]] = {}
    for thing in leaves(model):
        source = source_of(thing, found.problems)
        if source is None:
            continue
        material = found.material_of(thing)
        if source.is_current:
            parent = getattr(thing, "parent", None)
            together = coils == "collections" and parent is not None
            groups.setdefault(id(parent) if together else id(thing), []).append((thing, source, together))
        elif material is None or material == 0.0:
            found.fixed.append(source)
        else:
            found.add_body(thing, source, material)
    for members in groups.values():
        found.add_coil(members)
    unused = set(found.materials) - found.used
    if unused:
        received = ", ".join(sorted(unused))
        remedy = "use the labels of the model (style.label)"
        found.problems.append(Problem("from_magpylib, materials", "labels of the model", received, remedy))
    if found.problems:
        raise InputError(*found.problems)
    background = more.pop("background", None)
    if found.fixed:
        background = Background(sources=tuple(found.fixed)) if background is None else background
    return {
        "name": name,
        "title": title,
        "coils": tuple(found.coils),
        "bodies": tuple(found.bodies),
        "materials": found.made,
        "background": background,
        **more,
    }


class _Found:
    """The coils, bodies, materials and problems found in a model so far."""

    def __init__(self, materials: dict[str, Any], mesh_size: float | Mapping[str, float] | None) -> None:
        self.materials, self.mesh_size = materials, mesh_size
        self.coils: list[MagpylibCoil] = []
        self.bodies: list[Body] = []
        self.made: dict[str, Material] = {}
        self.fixed: list[AirSource] = []
        self.problems: list[Problem] = []
        self.used: set[str] = set()
        self._names: set[str] = set()

    def material_of(self, thing: Any) -> Any:
        """Susceptibility, curve or material of an object: its own, or that of the nearest Collection with one."""
        at = thing
        while at is not None:
            label = getattr(at.style, "label", None)
            if label in self.materials:
                self.used.add(label)
                return self.materials[label]
            own = getattr(at, "susceptibility", None)
            if own is not None:
                return own
            at = getattr(at, "parent", None)
        return None

    def named(self, thing: Any, allowed: str, gap: str) -> str:
        """A name that is not in use yet."""
        label = getattr(thing.style, "label", None)
        word = re.sub(allowed, "_", str(label).strip()) if label else ""
        if word and word not in self._names:
            self._names.add(word)
            return word
        stem, k = word or type(thing).__name__, 1
        while f"{stem}{gap}{k}" in self._names:
            k += 1
        self._names.add(f"{stem}{gap}{k}")
        return f"{stem}{gap}{k}"

    def add_coil(self, members: list[tuple[Any, AirSource, bool]]) -> None:
        """A coil of currents that are driven together, relative to the first one that is not zero."""
        first = next((source.current for _, source, _ in members if source.current), None)
        sources = [per_ampere(source, first) for _, source, _ in members]
        thing, _, together = members[0]
        name = self.named(thing.parent if together else thing, r"[^A-Za-z0-9_]", "_")
        nominal = 1.0 if first is None and sources[0].kind == "TriangleSheet" else (first or 0.0)
        self.coils.append(MagpylibCoil(name, tuple(sources), nominal_current=nominal))

    def add_body(self, thing: Any, source: AirSource, material: Any) -> None:
        """A body of iron or of a magnet with a susceptibility."""
        label = getattr(thing.style, "label", None) or type(thing).__name__
        where = f"from_magpylib, {label}"
        try:
            if source.kind not in SOLIDS:
                must_hold = f"a susceptibility belongs to one of {', '.join(SOLIDS)}"
                raise InputError.of(where, must_hold, f"a {type(thing).__name__}", "remove it")
            name = self.named(thing, r"[^A-Za-z0-9_ +-]", " ")
            law, parts = _law(where, name, source, material), parts_of(where, source)
        except InputError as error:
            self.problems += error.problems
            return
        given = self.mesh_size.get(label) if isinstance(self.mesh_size, Mapping) else self.mesh_size
        size = float(min(source.extents.max() / _MESH, source.extents.min()) if given is None else given)
        self.bodies.append(Body(name, self._material(name, law), parts, size, size / _LAYER))

    def _material(self, name: str, law: Material) -> str:
        """The name of a law in `made`: the name of the first body that has it."""
        for known, other in self.made.items():
            if law is other or (
                law.role != "magnet" and law.likeness is not None and law.likeness == other.likeness
            ):
                return known
        self.made[name] = law
        return name


def _law(where: str, name: str, source: AirSource, given: Any) -> Material:
    """The material for a susceptibility, a curve or a material; `polarization` is its remanence."""
    polarisation = np.asarray(source.polarization, dtype=float)
    remedy = "give a number, a material of fieldmap, or an object with arrays H and B"
    if isinstance(given, Material):
        if polarisation.any():
            received = f"a polarization of {polarisation.tolist()} T"
            must_hold = "a curve belongs to an object without polarization"
            raise InputError.of(where, must_hold, received, "set it to 0")
        return given
    curve = [
        next((getattr(given, key) for key in keys if hasattr(given, key)), None) for keys in ("Hh", "Bb")
    ]
    if curve[0] is not None and curve[1] is not None:
        h, b = (np.asarray(values, dtype=float).ravel() for values in curve)
        above = h > 0
        table = {"below": "straight line to the origin", "above": "slope mu0"}
        return _made(where, name, "bh_table", H_A_per_m=h[above].tolist(), B_T=b[above].tolist(), **table)
    try:
        values = np.asarray(given, dtype=float).ravel()
    except (TypeError, ValueError):
        raise InputError.of(where, "a susceptibility is a number", repr(given)[:80], remedy) from None
    if values.size not in (1, 3) or not np.isfinite(values).all() or np.ptp(values) > 0 or values[0] <= -1:
        must_hold = "one susceptibility above -1 for all directions"
        raise InputError.of(where, must_hold, f"{values.tolist()}", remedy)
    mu_r = 1.0 + float(values[0])
    if not polarisation.any():
        return _made(where, name, "linear", mu_r=mu_r)
    world = np.asarray(source.placement.rotation) @ polarisation
    return _made(where, name, "permanent_magnet", remanence_T=world.tolist(), mu_r=mu_r)


def _made(where: str, name: str, kind: str, **keys: Any) -> Material:
    """A material by the keys of device files."""
    table = {"kind": kind} | keys
    of_kind = keys_of_table(table)
    assert of_kind is not None
    findings = schema_findings(of_kind, table)
    if findings:
        first = findings[0]
        raise InputError.of(where, first.must_hold, first.received, first.remedy)
    return material_of(of_kind.model_validate(table), name, {})


def parts_of(where: str, source: AirSource) -> tuple[Part, ...]:
    """The shapes of a body. Shapes of magpylib are centred; shapes of this package stand on z = 0."""
    at, size = source.placement, source.dimension

    def placed(down: float) -> Placement:
        return Placement(at.position - np.asarray(at.rotation)[:, 2] * down, at.rotation)

    if source.kind == "Cuboid":
        x, y, z = map(float, size)  # type: ignore[arg-type]
        return (Part(Box((x, y, z)), placed(z / 2)),)
    if source.kind == "Sphere":
        return (Part(Sphere(source.diameter / 2), at),)  # type: ignore[operator]
    if source.kind == "Cylinder":
        diameter, height = map(float, size)  # type: ignore[arg-type]
        return (Part(Cylinder(diameter / 2, height), placed(height / 2)),)
    if source.kind == "CylinderSegment":
        inner, outer, height = map(float, size)  # type: ignore[arg-type]
        shape = Ring(inner, outer, height) if inner > 0 else Cylinder(outer, height)
        first, last = source.angles  # type: ignore[misc]
        whole = Part(shape, placed(height / 2))
        if last - first >= 360:
            return (whole,)
        cut = ExtrudedPolygon(_wedge(outer, last, first + 360), 2 * height)
        return whole, Part(cut, placed(height), "cut")
    corners = np.asarray(source.vertices, dtype=float)
    faces: Any = source.faces
    if source.kind == "Tetrahedron":
        volume = np.linalg.det(corners[1:] - corners[0])
        if volume == 0:
            received = "a tetrahedron without volume"
            raise InputError.of(where, "a shape with a volume", received, "correct its dimensions")
        faces = OUTWARD if volume > 0 else OUTWARD[:, ::-1]
    return (Part(TriangleSurface(corners, np.asarray(faces)), at),)


def _wedge(radius: float, first: float, last: float) -> Array:
    """Polygon (n, 2) with a corner on the axis that covers the sector of a disk between two angles, deg."""
    count = max(2, int(np.ceil((last - first) / 45.0)) + 1)
    angles = np.radians(np.linspace(first, last, count))
    far = 1.2 * radius  # the middle of a chord of 45 deg: 1.11 radius
    return np.vstack([np.zeros(2), far * np.column_stack([np.cos(angles), np.sin(angles)])])
