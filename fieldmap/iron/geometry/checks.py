"""Whether a device's bodies, windings and workspace can exist together: every fault at once, with numbers.

Refused: what cannot be built or has no volume, bodies that overlap, bodies whose common surface is no
manifold, bodies less than a micrometre apart, bodies with a mesh of their own that touch others elsewhere than in
common faces, windings that cut iron or each other, a workspace that cuts
iron or a winding. Contact by faces is sound. Allowed, and told by `geometry_notes`: a body in several pieces,
windings that fill the very same space (two circuits wound together), a STEP file that declares another unit
than the device file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Body, Coil, Device, StepFile
from fieldmap.errors import GeometryError, Problem
from fieldmap.iron.geometry import contacts
from fieldmap.iron.geometry.shapes import (
    declared_step_unit,
    kernel_errors,
    occ,
    winding_solid,
    workspace_solid,
)
from fieldmap.iron.geometry.solids import (
    body_solid,
    common_area,
    device_label,
    glue_solids,
    higher_order_cells,
    own_mesh,
)


def cannot_build(label: str, kind: str, name: str, error: Exception) -> Problem:
    """A winding or workspace whose numbers make no solid."""
    where = f"{label}: {kind} '{name}'" if name else f"{label}: {kind}"
    must_hold = f"the {kind} must be a solid that the CAD kernel can build"
    return Problem(where, must_hold, str(error).strip() or type(error).__name__, "correct its dimensions")


def _overlapping(
    label: str, found: Iterable[contacts.Overlap], must_hold: str, remedy: str
) -> Iterator[Problem]:
    for overlap in found:
        yield Problem(f"{label}: {overlap.first} and {overlap.second}", must_hold, str(overlap), remedy)


def pinched(label: str, pinch: contacts.Pinch) -> Problem:
    """A place where the iron's surface is no manifold."""
    names = " and ".join(f"'{name}'" for name in pinch.names)
    where = "along an edge" if pinch.kind == "edge" else "at a point"
    at = ", ".join(f"{x:.8g}" for x in np.round(pinch.at, 6) + 0.0)
    more = f" and {pinch.count - 1} more places" if pinch.count > 1 else ""
    alone = len(pinch.names) == 1
    return Problem(
        f"{label}: {'body' if alone else 'bodies'} {names}",
        f"{'a body must not touch itself' if alone else 'bodies must touch by faces, not'} only {where}",
        f"contact {where} at ({at}) mm{more}",
        "move the pieces apart, or let them touch over an area",
    )


def nearly_touching(label: str, first: str, second: str, distance: float) -> Problem:
    """Bodies that touch without a common area, or all but touch."""
    where = f"{label}: bodies '{first}' and '{second}'"
    if distance == 0.0:
        must_hold = "bodies must touch by faces, not only along a line or at a point"
        remedy = "move the bodies apart, or let them touch over an area"
        return Problem(where, must_hold, "surfaces that touch without a common area", remedy)
    must_hold = f"bodies must touch or leave a gap of at least {contacts.LEAST_GAP:g} mm"
    remedy = "give both the same coordinate where they touch, or widen the gap"
    return Problem(where, must_hold, f"a gap of {distance:.3g} mm", remedy)


Item = TypeVar("Item", bound=Body | Coil)

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
    """What is allowed but worth knowing about the geometry.

    What the last `check_geometry` of this device saw, if there was one.

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


@dataclass(frozen=True)
class _Findings:
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]


# A solve checks first and states the notes at its end: the solids are built and compared once.
_found_last: WeakKeyDictionary[Device, _Findings] = WeakKeyDictionary()


def _examine(device: Device) -> _Findings:
    label = device_label(device)
    problems: list[Problem] = []
    built_bodies = _built(problems, label, "body", device.bodies, body_solid)
    bodies = [*_sound(problems, label, built_bodies)]
    wound = [coil for coil in device.coils if coil.has_winding]
    windings = [solid for _, solid in _built(problems, label, "winding", wound, winding_solid)]
    overlapping = contacts.overlaps_among(bodies)
    remedy = "move or shorten one, or cut the overlap from it"
    problems += _overlapping(label, overlapping, "bodies may touch but not overlap", remedy)
    if len(bodies) == len(device.bodies) > 0:
        # A missing body might be the one that makes a contact sound, so contacts wait until all are there.
        problems += _contact_problems(label, device, bodies, overlapping)
    remedy = "correct the winding's widths or place, or cut the body"
    cutting = contacts.overlaps_between(windings, bodies)
    problems += _overlapping(label, cutting, "a winding must not cut a body", remedy)
    shared = contacts.overlaps_among(windings)
    must_hold = "windings must not overlap, unless both fill the very same space"
    apart, together = ([one for one in shared if _same_space(one) == alike] for alike in (False, True))
    problems += _overlapping(label, apart, must_hold, "correct the widths or places of the windings")
    problems += _workspace_problems(label, device, [*bodies, *windings])
    return _Findings(tuple(problems), tuple(_notes(device, bodies, together)))


# ---- one solid at a time ----


def _built(
    problems: list[Problem],
    label: str,
    kind: str,
    items: Sequence[Item],
    build: Callable[[Item], occ.TopoDS_Shape],
) -> list[tuple[Item, contacts.NamedSolid]]:
    """The items that can be built, each with its solid; a problem is added for each one that cannot."""
    solids = []
    for item in items:
        try:
            solids.append((item, contacts.NamedSolid(kind, item.name, build(item))))
        except GeometryError as error:
            problems += (
                Problem(f"{label}: {p.where}", p.must_hold, p.received, p.remedy) for p in error.problems
            )
        except kernel_errors() as error:
            problems.append(cannot_build(label, kind, item.name, error))
    return solids


def _sound(
    problems: list[Problem], label: str, built: list[tuple[Body, contacts.NamedSolid]]
) -> Iterator[contacts.NamedSolid]:
    """The bodies that have a volume; a problem is added for each of the others."""
    for body, solid in built:
        problem = _body_fault(label, body, solid)
        if problem is None:
            yield solid
        else:
            problems.append(problem)


def _body_fault(label: str, body: Body, solid: contacts.NamedSolid) -> Problem | None:
    pieces = solid.solid.solids
    size = float(np.linalg.norm(np.subtract(*contacts.bounds(solid.solid)))) if len(pieces) else 0.0
    if solid.volume <= contacts.CONTACT_DISTANCE * size**2:
        remedy = "correct its dimensions and its cuts; in a STEP file, the direction of its surface"
        received = f"{solid.volume:.3g} mm^3"
        return Problem(f"{label}: {solid}", "a body must have a volume above zero", received, remedy)
    if not any(isinstance(part.shape, StepFile) for part in body.parts) or _halves_add_up(solid):
        return None
    received, remedy = (
        "a surface that crosses itself or has holes",
        "repair the STEP file in the program that wrote it",
    )
    return Problem(f"{label}: {solid}", "the surface of a body must enclose it once", received, remedy)


def _halves_add_up(body: contacts.NamedSolid) -> bool:
    """True where both halves of the body, cut through the middle, make up its volume along each axis.

    A surface that crosses itself or is open gives the kernel's cut another volume than its integral does.
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


