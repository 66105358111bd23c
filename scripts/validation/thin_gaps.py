"""Thin drawn gaps: a magnet held by a thick plate, against the closed form of a magnet and its image."""

from collections.abc import Iterator
from itertools import product

import magpylib
import numpy as np
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.model import Body, Box, Device, Part, placed
from fieldmap.iron import LinearSolution, SolvedState
from validation.row import Row, timed

SIDE, HEIGHT, REMANENCE, MU_R = 0.02, 0.01, 1.0, 1e4
GAPS = (1e-3, 3e-4, 1e-4, 1e-5, 1e-6)


def image_force(gap: float) -> float:
    """Attraction, N, of the magnet to a plate of infinite permeability: the force between two equal cuboids 2 x gap
    apart (G. Akoun, J.-P. Yonnet, IEEE Trans. Magn. 20 (1984) 1962)."""
    a, c, far = SIDE / 2, HEIGHT / 2, HEIGHT + 2 * gap
    total = 0.0
    for i, j, k, m, p, q in product((0, 1), repeat=6):
        u, v = a * ((-1) ** j - (-1) ** i), a * ((-1) ** m - (-1) ** k)
        w = far + c * ((-1) ** q - (-1) ** p)
        r = np.sqrt(u * u + v * v + w * w)
        term = -u * w * np.log(r - u) - v * w * np.log(r - v) + u * v * np.arctan2(u * v, r * w) - r * w
        total += (-1) ** (i + j + k + m + p + q) * term
    return REMANENCE**2 / (4 * np.pi * mu_0) * abs(total)


def magnet_above_plate(gap: float, size: float = 3e-3, edge: float = 5e-4) -> Device:
    """A magnet of 20 x 20 x 10 mm at a gap above a plate of 120 x 120 x 40 mm, mu_r 10 000."""
    plate = (6 * SIDE, 6 * SIDE, 2 * SIDE)
    bodies = [
        Body("magnet", "magnet", (Part(Box((SIDE, SIDE, HEIGHT)), placed((0, 0, gap))),), size, edge),
        Body("plate", "iron", (Part(Box(plate), placed((0, 0, -2 * SIDE))),), 2 * size),
    ]
    materials = {
        "iron": fm.LinearMaterial("iron", MU_R),
        "magnet": fm.PermanentMagnet("magnet", np.array([0, 0, REMANENCE]), 1.0),
    }
    face = fm.Section("face", np.zeros(3), np.array([0, 0, 1.0]), ("plate",), [SIDE / 2, SIDE / 2, 1e-3])
    return Device("magnet above a plate", "", [], bodies, materials, sections=[face])


def image_flux(gap: float) -> float:
    """Flux, Wb, through the plate's face below the magnet."""
    sides = [
        magpylib.magnet.Cuboid(
            polarization=(0, 0, REMANENCE), dimension=(SIDE, SIDE, HEIGHT), position=(0, 0, z)
        )
        for z in (gap + HEIGHT / 2, -gap - HEIGHT / 2)
    ]
    x, weights = np.polynomial.legendre.leggauss(60)
    grid = np.stack(np.meshgrid(x, x, [0.0], indexing="ij"), axis=-1).reshape(-1, 3) * SIDE / 2
    field = magpylib.Collection(sides).getB(grid)[:, 2]
    return float(np.outer(weights, weights).ravel() @ field) * SIDE**2 / 4


def thin_gaps() -> Iterator[Row]:
    """Holding force and flux from 1 mm to 1 um, and pads of soft iron below the magnet."""
    for gap in GAPS:
        unit, wall, cpu = timed(lambda gap=gap: fm.solve_linear(magnet_above_plate(gap)))
        state, force_wall, force_cpu = timed(lambda unit=unit: _with_force(unit))
        case = f"magnet {1e3 * gap:g} mm above a plate"
        about = (unit.report.surface_faces, unit.report.iterations, wall + force_wall, cpu + force_cpu)
        force = -state.force_on("magnet")[2]
        yield Row(case, "holding force", force / image_force(gap) - 1, 1e-2, "magnet and image", *about)
        flux = state.section_flux("face").flux
        # At 1 mm the gap is not a sheet, and the plate's elements of 6 mm do not resolve the edge of the magnet.
        bound = 2e-2 if gap < 1e-3 else None
        yield Row(
            case, "flux through the plate's face", flux / image_flux(gap) - 1, bound, "magnet and image"
        )
    yield from _pads()


def _with_force(unit: LinearSolution) -> SolvedState:
    state = unit.at([])
    state.force_on("magnet")
    return state


def _pads() -> Iterator[Row]:
    """A pad of soft iron, 2 mm thick, below the magnet, against a finer mesh.

    With elements 2.5 times finer the force rises by another 2 % at 0.01 mm, and by 0.3 % at 0.001 mm.
    """
    for gap in (1e-5, 1e-6):
        device = magnet_above_plate(gap)
        pad = Body("plate", "iron", (Part(Box((SIDE, SIDE, 2e-3)), placed((0, 0, -2e-3))),), 2e-3, 2.5e-4)
        device = device.replace(bodies=(device.bodies[0], pad))
        fine = fm.solve_linear(device, refinement=1.5).at([]).force_on("plate")[2]
        unit, wall, cpu = timed(lambda device=device: fm.solve_linear(device))
        yield Row(
            f"pad {1e3 * gap:g} mm below a magnet",
            "force",
            unit.at([]).force_on("plate")[2] / fine - 1,
            2e-2,
            "elements two thirds as large",
            unit.report.surface_faces,
            unit.report.iterations,
            wall,
            cpu,
        )
