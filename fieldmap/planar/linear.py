"""A planar device with iron of constant permeability, solved for one ampere in every coil."""

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from fieldmap.arguments import check_positive
from fieldmap.errors import InputError
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.planar.boundary_operator import BoundaryOperator, boundary_operator
from fieldmap.planar.conductors import coil_derivatives, coil_vector_potential, complex_points
from fieldmap.planar.geometry import check_planar_geometry
from fieldmap.planar.mesh import Outline, make_outline
from fieldmap.planar.model import PlanarCoil, PlanarDevice
from fieldmap.planar.solution import PlanarReport, PlanarSolution, Region
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]
_POINTS = 8
_BARRIER_MU_R = 1e-9
"""Relative permeability of a flux barrier, in place of 0; the field that it lets in is this small."""
_PANELS_ACROSS = 60.0


def solve_planar(
    device: PlanarDevice, size: float | None = None, mu_r: float | None = None
) -> PlanarSolution:
    """Solve a planar device with linear iron, once per coil.

    Method: docs/theory/planar.md.

    Parameters
    ----------
    device
        The device.
    size
        Longest panel of iron and walls, m; a sixtieth of the device's extent unless given.
    mu_r
        Relative permeability of all soft iron. None: the file's own, and the initial one of saturating
        materials.

    Returns
    -------
    PlanarSolution
        The solution.

    Raises
    ------
    GeometryError
        Where bodies, wires and walls do not fit together.
    InputError
        For arguments out of range, and for permanent magnets.

    Examples
    --------
    >>> from fieldmap.planar import read_planar_device, solve_planar
    >>> unit = solve_planar(read_planar_device("planar_drive_unit"))
    >>> gradient = unit.gradient([[0.0, -0.1]], [1000.0, 1000.0])
    >>> print(f"{1e3 * abs(gradient[0, 1, 1]):.2f} mT/m")
    2.04 mT/m
    """
    started = time.process_time()
    check_planar_geometry(device)
    permeability, notes = permeabilities(device, mu_r)
    outline = make_outline(device, panel_size(device, size))
    bodies = [boundary_operator(outline.nodes, body, outline.extent, False) for body in outline.bodies]
    air = air_operator(outline)
    # The reaction at the walls, per ampere, cancels the vector potential of the coils.
    columns = [-coil_vector_potential(coil, outline.wall, outline.extent) for coil in device.coils]
    wall_values = np.array(columns).reshape(len(device.coils), len(outline.wall)).T
    values = _reaction(device, outline, bodies, air, permeability, wall_values)
    report = planar_report(device, outline, len(outline.nodes), started, notes)
    regions = tuple(
        Region(complex_points(body.corners), operator, values)
        for body, operator in zip(device.bodies, bodies, strict=True)
    )
    return PlanarSolution(device, regions, Region(None, air, np.vstack([values, wall_values])), report)


def panel_size(device: PlanarDevice, size: float | None) -> float:
    """Longest panel, m: the given size, or the default."""
    if size is not None:
        check_positive("solve_planar", size=size)
        return float(size)
    corners = [body.corners for body in device.bodies] + ([] if device.walls is None else [device.walls])
    return float(np.ptp(np.concatenate(corners), axis=0).max()) / _PANELS_ACROSS if corners else 1.0


def permeabilities(device: PlanarDevice, mu_r: float | None) -> tuple[Array, tuple[str, ...]]:
    """Relative permeability of each body, and the assumptions about it, one sentence each."""
    if mu_r is not None:
        check_positive("solve_planar", mu_r=mu_r)
    used, notes = [], set()
    for body in device.bodies:
        material = device.materials[body.material]
        if material.role == "magnet":
            where = f"solve_planar, material {material.name}"
            remedy = "use soft iron, or the three-dimensional model"
            must_hold = "permanent magnets have no place in the planar model"
            raise InputError.of(where, must_hold, "a permanent magnet", remedy)
        if material.role == "flux barrier":
            used.append(_BARRIER_MU_R)
            notes.add(f"{body.name}: no flux passes it")
        else:
            used.append(material.initial_mu_r if mu_r is None else float(mu_r))
            notes.add(f"iron of {body.name}: constant relative permeability {used[-1]:g}")
    return np.array(used), tuple(sorted(notes))


def planar_report(
    device: PlanarDevice,
    outline: Outline,
    unknowns: int,
    started: float,
    notes: Sequence[str],
    residuals: tuple[float, ...] = (),
) -> PlanarReport:
    """The report of a solution. started: process time at the start, s; notes: assumptions about the iron."""
    panels, boundary = sum(len(body) for body in outline.bodies), "open space"
    if device.walls is not None:
        (x1, z1), (x2, z2) = 1e3 * device.walls.min(axis=0), 1e3 * device.walls.max(axis=0)
        boundary = f"no flux through walls that reach from ({x1:g}, {z1:g}) to ({x2:g}, {z2:g}) mm in x, z"
    seconds = time.process_time() - started
    return PlanarReport(panels, len(outline.wall), unknowns, seconds, (*notes, boundary), residuals)


def air_operator(outline: Outline) -> BoundaryOperator:
    """The operator of the air; its nodes are the iron's, then the walls'."""
    ring = len(outline.nodes) + np.arange(len(outline.wall))
    wall = np.column_stack([ring, np.roll(ring, -1)])
    nodes = np.concatenate([outline.nodes, outline.wall])
    panels = np.concatenate([outline.outside, wall]).astype(np.int64)
    return boundary_operator(nodes, panels, outline.extent, unbounded=not len(outline.wall))


def _reaction(
    device: PlanarDevice,
    outline: Outline,
    bodies: list[BoundaryOperator],
    air: BoundaryOperator,
    permeability: Array,
    wall_values: Array,
) -> Array:
    """Vector potential (nodes, coils) of the reaction at the iron's nodes, per ampere: docs/theory/planar.md (16)."""
    count = len(outline.nodes)
    right = -air.energy[:count, count:] @ wall_values
    matrix = air.energy[:count, :count].copy()
    for operator, mu_r in zip(bodies, permeability, strict=True):
        matrix += operator.energy / mu_r
        for k, coil in enumerate(device.coils):
            right[:, k] += (1 - 1 / mu_r) * normal_moments(outline.nodes, operator.panels, coil)
    if not count:
        return right
    if not len(outline.wall):
        # In open space the potential is known up to a constant: take the one whose mean is zero.
        matrix += np.full_like(matrix, np.trace(matrix) / count**2)
    return cho_solve(cho_factor(matrix), right)


def normal_moments(nodes: Complex, panels: Indices, coil: PlanarCoil) -> Array:
    """Integrals (n,) of dA/dn of a coil times each node's hat function, n to the right of the panels; Gauss points."""
    start = gauss_start(_POINTS)
    places = 0.5 * (1 + GAUSS_NODES[start : start + _POINTS])
    weights = 0.5 * GAUSS_WEIGHTS[start : start + _POINTS]
    first, last = nodes[panels[:, 0]], nodes[panels[:, 1]]
    points = first[:, None] + places * (last - first)[:, None]
    slope = coil_derivatives(coil, points.ravel())[0].reshape(points.shape)
    normal = (slope * (-1j * (last - first))[:, None]).real
    moments = np.zeros(len(nodes))
    np.add.at(moments, panels[:, 0], (normal * (1 - places)) @ weights)
    np.add.at(moments, panels[:, 1], (normal * places) @ weights)
    return moments
