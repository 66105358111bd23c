"""The public door: a planar device with saturating iron at given currents, by Newton's method."""

import time

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import law_tables
from fieldmap.planar.conductors import coil_vector_potential
from fieldmap.planar.geometry_checks import check_planar_geometry
from fieldmap.planar.iron_energy import IronTriangles, iron_triangles
from fieldmap.planar.linear import air_operator, normal_moments, panel_size, walls_in_words
from fieldmap.planar.model import PlanarDevice
from fieldmap.planar.newton import Balance, minimise
from fieldmap.planar.outline import Outline, make_outline
from fieldmap.planar.solution import PlanarReport, checked_currents
from fieldmap.planar.state import PlanarState
from fieldmap.typing import Array

# Gentler than the linear model's: triangles have to follow it.
_GRADING = 2


def solve_planar_state(
    device: PlanarDevice, currents: ArrayLike, size: float | None = None, tolerance: float = 1e-9
) -> PlanarState:
    """Solve a planar device whose iron saturates, at these currents (n_coils,) in A.

    size: longest panel of iron and walls, and largest triangle inside the iron, m; None: a sixtieth of the device's
    extent. tolerance: of the residual, relative to that of a field without iron's response. Only the iron is filled
    with triangles, of first order; the air is exact. Method: docs/theory/planar.md. Raises GeometryError where parts
    do not fit together or the iron is thinner than its panels are long, InputError for bad arguments and for flux
    barriers or magnets, NotConverged with the residuals.

    >>> from fieldmap.planar import read_planar_device, solve_planar_state
    >>> state = solve_planar_state(read_planar_device("planar_drive_unit"), [1000.0, 1000.0], size=0.02)
    >>> print(f"{1e3 * state.gradient([[0.0, -0.1]])[0, 1, 1]:.1f} mT/m")
    2.0 mT/m
    """
    started = time.process_time()
    check_planar_geometry(device)
    _check_materials(device)
    amperes = checked_currents(device, currents)
    length = panel_size(device, size)
    outline = make_outline(device, length, _GRADING)
    iron = iron_triangles(outline, law_tables([device.materials[b.material] for b in device.bodies]), length)
    balance = _balance(device, outline, iron, amperes)
    potential, residuals = minimise(balance, tolerance)
    report = PlanarReport(
        iron_panels=sum(len(body) for body in outline.bodies),
        wall_panels=len(outline.wall),
        unknowns=len(iron.points),
        seconds=time.process_time() - started,
        assumptions=(*_material_words(device), walls_in_words(device)),
        residuals=residuals,
    )
    reaction = np.concatenate([potential[: len(outline.nodes)] - balance.coil, balance.wall])
    return PlanarState(device, amperes, balance.air, reaction, iron, potential, report)


def _check_materials(device: PlanarDevice) -> None:
    for body in device.bodies:
        if device.materials[body.material].role != "iron":
            raise InputError(
                Problem(
                    f"solve_planar_state, body {body.name}",
                    "must be soft iron",
                    f"material {body.material}",
                    "use solve_planar, or walls in the place of flux barriers",
                )
            )
    if not device.bodies:
        raise InputError(
            Problem("solve_planar_state", "a device with iron", "none", "use solve_planar for coils alone")
        )


def _material_words(device: PlanarDevice) -> tuple[str, ...]:
    words = set()
    for body in device.bodies:
        material = device.materials[body.material]
        constant = f"constant relative permeability {material.initial_mu_r:g}"
        law = material.description if material.saturates else constant
        words.add(f"iron of {body.name}: {law}")
    return tuple(sorted(words))


def _balance(device: PlanarDevice, outline: Outline, iron: IronTriangles, amperes: Array) -> Balance:
    """Everything that does not change with the iron's state, at these currents."""
    count = len(outline.nodes)
    air = air_operator(outline)
    coil, wall, load = np.zeros(count), np.zeros(len(outline.wall)), np.zeros(count)
    for ampere, conductor in zip(amperes, device.coils, strict=True):
        coil += ampere * coil_vector_potential(conductor, outline.nodes, outline.extent)
        wall -= ampere * coil_vector_potential(conductor, outline.wall, outline.extent)
        for panels in outline.bodies:
            load -= ampere * normal_moments(outline.nodes, panels, conductor)
    stiffness = air.energy[:count, :count].copy()
    if not len(outline.wall):
        # In open space the potential is known up to a constant: take the reaction whose mean is zero.
        stiffness += np.trace(stiffness) / count**2
    load += air.energy[:count, count:] @ wall
    return Balance(iron, air, stiffness, load, coil, wall)
