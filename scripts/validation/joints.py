"""Joints compared with the drawn and meshed gap that they replace, and a ring by Ampere's law."""

from collections.abc import Iterator
from unittest.mock import patch

import numpy as np
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.model import Body, Box, Device, ExtrudedPolygon, Part, RevolvedProfile, placed
from fieldmap.iron import SolvedState
from fieldmap.iron.geometry import thin_gaps
from validation.row import Array, Row, timed

WIDTH, THICKNESS, HEIGHT = 0.04, 0.01, 0.03
MU_R = 1000.0


def c_core(gap: float, drawn: bool, size: float, edge: float) -> Device:
    """Two legs on a base and a bar on both, with a gap below the bar: drawn, cut out of the legs, or as a joint."""
    a, w, top = THICKNESS, WIDTH / 2, HEIGHT - (gap if drawn else 0.0)
    outline = [(-w, 0), (w, 0), (w, top), (w - a, top), (w - a, a), (a - w, a), (a - w, top), (-w, top)]
    base = Part(ExtrudedPolygon(np.array(outline), a), placed((0, a / 2, 0), (90, 0, 0)))
    bar = Part(Box((WIDTH, a, a)), placed((0, 0, HEIGHT)))
    bodies = [Body(name, "iron", (part,), size, edge) for name, part in (("base", base), ("bar", bar))]
    coil = fm.CircularCoil("coil", 0.0075, 0.0095, 0.012, 100, placement=placed((a / 2 - w, 0, 0.02)))
    leg = fm.Section(
        "leg", np.array([w - a / 2, 0, 0.015]), np.array([0, 0, 1.0]), ("base",), np.full(3, 0.006)
    )
    joints = () if drawn else (fm.Joint(gap, ("base", "bar")),)
    iron = {"iron": fm.LinearMaterial("iron", MU_R)}
    return Device("core", "", [coil], bodies, iron, sections=[leg], joints=joints)


def joints() -> Iterator[Row]:
    """Flux of the core with a joint against the drawn gap, both in the potential form; and difference of the two forms,
    whose errors have opposite signs."""
    for gap, size, edge in ((0.5e-3, 3e-3, 0.5e-3), (0.5e-3, 2e-3, 0.25e-3), (0.1e-3, 1.5e-3, 0.12e-3)):
        devices = [c_core(gap, drawn, size, edge) for drawn in (False, True)]
        # The drawn gap is meshed as air, not replaced by a sheet as thin gaps usually are.
        with patch.object(thin_gaps, "THIN", 0.0):
            (whole, wall, cpu), (part, _, _) = (
                timed(lambda device=device: fm.solve_linear(device).at([1.0])) for device in devices
            )
        flux, drawn_flux = (state.section_flux("leg").flux for state in (whole, part))
        # At 0.1 mm the drawn gap is less accurate than the joint: elements are as wide as ten gaps.
        bound = 2e-3 if gap > 2e-4 else 4e-3
        yield Row(
            f"C-core, joint of {1e3 * gap:g} mm, elements of {1e3 * size:g} mm",
            "flux against the drawn gap",
            abs(flux / drawn_flux - 1),
            bound,
            "the same gap, meshed",
            whole.report.surface_faces,
            whole.report.iterations,
            wall,
            cpu,
        )
    both = [
        fm.solve_linear(c_core(0.5e-3, False, 2e-3, 0.25e-3), form=form).at([1.0]).section_flux("leg").flux
        for form in ("potential", "flux")
    ]
    yield Row(
        "C-core, joint of 0.5 mm, elements of 2 mm",
        "flux, flux form over potential form",
        both[1] / both[0] - 1,
        1e-2,
        "the forms err to opposite sides",
    )
    yield from _rings()


def ring(gap: float, mu_r: float) -> Device:
    """A ring of square section in two halves, eight coils around it."""
    whole = RevolvedProfile(np.array([[0.03, 0], [0.04, 0], [0.04, 0.01], [0.03, 0.01]]))
    cut = [Part(Box((0.1, 0.05, 0.02)), placed((0, y, -0.005)), "cut") for y in (-0.025, 0.025)]
    halves = [Body(f"half {k}", "iron", (Part(whole), cut[k]), 0.003) for k in range(2)]
    coils = []
    for k, angle in enumerate(2 * np.pi * (np.arange(8) + 0.5) / 8):
        at = placed((0.035 * np.cos(angle), 0.035 * np.sin(angle), 0.005), (-90.0, 0.0, np.degrees(angle)))
        coils.append(fm.CircularCoil(f"coil_{k}", 0.0078, 0.0088, 0.014, 50, placement=at))
    joints = (fm.Joint(gap),) if gap else ()
    return Device("ring", "", coils, halves, {"iron": fm.LinearMaterial("iron", mu_r)}, joints=joints)


def flux_density_inside(state: SolvedState, points: Array) -> Array:
    """B (n, 3) at points in iron and sheets, not the mean of the element."""
    element = state.mesh.containing(points)
    corners = state.mesh.points[state.mesh.tets[element]]
    edges = np.swapaxes(corners[:, :3] - corners[:, 3:], 1, 2)
    three = np.linalg.solve(edges, (points - corners[:, 3])[:, :, None])[:, :, 0]
    barycentric = np.column_stack([three, 1 - three.sum(axis=1)])
    return np.einsum("c,cnd->nd", state.weights, state.iron.flux_density_at(element, barycentric))


def circulation(state: SolvedState, gap: float, mu_r: float) -> tuple[float, float]:
    """Magnetomotive force, A, of the iron and of the gaps along the circle in the middle of the ring."""
    count = 4000
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    circle = np.column_stack([0.035 * np.cos(angle), 0.035 * np.sin(angle), np.full(count, 0.005)])
    along = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(count)])
    inside = np.abs(circle[:, 1]) > 2 * gap
    tangential = np.einsum("nd,nd->n", flux_density_inside(state, circle), along) * inside
    across = flux_density_inside(state, np.array([[0.035, gap / 2, 0.005], [-0.035, gap / 2, 0.005]]))[:, 1]
    iron = tangential.sum() * 0.035 * 2 * np.pi / count / (mu_r * mu_0)
    return float(iron), float((across[0] - across[1]) * gap / mu_0)


def _rings() -> Iterator[Row]:
    for form in ("potential", "flux"):
        for gap in (1e-6, 4e-6, 2e-5):
            unit, wall, cpu = timed(lambda gap=gap, form=form: fm.solve_linear(ring(gap, 1e4), form=form))
            iron, air = circulation(unit.at(np.ones(8)), gap, 1e4)
            yield Row(
                f"ring, mu_r 10000, two joints of {1e6 * gap:g} um, {form} form",
                f"error of the circulation, {air:.0f} of 400 A in the gaps",
                abs((iron + air) / 400 - 1),
                1e-3,
                "Ampere's law",
                unit.report.surface_faces,
                unit.report.iterations,
                wall,
                cpu,
            )
