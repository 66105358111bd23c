"""Tetrahedra of mesh files: pyvista reads VTK files; meshio reads those of gmsh and all others. Both are extras."""

from __future__ import annotations

import contextlib
import functools
import io
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.device.another_process import read_by_another
from fieldmap.device.tetrahedra import tetrahedra_fault
from fieldmap.errors import FieldmapError, InputError, Problem
from fieldmap.extras import needs, require
from fieldmap.records import Record
from fieldmap.typing import Array, Index

_VTK = (".vtu", ".vtk")
_SOLID_CELLS = ("tetra", "hexa", "wedge", "pyramid", "penta", "polyhedron", "voxel")
# Names that programs give to the region numbers of cells; the first one that a file has is used.
_TAGS = ("gmsh:physical", "body", "region", "medit:ref", "cell_tags", "gmsh:geometrical", "CellEntityIds")


# A trial read in another process, for VTK files only: meshio is Python and cannot crash the process.
_TRIAL = """
# VTK loads it where it finds it, in half of the time that this takes, and reads without it.
sys.modules["numpy"] = None
from vtkmodules.vtkIOLegacy import vtkDataSetReader
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader
limit()
reader = vtkXMLUnstructuredGridReader() if path.endswith(".vtu") else vtkDataSetReader()
reader.SetFileName(path)
reader.Update()
grid = reader.GetOutput()
for k in range(grid.GetNumberOfCells() if grid else 0):
    grid.GetCell(k)
"""


@dataclass(frozen=True, eq=False, repr=False)
class FileMesh(Record):
    """points (n, 3) in the file's unit, tets (m, 4); higher_order: number of tetrahedra with more than four nodes."""

    points: Array
    tets: Index
    higher_order: int


@dataclass(frozen=True, eq=False)
class _Cells:
    """All tetrahedra of a file: tets (m, 4); regions: numbers of the tetrahedra of each region, by its name or number;
    others: counts and kinds of other solid cells."""

    points: Array
    tets: Index
    higher_order: Index
    regions: Mapping[str, Index]
    others: tuple[str, ...]


def read_mesh(path: Path, region: str | None = None) -> FileMesh:
    """The tetrahedra of a mesh file, or those of one region of it: a gmsh group, a set of cells, or a number.

    Coincident nodes are merged; unused nodes, lines and surfaces are left out; tetrahedra with more than four nodes are
    reduced to their corners. Raises InputError for a file that cannot be read, has other solid cells, has no
    tetrahedra, lacks the region, or fills no solid, and FieldmapError if the library that reads it is missing.
    """
    try:
        about = path.stat()
    except OSError as error:
        problem = Problem(str(path), "must be a file that can be read", str(error.strerror), "check the path")
        raise InputError(problem) from error
    return _read_mesh(path.resolve(), region, about.st_mtime_ns, about.st_size)


@functools.lru_cache(maxsize=8)
def _read_mesh(path: Path, region: str | None, changed: int, size: int) -> FileMesh:
    cells = _cells(path, changed, size)
    if cells.others:
        remedy = "mesh the solid with tetrahedra, or cut these cells into tetrahedra"
        raise InputError.of(str(path), "must have tetrahedra only", ", ".join(cells.others), remedy)
    chosen = np.arange(len(cells.tets))
    if region is not None:
        if region not in cells.regions:
            names = ", ".join(cells.regions) or "none"
            must_hold = f"region must be one of those of the file: {names}"
            remedy = "name one of them, or leave the key out for all cells"
            raise InputError.of(str(path), must_hold, repr(region), remedy)
        chosen = cells.regions[region]
    points, tets = _used(cells.points, cells.tets[chosen])
    fault = tetrahedra_fault(points, tets)
    if fault is not None:
        raise InputError.of(str(path), *fault)
    for array in (points, tets):
        array.setflags(write=False)
    return FileMesh(points, tets, int(cells.higher_order[chosen].sum()))


