"""Windings and workspaces: refused ones with the numbers of each problem, and the whole drive unit, which is sound."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import GeometryError, Problem
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes
from fieldmap.iron.geometry.contacts import contact_areas
from fieldmap.iron.geometry.shapes import winding_solid
from fieldmap.iron.geometry.solids import glue_bodies


def at(x: float, y: float, z: float) -> fm.Placement:
    return fm.Placement(np.array([x, y, z]) * 1e-3)


def body(name: str, *parts: fm.Part) -> fm.Body:
    return fm.Body(name, "iron", parts, mesh_size=0.01)


def rod(name: str, radius: float, height: float, x: float, y: float, z: float) -> fm.Body:
    return body(name, fm.Part(fm.Cylinder(radius * 1e-3, height * 1e-3), at(x, y, z)))


def ring_coil(
    name: str, inner: float, outer: float, x: float = 0, y: float = 0, z: float = 0
) -> fm.CircularCoil:
    return fm.CircularCoil(name, inner * 1e-3, outer * 1e-3, 0.039, 840, placement=at(x, y, z))


CORE = rod("core", 10, 40, 0, 0, -20)


def problems(device: fm.Device) -> tuple[Problem, ...]:
    try:
        check_geometry(device)
    except GeometryError as error:
        return error.problems
    return ()


def device(coils=(), bodies=(), workspace=None) -> fm.Device:
    return fm.Device.unchecked(
        name="d", coils=coils, bodies=bodies, workspace=workspace, source=Path("d.toml")
    )


# ---- windings ----


def named(problem):
    """The quoted names in the place of a problem."""
    return re.findall(r"'([^']*)'", problem.where)


def test_a_winding_with_clearance_or_in_contact_is_sound():
    assert problems(device((ring_coil("c", 11, 21),), (CORE,))) == ()
    assert problems(device((ring_coil("c", 10, 21),), (CORE,))) == ()


def test_a_winding_that_cuts_iron_is_named_with_volume_and_place():
    (problem,) = problems(device((ring_coil("c", 9, 21),), (CORE,)))
    assert named(problem) == ["c", "core"]
    volume = np.pi * (10**2 - 9**2) * 39
    assert problem.received.startswith(f"{volume:.4g} mm^3")
    for said in ("x -10 to 10", "z -19.5 to 19.5 mm"):
        assert said in problem.received


def test_windings_that_overlap_are_refused():
    (problem,) = problems(device((ring_coil("1", 11, 21), ring_coil("2", 11, 21, 41))))
    assert named(problem) == ["1", "2"]
    lens = 2 * 21**2 * np.arccos(20.5 / 21) - 20.5 * np.sqrt(42**2 - 41**2)
    assert problem.received.startswith(f"{39 * lens:.4g} mm^3")
    assert problems(device((ring_coil("1", 11, 21), ring_coil("2", 11, 21, 42)))) == ()


def test_windings_in_the_very_same_space_are_allowed_and_noted():
    bifilar = device((ring_coil("1", 11, 21), ring_coil("2", 11, 21)))
    assert problems(bifilar) == ()
    (note,) = geometry_notes(bifilar)
    assert re.findall(r"winding '(\d)'", note) == ["1", "2"]


def test_a_winding_inside_another_is_not_the_same_space():
    (problem,) = problems(device((ring_coil("1", 11, 21), ring_coil("2", 12, 20))))
    assert named(problem) == ["1", "2"]


def test_windings_that_cannot_be_built_are_named():
    found = problems(
        device(
            (
                ring_coil("inside out", 21, 11),
                fm.RoundedRectangleCoil("tight", 0.02, 0.02, 0.004, 0.01, 0.01, 1),
            )
        )
    )
    assert [named(problem) for problem in found] == [["inside out"], ["tight"]]
    assert "inner radius" in found[0].received
    assert re.findall(r"[\d.]+ m", found[1].received) == ["0.004 m", "0.01 m"]


# ---- workspace ----


def test_a_workspace_that_cuts_iron_says_how_deep():
    disk = rod("disk", 66, 6, 0, 0, 0)
    clear = fm.WorkspaceBox(np.array([-0.02, -0.02, -0.11]), np.array([0.02, 0.02, 0.0]))
    assert problems(device(bodies=(disk,), workspace=clear)) == ()
    cutting = fm.WorkspaceBox(clear.lower, np.array([0.02, 0.02, 0.002]))
    (problem,) = problems(device(bodies=(disk,), workspace=cutting))
    assert "workspace" in problem.where
    assert named(problem) == ["disk"]
    for said in ("3200 mm^3", "x -20 to 20", "y -20 to 20", "z 0 to 2 mm"):
        assert said in problem.received


def test_a_workspace_that_holds_a_winding_or_is_empty_is_refused():
    coil = ring_coil("c", 11, 21)
    cylinder = fm.WorkspaceCylinder(np.array([0.0, 0.0, -0.03]), 0.05, 0.06)
    (problem,) = problems(device((coil,), workspace=cylinder))
    assert "workspace" in problem.where
    assert named(problem) == ["c"]
    assert problems(device((coil,), workspace=replace(cylinder, radius=0.011))) == ()
    (problem,) = problems(device((coil,), workspace=replace(cylinder, radius=0.0)))
    assert problem.where == "d.toml: workspace"
    assert "radius = 0.0 m" in problem.received


# ---- the drive unit of thesis Appendix A-3, with the 283 mm gap of thesis 3.1 ----


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> fm.Part:
    size = tuple((upper - lower) * 1e-3 for lower, upper in (x, y, z))
    return fm.Part(fm.Box(size), at(sum(x) / 2, sum(y) / 2, z[0]))


@pytest.fixture(scope="module")
def drive_unit() -> fm.Device:
    angles = np.deg2rad(60.0) * np.arange(6)
    places = [(44 * np.cos(a), 44 * np.sin(a)) for a in angles]
    cores = [rod(f"core {i}", 10, 40, x, y, 6) for i, (x, y) in enumerate(places)]
    w = (-17.5, 17.5)
    yoke = body(
        "yoke",
        box(w, w, (52, 137)),
        box((-182.5, 17.5), w, (137, 172)),
        box((-182.5, -147.5), w, (-304, 137)),
        box((-182.5, 17.5), w, (-339, -304)),
        box(w, w, (-304, -289)),
    )
    bodies = (
        rod("disk", 66, 6, 0, 0, 0),
        *cores,
        rod("centre core", 10, 40, 0, 0, 6),
        rod("upper plate", 66, 6, 0, 0, 46),
        yoke,
        rod("lower plate", 66, 6, 0, 0, -289),
    )
    coils = tuple(
        fm.RoundedRectangleCoil(str(i), 0.016, 0.016, 0.015, 0.010, 0.039, 840, placement=at(x, y, 26))
        for i, (x, y) in enumerate(places)
    )
    return device(
        coils, bodies, fm.WorkspaceBox(np.array([-0.02, -0.02, -0.11]), np.array([0.02, 0.02, -0.07]))
    )


def test_the_drive_unit_is_sound_and_one_magnetic_body(drive_unit):
    assert problems(drive_unit) == ()
    assert geometry_notes(drive_unit) == ()
    names, pairs = {body.name for body in drive_unit.bodies}, contact_areas(glue_bodies(drive_unit))
    reached = {drive_unit.bodies[0].name}
    for _ in names:
        reached |= {name for pair in pairs if reached & set(pair) for name in pair}
    assert reached == names


def test_neighbouring_rounded_square_coils_clear_each_other_by_their_corners(drive_unit):
    # Coils at 0 and 60 deg: dx = 22, dy = 38.1 mm. Corner centres (+-1, +-1) mm, outer radius 20 mm:
    # nearest corner centres are (22 - 2, 38.1 - 2) mm apart.
    first, second = (winding_solid(coil) for coil in drive_unit.coils[:2])
    gap = np.hypot(44 * np.cos(np.pi / 3) - 2, 44 * np.sin(np.pi / 3) - 2) - 2 * 20
    assert gap == pytest.approx(1.274, abs=1e-3)
    assert first.Distance(second) == pytest.approx(gap, rel=1e-9)


def test_windings_of_the_drive_unit_made_too_wide_are_all_named(drive_unit):
    # With two millimetres more outside and inside, every coil cuts its core and both its neighbours.
    wide = tuple(replace(coil, thickness=0.014) for coil in drive_unit.coils)
    found = [problem.where for problem in problems(device(wide, drive_unit.bodies))]
    assert sum("body 'core" in where for where in found) == 6
    assert sum("winding '" in where.split(" and ")[1] for where in found) == 6
    assert len(found) == 12
