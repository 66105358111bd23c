"""Faults of a device's geometry in words: where, what must hold, what was received (mm, mm^3), the remedy."""

import numpy as np

from fieldmap.errors import Problem
from fieldmap.iron.cad.contacts import LEAST_GAP, NearMiss, Pinch
from fieldmap.iron.cad.overlaps import NamedSolid, Overlap


def no_volume(label: str, body: NamedSolid) -> Problem:
    """A body that the cuts have used up, or whose surface points inwards."""
    return Problem(
        f"{label}: {body}",
        "a body must have a volume above zero",
        f"{body.volume:.3g} mm^3",
        "correct its dimensions and what is cut from it; in a STEP file, the direction of its surface",
    )


def open_surface(label: str, body: NamedSolid) -> Problem:
    """A body whose surface is not the boundary of a volume."""
    return Problem(
        f"{label}: {body}",
        "the surface of a body must enclose it once",
        "a surface that crosses itself or has holes",
        "repair the STEP file in the program that wrote it",
    )


def cannot_build(label: str, kind: str, name: str, error: Exception) -> Problem:
    """A winding or workspace whose numbers make no solid."""
    return Problem(
        f"{label}: {kind} '{name}'" if name else f"{label}: {kind}",
        f"the {kind} must be a solid that the CAD kernel can build",
        str(error).strip() or type(error).__name__,
        "correct its dimensions",
    )


def workspace_occupied(label: str, overlap: Overlap) -> Problem:
    """A workspace that reaches into a body or a winding."""
    must_hold = "the workspace must be free of bodies and windings"
    return _overlapping(label, overlap, must_hold, "make the workspace smaller or move it")


def bodies_overlap(label: str, overlap: Overlap) -> Problem:
    """Two bodies in one place."""
    remedy = "move or shorten one, or cut the overlap from it"
    return _overlapping(label, overlap, "bodies may touch but not overlap", remedy)


def winding_cuts_body(label: str, overlap: Overlap) -> Problem:
    """A winding in the place of iron."""
    remedy = "correct the winding's widths or place, or cut the body"
    return _overlapping(label, overlap, "a winding must not cut a body", remedy)


def windings_overlap(label: str, overlap: Overlap) -> Problem:
    """Two windings that share a part of their space."""
    must_hold = "windings must not overlap, unless both fill the very same space"
    return _overlapping(label, overlap, must_hold, "correct the widths or places of the windings")


def _overlapping(label: str, overlap: Overlap, must_hold: str, remedy: str) -> Problem:
    return Problem(f"{label}: {overlap.first} and {overlap.second}", must_hold, str(overlap), remedy)


def pinched(label: str, pinch: Pinch) -> Problem:
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


def nearly_touching(label: str, miss: NearMiss) -> Problem:
    """Bodies that touch without a common area, or all but touch."""
    where = f"{label}: bodies '{miss.first}' and '{miss.second}'"
    if miss.distance == 0.0:
        return Problem(
            where,
            "bodies must touch by faces, not only along a line or at a point",
            "surfaces that touch without a common area",
            "move the bodies apart, or let them touch over an area",
        )
    return Problem(
        where,
        f"bodies must touch or leave a gap of at least {LEAST_GAP:g} mm",
        f"a gap of {miss.distance:.3g} mm",
        "give both the same coordinate where they touch, or widen the gap",
    )