def _used(points: Array, tets: Index) -> tuple[Array, Index]:
    """The points of these tetrahedra in the order of the file, coincident ones merged, and the new tetrahedra."""
    if not len(tets) or tets.min() < 0 or tets.max() >= len(points):
        return points, tets
    numbers, places = np.unique(tets, return_inverse=True)
    _, first, same = np.unique(points[numbers] + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return points[numbers][first[order]], rank[same.ravel()][places.ravel()].reshape(-1, 4)


@functools.lru_cache(maxsize=2)
def _cells(path: Path, changed: int, size: int) -> _Cells:
    with _silence() as printed:
        try:
            if path.suffix not in _VTK:
                return _of_meshio(path)
            read_by_another(path, _TRIAL)
            return _of_vtk(path)
        except FieldmapError:
            raise
        # Readers fail with any exception, such as KeyError or struct.error; meshio prints its reason and exits.
        except (Exception, SystemExit) as error:
            reason = printed.getvalue() if isinstance(error, SystemExit) else str(error)
            kind = "" if isinstance(error, SystemExit) else type(error).__name__
            told = ": ".join(filter(None, (kind, " ".join(reason.split())[:120])))
            received = f"{size} bytes, of which the reader says {told!r}"
            remedy = "write it again, for instance as .vtu or as gmsh's .msh 4.1"
            raise InputError.of(str(path), "must be a whole mesh file", received, remedy) from error


# ---- readers ----


@contextlib.contextmanager
def _silence() -> Iterator[io.StringIO]:
    """Capture the output of readers, for the error."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield printed


def _of_meshio(path: Path) -> _Cells:
    meshio = require("meshio", "mesh", str(path))
    mesh = meshio.read(path)
    blocks = [(kind, np.asarray(data)) for kind, data in ((one.type, one.data) for one in mesh.cells)]
    solid = [k for k, (kind, _) in enumerate(blocks) if kind.startswith("tetra")]
    sizes = [len(blocks[k][1]) for k in solid]
    starts = dict(zip(solid, np.concatenate([[0], np.cumsum(sizes)]).tolist(), strict=False))
    data = {
        name: _numbers([values[k] for k in solid])
        for name, values in mesh.cell_data.items()
        if len(values) == len(blocks)
    }
    regions = dict(_numbered(data))
    tags = data.get("gmsh:physical")
    for name, about in mesh.field_data.items():
        number, dimension = (*np.ravel(about).tolist(), None, None)[:2]
        if dimension == 3 and tags is not None:
            regions[str(name)] = np.flatnonzero(tags == number)
    for name, members in mesh.cell_sets.items():
        found = [
            starts[k] + np.asarray(members[k], np.int64).ravel() for k in solid if members[k] is not None
        ]
        if not str(name).startswith("gmsh:") and any(len(one) for one in found):
            regions[str(name)] = np.concatenate(found)
    tets = [blocks[k][1] for k in solid]
    others = [(kind, len(cells)) for kind, cells in blocks if kind.startswith(_SOLID_CELLS[1:])]
    return _gathered(np.asarray(mesh.points, np.float64), tets, regions, others)


def _of_vtk(path: Path) -> _Cells:
    with needs("plot", str(path)):
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger

    complaints, loudness = [], vtkLogger.GetCurrentVerbosityCutoff()
    try:
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
        reader = pyvista.get_reader(path)
        for event in ("ErrorEvent", "WarningEvent"):
            reader.reader.AddObserver(event, lambda *_: complaints.append(True))
        grid = reader.read()
    finally:
        vtkLogger.SetStderrVerbosity(loudness)
    if complaints:
        raise ValueError("damaged or incomplete")
    if not isinstance(grid, pyvista.UnstructuredGrid):
        raise ValueError(f"a {type(grid).__name__} in the place of an unstructured grid")
    kinds = np.asarray(grid.celltypes)
    names = {int(kind): pyvista.CellType(int(kind)).name.lower() for kind in np.unique(kinds)}
    linear, quadratic = int(pyvista.CellType.TETRA), int(pyvista.CellType.QUADRATIC_TETRA)
    cells = {int(kind): rows for kind, rows in grid.cells_dict.items()}
    tets = [cells[kind] for kind in (linear, quadratic) if kind in cells]
    order = np.concatenate([np.flatnonzero(kinds == kind) for kind in (linear, quadratic)])
    data = {
        str(name): _numbers([np.asarray(values)[order]])
        for name, values in grid.cell_data.items()
        if np.asarray(values).dtype.kind in "iuf"
    }
    regions = dict(_numbered(data))
    for label in grid.field_data:
        name, _, region = label.partition(" ")
        tags, numbers = data.get(name), np.ravel(grid.field_data[label])
        if region and tags is not None and numbers.size == 1:
            regions[region] = np.flatnonzero(tags == numbers[0])
    others = [
        (name, int((kinds == kind).sum()))
        for kind, name in names.items()
        if kind not in (linear, quadratic) and any(word in name for word in _SOLID_CELLS)
    ]
    return _gathered(np.asarray(grid.points, np.float64), tets, regions, others)


def _numbers(blocks: list[Any]) -> Index | None:
    """Cell data of all tetrahedra as whole numbers; None for vectors and for other numbers."""
    values = (
        np.concatenate([np.zeros(0), *map(np.asarray, blocks)]) if all(b.ndim == 1 for b in blocks) else None
    )
    if values is None or not np.isfinite(values).all() or (values != np.round(values)).any():
        return None
    return values.astype(np.int64)


def _numbered(data: Mapping[str, Index | None]) -> Iterator[tuple[str, Index]]:
    tags = next((data[name] for name in _TAGS if data.get(name) is not None), None)
    for number in [] if tags is None else np.unique(tags).tolist():
        yield str(number), np.flatnonzero(tags == number)


def _gathered(
    points: Array, tets: list[Any], regions: Mapping[str, Index], others: list[tuple[str, int]]
) -> _Cells:
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points of {points.shape[-1]} coordinates")
    corners = [np.asarray(one[:, :4], np.int64) for one in tets]
    higher = [np.full(len(one), int(one.shape[1] > 4)) for one in tets]
    return _Cells(
        points,
        np.concatenate([np.zeros((0, 4), np.int64), *corners]),
        np.concatenate([np.zeros(0, np.int64), *higher]),
        regions,
        tuple(f"{count} {kind}" for kind, count in others),
    )
