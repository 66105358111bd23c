"""Whether a device's bodies, windings and workspace can exist together: every fault at once, with numbers.

Refused: shapes that cannot be built or have no volume, bodies that overlap, bodies whose common surface is no
manifold, bodies less than a micrometre apart, bodies with a mesh of their own that touch others elsewhere than in
common faces, windings that cut iron or each other, currents, magnets and sensors in air that lie in a body, a workspace
that cuts iron, a winding or a source in air. Contact by faces is sound. Allowed, and listed by `geometry_notes`: a body
in several pieces, windings that fill the very same space (two circuits wound together), a STEP file that declares
another unit than the device file, a source in air at an unknown place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Body, Device, StepFile
from fieldmap.errors import GeometryError, Problem
from fieldmap.iron.geometry import contacts, shapes, solids, sources

_SAME_AREA = 1e-5
SAME_VOLUME = 1e-6
"""Relative. Volumes that agree to this are the same: the kernel integrates volumes to about 1e-9, and a fault
as small as this would not be seen in any field."""


def check_geometry(device: Device) -> None:
    """Refuse a device whose geometry is not sound.

    Numbers in the messages are in mm and mm^3. Eleven bodies and six coils take half a second.

    Parameters
    ----------
    device
        The device.

    Raises
    ------
    GeometryError
        With one problem for every fault.

    Examples
    --------
    >>> import fieldmap.device.model as model
    >>> part = model.Part(model.Sphere(0.01))
    >>> twins = tuple(model.Body(name, "iron", (part,), mesh_size=0.005) for name in ("a", "b"))
    >>> iron = {"iron": model.LinearMaterial("iron", 1000.0)}
    >>> check_geometry(model.Device("twins", "Two spheres in one place", (), twins, iron))
    Traceback (most recent call last):
    fieldmap.errors.GeometryError: device 'twins': body 'a' and body 'b': bodies may touch but not ...
    """
    findings = _found_last[device] = _examine(device)
    if findings.problems:
        raise GeometryError(*findings.problems)


def geometry_notes(device: Device) -> tuple[str, ...]:
    """Notes on geometry that is allowed but unusual.

    If `check_geometry` has examined this device, its findings are used again.

    Parameters
    ----------
    device
        The device.

    Returns
    -------
    tuple[str, ...]
        One sentence each.
    """
    return (_found_last.get(device) or _examine(device)).notes


def distances_to_workspace(device: Device, least: float) -> dict[str, float]:
    """Bodies that are nearer to the workspace than a distance.

    Parameters
    ----------
    device
        A device that passed `check_geometry`, with a workspace.
    least
        The distance, m.

    Returns
    -------
    dict[str, float]
        Distances, m, by the names of the bodies; 0 where they touch.
    """
    assert device.workspace is not None
    workspace, limit = shapes.workspace_solid(device.workspace), shapes.MILLIMETRES * least
    near = {}
    for body in device.bodies:
        solid = solids.body_solid(body)
        if (
            contacts.bounds_nearer_than(solid, workspace, limit)
            and (found := solid.Distance(workspace)) < limit
        ):
            near[body.name] = found / shapes.MILLIMETRES if found > contacts.CONTACT_DISTANCE else 0.0
    return near


@dataclass(frozen=True)
class _Findings:
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]


# Kept, because a solve checks first and states the notes at its end: the solids are built and compared once.
_found_last: WeakKeyDictionary[Device, _Findings] = WeakKeyDictionary()


def _examine(device: Device) -> _Findings:
    label, problems = solids.device_label(device), list[Problem]()

    def built(
        kind: str, name: str, solid_of: Callable[..., shapes.occ.TopoDS_Shape], *of: Any
    ) -> contacts.NamedSolid | None:
        """The shape of a body, winding, source or workspace; None, and a problem, where it cannot be built."""
        try:
            return contacts.NamedSolid(kind, name, solid_of(*of))
        except GeometryError as error:
            problems.extend(replace(one, where=f"{label}: {one.where}") for one in error.problems)
        except shapes.kernel_errors() as error:
            where = f"{label}: {kind} '{name}'" if name else f"{label}: {kind}"
            must_hold = f"the {kind} must be a shape that the CAD kernel can build"
            received = str(error).strip() or type(error).__name__
            problems.append(Problem(where, must_hold, received, "correct its dimensions"))
        return None

    def refuse(overlaps: Iterable[contacts.Overlap | contacts.Contact], must_hold: str, remedy: str) -> None:
        for one in overlaps:
            problems.append(Problem(f"{label}: {one.first} and {one.second}", must_hold, str(one), remedy))

    all_bodies = [(body, built("body", body.name, solids.body_solid, body)) for body in device.bodies]
    wound = [coil for coil in device.coils if coil.has_winding]
    every = [built("winding", coil.name, shapes.winding_solid, coil) for coil in wound]
    windings = [solid for solid in every if solid is not None]
    faults = [(solid, _body_fault(label, body, solid)) for body, solid in all_bodies if solid is not None]
    problems += [fault for _, fault in faults if fault is not None]
    bodies = [solid for solid, fault in faults if fault is None]
    overlapping = contacts.overlaps(combinations(bodies, 2))
    remedy = "move or shorten one, or cut the overlap from it"
    refuse(overlapping, "bodies may touch but not overlap", remedy)
    if len(bodies) == len(device.bodies) > 0:
        # A missing body might make a contact sound, so contacts are checked only if all bodies could be built.
        problems += _contact_problems(label, device, bodies, overlapping)
    remedy = "correct the winding's widths or place, or cut the body"
    refuse(contacts.overlaps(product(windings, bodies)), "a winding must not cut a body", remedy)
    placed = [one for one in sources.sources_in_air(device) if sources.has_known_place(one[2])]
    shaped = [built(kind, name, sources.source_shape, *where) for kind, name, *where in placed]
    in_air = [shape for shape in shaped if shape is not None]
    must_hold = f"a source in air must lie outside of each body, a wire, sheet or dipole {contacts.LEAST_GAP:g} mm away"
    remedy = "move it, or cut the body: a magnet inside iron is a body itself, a wire passes through a hole"
    refuse(contacts.clashes(product(in_air, bodies)), must_hold, remedy)
    elements = [built("sensor", one.name, sources.sensor_spot, one) for one in device.sensors]
    must_hold = f"a sensor must lie outside of each body, {contacts.LEAST_GAP:g} mm away"
    spots = [spot for spot in elements if spot is not None]
    refuse(contacts.clashes(product(spots, bodies)), must_hold, "move it into the air")
    shared = contacts.overlaps(combinations(windings, 2))
    must_hold = "windings must not overlap, unless both fill the very same space"
    apart, together = ([one for one in shared if _same_space(one) == alike] for alike in (False, True))
    refuse(apart, must_hold, "correct the widths or places of the windings")
    if device.workspace is not None:
        workspace = built("workspace", "", shapes.workspace_solid, device.workspace)
        if workspace is not None:
            found = contacts.clashes((workspace, shape) for shape in (*bodies, *windings, *in_air))
            must_hold = "the workspace must be free of bodies, windings and sources in air"
            refuse(found, must_hold, "make the workspace smaller or move it")
    return _Findings(tuple(problems), tuple(_notes(device, bodies, together)))


# ---- one solid at a time ----


def _body_fault(label: str, body: Body, solid: contacts.NamedSolid) -> Problem | None:
    pieces = solid.solid.solids
    size = float(np.linalg.norm(np.subtract(*contacts.bounds(solid.solid)))) if len(pieces) else 0.0
    if solid.volume <= contacts.CONTACT_DISTANCE * size**2:
        remedy = "correct its dimensions and its cuts; in a STEP file, the direction of its surface"
        received = f"{solid.volume:.3g} mm^3"
        return Problem(f"{label}: {solid}", "a body must have a volume above zero", received, remedy)
    if not any(isinstance(part.shape, StepFile) for part in body.parts) or _halves_add_up(solid):
        return None
    must_hold = "the surface of a body must enclose it once"
    remedy = "repair the STEP file in the program that wrote it"
    return Problem(f"{label}: {solid}", must_hold, "a surface that crosses itself or has holes", remedy)


def _halves_add_up(body: contacts.NamedSolid) -> bool:
    """True where both halves of the body, cut through the middle, make up its volume along each axis.

    If a surface crosses itself or is open, the kernel's cuts and its integral give different volumes.
    """
    lower, upper = contacts.bounds(body.solid)
    lower, upper = lower - 1.0, upper + 1.0
    for axis in range(3):
        low_end, high_start = upper.copy(), lower.copy()
        low_end[axis] = high_start[axis] = (lower[axis] + upper[axis]) / 2
        halves = (_box(lower, low_end), _box(high_start, upper))
        total = sum(piece.mass for half in halves for piece in (body.solid * half).solids)
        if abs(total - body.volume) > SAME_VOLUME * body.volume:
            return False
    return True


def _box(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> shapes.occ.TopoDS_Shape:
    return shapes.occ.Box(shapes.occ.Pnt(*map(float, lower)), shapes.occ.Pnt(*map(float, upper)))


# ---- solids against each other ----


def _same_space(overlap: contacts.Overlap) -> bool:
    """True where the overlap is the whole of both windings: two circuits wound together."""
    windings = (overlap.first, overlap.second)
    return all(abs(winding.volume - overlap.volume) <= SAME_VOLUME * winding.volume for winding in windings)


def _contact_problems(
    label: str, device: Device, bodies: list[contacts.NamedSolid], overlapping: Sequence[contacts.Overlap]
) -> Iterator[Problem]:
    glued = solids.glue_solids(body.solid for body in bodies)
    told = {frozenset((overlap.first.name, overlap.second.name)) for overlap in overlapping}
    for pinch in contacts.pinches(glued):
        where = "along an edge" if pinch.kind == "edge" else "at a point"
        at = ", ".join(f"{x:.8g}" for x in np.round(pinch.at, 6) + 0.0)
        more = f" and {pinch.count - 1} more places" if pinch.count > 1 else ""
        alone = len(pinch.names) == 1
        yield Problem(
            f"{label}: {'body' if alone else 'bodies'} {' and '.join(map(repr, pinch.names))}",
            f"{'a body must not touch itself' if alone else 'bodies must touch by faces, not'} only {where}",
            f"contact {where} at ({at}) mm{more}",
            "move the pieces apart, or let them touch over an area",
        )
    for first, second, distance in contacts.near_misses(bodies, glued):
        if {first, second} in told:
            continue
        must_hold = f"bodies must touch or leave a gap of at least {contacts.LEAST_GAP:g} mm"
        received = f"a gap of {distance:.3g} mm"
        remedy = "give both the same coordinate where they touch, or widen the gap"
        if distance == 0.0:
            must_hold = "bodies must touch by faces, not only along a line or at a point"
            received = "surfaces that touch without a common area"
            remedy = "move the bodies apart, or let them touch over an area"
        yield Problem(f"{label}: bodies '{first}' and '{second}'", must_hold, received, remedy)
    own = {body.name: solids.own_mesh(body) for body in device.bodies if body.has_own_mesh}
    areas = contacts.contact_areas(glued) if own or device.joints else {}
    for joint in device.joints:
        if joint.between is not None and not any(joint.holds(*pair) for pair in areas):
            must_hold = "the bodies of a joint must touch over an area"
            remedy = "draw them in contact: the joint opens the gap; a gap that is drawn needs no joint"
            yield Problem(f"{label}: {joint.description}", must_hold, "no such bodies", remedy)
    for (first, second), area in areas.items():
        if (first in own or second in own) and frozenset((first, second)) not in told:
            shared = solids.common_area(own[first], own[second]) if first in own and second in own else 0.0
            if abs(1e6 * shared - area) > _SAME_AREA * area:
                yield Problem(
                    f"{label}: bodies '{first}' and '{second}'",
                    "a body with a mesh of its own touches others by common faces of their meshes only",
                    f"a contact of {area:.6g} mm^2, common faces of {1e6 * shared:.6g} mm^2",
                    "mesh both together, each as a region of one file, or leave a gap",
                )


# ---- notes ----


def _notes(
    device: Device, bodies: list[contacts.NamedSolid], wound_together: list[contacts.Overlap]
) -> Iterator[str]:
    for solid in bodies:
        pieces = len(solid.solid.solids)
        if pieces > 1:
            yield f"{solid} is in {pieces} separate pieces"
    for overlap in wound_together:
        yield f"{overlap.first} and {overlap.second} fill the same space, as two circuits wound together"
    for kind, name, source, _ in sources.sources_in_air(device):
        if not sources.has_known_place(source):
            owner = f"{kind} '{name}'" if name else kind
            yield f"{owner}: its place is not known, so that nobody has checked that it lies outside of all bodies"
    sound = {solid.name for solid in bodies}
    for body in device.bodies:
        for part in body.parts:
            if body.name in sound and isinstance(part.shape, StepFile):
                yield from _unit_note(body, part.shape)
        if body.name in sound and body.has_own_mesh and (count := solids.higher_order_cells(body)):
            yield (
                f"body '{body.name}': {count} tetrahedra of its file have more than four nodes; they are taken by"
                " their corners, with straight edges"
            )


def _unit_note(body: Body, step: StepFile) -> Iterator[str]:
    unit = shapes.declared_step_unit(step.path)
    if unit is not None and abs(unit - step.scale) > SAME_VOLUME * unit:
        yield (
            f"body '{body.name}': the STEP file {step.path.name} declares a unit of {unit:g} m, the device"
            f" file {step.scale:g} m; the device file's is used"
        )