def _box(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> occ.TopoDS_Shape:
    return occ.Box(occ.Pnt(*map(float, lower)), occ.Pnt(*map(float, upper)))


# ---- solids against each other ----


def _same_space(overlap: contacts.Overlap) -> bool:
    """True where both windings are all overlap: two circuits wound together."""
    windings = (overlap.first, overlap.second)
    return all(abs(winding.volume - overlap.volume) <= SAME_VOLUME * winding.volume for winding in windings)


def _contact_problems(
    label: str, device: Device, bodies: list[contacts.NamedSolid], overlapping: Sequence[contacts.Overlap]
) -> Iterator[Problem]:
    glued = glue_solids(body.solid for body in bodies)
    told = {frozenset((overlap.first.name, overlap.second.name)) for overlap in overlapping}
    for pinch in contacts.pinches(glued):
        yield pinched(label, pinch)
    for first, second, distance in contacts.near_misses(bodies, glued):
        if {first, second} not in told:
            yield nearly_touching(label, first, second, distance)
    own = {body.name: own_mesh(body) for body in device.bodies if body.has_own_mesh}
    areas = contacts.contact_areas(glued) if own or device.joints else {}
    for joint in device.joints:
        if joint.between is not None and not any(joint.holds(*pair) for pair in areas):
            must_hold = "the bodies of a joint must touch over an area"
            remedy = "draw them in contact: the joint opens the gap; a gap that is drawn needs no joint"
            yield Problem(f"{label}: {joint.description}", must_hold, "no such bodies", remedy)
    for (first, second), area in areas.items():
        if (first in own or second in own) and frozenset((first, second)) not in told:
            shared = common_area(own[first], own[second]) if first in own and second in own else 0.0
            if abs(1e6 * shared - area) > _SAME_AREA * area:
                yield Problem(
                    f"{label}: bodies '{first}' and '{second}'",
                    "a body with a mesh of its own touches others by common faces of their meshes only",
                    f"a contact of {area:.6g} mm^2, common faces of {1e6 * shared:.6g} mm^2",
                    "mesh both together, each as a region of one file, or leave a gap",
                )


def _workspace_problems(label: str, device: Device, solids: list[contacts.NamedSolid]) -> Iterator[Problem]:
    if device.workspace is None:
        return
    try:
        workspace = contacts.NamedSolid("workspace", "", workspace_solid(device.workspace))
    except kernel_errors() as error:
        yield cannot_build(label, "workspace", "", error)
        return
    must_hold = "the workspace must be free of bodies and windings"
    found = contacts.overlaps_between([workspace], solids)
    yield from _overlapping(label, found, must_hold, "make the workspace smaller or move it")


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
    sound = {solid.name for solid in bodies}
    for body in device.bodies:
        for part in body.parts:
            if body.name in sound and isinstance(part.shape, StepFile):
                yield from _unit_note(body, part.shape)
        if body.name in sound and body.has_own_mesh and (count := higher_order_cells(body)):
            yield (
                f"body '{body.name}': {count} tetrahedra of its file have more than four nodes; they are taken by"
                " their corners, with straight edges"
            )


def _unit_note(body: Body, step: StepFile) -> Iterator[str]:
    unit = declared_step_unit(step.path)
    if unit is not None and abs(unit - step.scale) > SAME_VOLUME * unit:
        yield (
            f"body '{body.name}': the STEP file {step.path.name} declares a unit of {unit:g} m, the device"
            f" file {step.scale:g} m; the device file's is used"
        )
