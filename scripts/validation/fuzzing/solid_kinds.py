"""Shapes of iron from other programs: triangle surfaces (STL), meshes (VTK, gmsh), solids (STEP)."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np

import fieldmap as fm
from fieldmap.device.mesh_files import read_mesh
from fieldmap.device.surfaces import enclosed_volume, read_stl, surface_fault
from fieldmap.errors import InputError, Problem
from fieldmap.iron.geometry.checks import check_geometry
from fieldmap.iron.geometry.shapes import occ
from fieldmap.iron.geometry.solids import body_solid
from validation.fuzzing.case import Case, Generator, Kind, not_finite
from validation.fuzzing.mutations import bytes_of, characters

# A ball of triangles and of tetrahedra, unit mm.
_RADIUS = 5.0
NUMBERS = (
    b"nan", b"inf", b"1e308", b"-1", b"0", b"1e30", b"1e-300", b"99999999999", b"text", b"$", b"*", b"#1",
)  # fmt: skip


def numbers_of(raw: bytes, rng: Generator) -> tuple[str, bytes]:
    """One to three numbers of a text, or eight bytes of numbers, replaced."""
    done = []
    for _ in range(int(rng.integers(1, 4))):
        at = [k for k in range(len(raw) - 1) if raw[k : k + 1].isdigit() and not raw[k - 1 : k].isdigit()]
        if at and b"\x00" not in raw[:2000]:
            k = at[int(rng.integers(len(at)))]
            end = k
            while end < len(raw) and (raw[end : end + 1].isdigit() or raw[end : end + 1] in (b".", b"e")):
                end += 1
            new = NUMBERS[int(rng.integers(len(NUMBERS)))]
            raw = raw[:k] + new + raw[end:]
            done.append(f"{new!r} at {k}")
        else:
            new = struct.pack("<d", float(rng.choice([np.nan, np.inf, 1e308, -1.0, 0.0, 2.0**62])))
            if rng.random() < 0.6:
                new = struct.pack("<i", int(rng.choice([-1, 2**31 - 1, 0, 1, 10**6, -(2**31)])))
            k = int(rng.integers(0, max(1, len(raw) // 4))) * 4
            raw = raw[:k] + new + raw[k + len(new) :]
            done.append(f"{new!r} at {k}")
    return " and ".join(done), raw


def _mutated(raw: bytes, rng: Generator, number: int) -> tuple[str, bytes]:
    way = number % 3
    if way == 0:
        return bytes_of(raw, rng)
    if way == 1:
        return numbers_of(raw, rng)
    change, text = characters(raw.decode("latin-1"), rng)
    return change, text.encode("latin-1", "replace")


def _ball() -> tuple[Any, Any]:
    """Corners and triangles of an octahedron."""
    points = _RADIUS * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    upper = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]]
    return points, np.array(upper + [[b, a, 5] for a, b, _ in upper])


def surfaces(folder: Path) -> Callable[[Generator, int], Case]:
    """STL files, binary and text. A result must have a volume, and its corners must be numbers of the file."""
    points, triangles = _ball()
    mesh = meshio.Mesh(points, [("triangle", triangles)])
    kinds = []
    for name, binary in (("a.stl", True), ("b.stl", False)):
        meshio.write(folder / name, mesh, binary=binary)
        kinds.append((folder / name).read_bytes())
    path = folder / "input.stl"
    device = folder / "device.toml"
    device.write_text("")

    def read() -> Any:
        corners, index = read_stl(path)
        if not len(index):
            raise InputError(Problem(str(path), "triangles with an area", "none", "write it again"))
        fm.TriangleSurface.from_stl(path)
        return corners, index

    def make(rng: Generator, number: int) -> Case:
        change, raw = _mutated(kinds[int(rng.integers(2))], rng, number)
        path.write_bytes(raw)
        return Case(change, read, lambda found: _fault_of_surface(found, raw))

    return make


def _fault_of_surface(found: Any, raw: bytes) -> str:
    """Compare the corners with the file, read again by the rules of the format, and check the box."""
    points, triangles = found
    if lost := not_finite([points]):
        return f"NaN or infinity in {lost}"
    if triangles.min() < 0 or triangles.max() >= len(points):
        return "numbers of no corners"
    if len(raw) >= 84 and len(raw) == 84 + 50 * struct.unpack("<I", raw[80:84])[0]:
        exact = [struct.unpack("<9f", raw[k + 12 : k + 48]) for k in range(84, len(raw), 50)]
    else:
        words = raw.split()
        numbers = [
            float(w.rstrip(b"\0")) for k, w in enumerate(words) if b"vertex" in words[max(0, k - 3) : k]
        ]
        if len(numbers) % 9:
            return ""
        exact = [tuple(numbers[k : k + 9]) for k in range(0, len(numbers), 9)]
    theirs = np.array(exact).reshape(-1, 3)
    if len(theirs) and not np.allclose(
        [points.min(0), points.max(0)], [theirs.min(0), theirs.max(0)], rtol=1e-6
    ):
        return "another box than that of the corners in the file"
    if surface_fault(points, triangles) is None and not enclosed_volume(points, triangles) > 0:
        return "a solid without volume"
    return ""


def meshes(folder: Path) -> Callable[[Generator, int], Case]:
    """Files of VTK and gmsh with tetrahedra that fill a volume."""
    points = 1.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    tets = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    tags = {"gmsh:physical": [np.array([1, 2])], "gmsh:geometrical": [np.array([1, 2])]}
    kinds = []
    for suffix, kind in (
        (".vtu", "vtu"),
        (".vtk", "vtk"),
        (".msh", "gmsh"),
        (".msh", "gmsh22"),
        (".mesh", "medit"),
    ):
        path = folder / f"{kind}{suffix}"
        data = tags if "gmsh" in kind else {"region": [np.array([1, 2])]} if suffix != ".mesh" else {}
        meshio.write(path, meshio.Mesh(points, [("tetra", tets)], cell_data=data), file_format=kind)
        kinds.append((suffix, path.read_bytes()))
    for suffix, raw in kinds:
        (folder / f"input{suffix}").write_bytes(raw)
        assert len(read_mesh(folder / f"input{suffix}").tets) == 2

    def make(rng: Generator, number: int) -> Case:
        suffix, sound = kinds[int(rng.integers(len(kinds)))]
        change, raw = _mutated(sound, rng, number)
        # Files are cached by name, time and size, so each case has a name of its own.
        path = folder / f"input{number}{suffix}"
        path.write_bytes(raw)

        def read() -> Any:
            try:
                return read_mesh(path)
            finally:
                path.unlink()

        return Case(f"{suffix}: {change}", read, _fault_of_mesh)

    return make


def _fault_of_mesh(found: Any) -> str:
    """Check for finite points, and compare the volume with the determinants of all tetrahedra."""
    if lost := not_finite([found.points]):
        return f"NaN or infinity in {lost}"
    corners = found.points[found.tets]
    size = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return "" if len(found.tets) and (size > 0).all() else "a flat tetrahedron"


def steps(folder: Path) -> Callable[[Generator, int], Case]:
    """STEP files with or without a solid. The reader is Open CASCADE, in C++."""
    box = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(4, 5, 6)) - occ.Cylinder(occ.Pnt(2, 2, 0), occ.Z, r=1, h=6)
    box.WriteStep(str(folder / "sound.step"))
    sound, path = (folder / "sound.step").read_bytes(), folder / "input.step"
    data = sound.index(b"DATA;")

    def read() -> Any:
        body = fm.Body("b", "steel", (fm.Part(fm.StepFile(path, 1e-3)),), mesh_size=1e-3)
        # The check of every solve; the kernel also accepts surfaces that are open or inside out as solids.
        check_geometry(fm.Device.unchecked(name="d", coils=(), bodies=(body,)))
        solid = body_solid(body)
        return [solid.mass, *(list(point) for point in solid.bounding_box)]

    def make(rng: Generator, number: int) -> Case:
        if number % 2:
            change, raw = _mutated(sound[data:], rng, number // 2)
            raw = sound[:data] + raw
        else:
            change, raw = _mutated(sound, rng, number // 2)
        path.write_bytes(raw)
        return Case(change, read, lambda found: _fault_of_solid(found))

    path.write_bytes(sound)
    read()
    return make


def _fault_of_solid(found: Any) -> str:
    """Check for a finite volume that fits into its box."""
    volume, low, high = found
    if not np.isfinite([volume, *low, *high]).all():
        return f"NaN or infinity: {found}"
    return (
        ""
        if 0 < volume <= np.prod(np.subtract(high, low)) * (1 + 1e-6)
        else f"volume {volume} in {low} to {high}"
    )


SURFACES = Kind("surfaces (STL)", surfaces, through_command=0)
MESHES = Kind(
    "meshes (VTK, gmsh, medit)",
    meshes,
    # Binary files of gmsh state a number of values, for which meshio allocates memory before it reads.
    seconds=10.0,
    megabytes=4000.0,
    through_command=0,
    starts_processes=True,
)
STEPS = Kind("solids (STEP)", steps, seconds=5.0, through_command=0, starts_processes=True)
