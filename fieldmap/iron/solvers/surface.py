"""A device with linear iron, solved by the surfaces of its bodies alone."""

import numpy as np

from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.elements.surface_form import SurfaceForm, regions_of
from fieldmap.iron.geometry.checks import geometry_notes
from fieldmap.iron.materials import BodyProperties
from fieldmap.iron.mesh.surface_mesh import IronSurface, generate_surface
from fieldmap.iron.operators.assembled import memory_bytes
from fieldmap.iron.report import SolverReport, Stages
from fieldmap.iron.surface_solution import SurfaceSolution, iron_linkages, region_field
from fieldmap.sources import unit_flux_densities
from fieldmap.typing import Array

# W with its factor in single precision, K, half as large as W, and D and its factor, a quarter each; and as much for
# the inside of several bodies.
_BYTES_PER_PAIR = 30


def solve_by_surface(
    device: Device, properties: BodyProperties, tolerance: float, refinement: float, stages: Stages
) -> SurfaceSolution:
    """The surface form on the mesh of a sound device with iron and sources; see `fieldmap.solve_linear`. tolerance: of
    the residual. Raises NotConverged."""
    stages.next("meshing the surface", 0.02)
    surface = generate_surface(device, refinement)
    _require_memory(surface, device)
    stages.next("operators of the surface", 0.1)
    form = SurfaceForm(surface, regions_of(surface, properties.mu_r, properties.remanence))
    stages.next("coil fields and solution", 0.7)
    has_remanence = bool(properties.remanence.any())
    background = device.background
    has_constant = has_remanence or background is not None

    def applied(x: Array) -> Array:
        """Of all columns: one ampere in each coil, and what no current drives."""
        b = unit_flux_densities(device.coils, x)
        if not has_constant:
            return b
        constant = np.zeros(x.shape) if background is None else background.field(x)
        return np.concatenate([b, constant[None]])

    coils = len(device.coils)
    magnets = np.zeros(coils + has_constant)
    magnets[coils:] = 1.0
    solved = form.solve(applied, magnets, tolerance)
    faces = solved.outside.surface.faces
    density = np.ascontiguousarray((solved.charges / faces.areas[:, None]).T)
    state = IronState(faces, density, np.zeros((len(density), 0, 3)), len(solved.residuals), solved.residuals)
    regions = tuple(
        region_field(surface, solved, of, np.outer(magnets, of.region.remanence)) for of in solved.regions
    )
    linkage = iron_linkages(solved, coils)
    stages.done()
    report = _report(device, surface, form, solved.residuals, stages, properties)
    about = (device.sections, device.bounds, device.background)
    solution = (device.coils, None, state, has_remanence, report, linkage, *about)
    return SurfaceSolution(*solution, surface=surface, regions=regions)


def _report(
    device: Device,
    surface: IronSurface,
    form: SurfaceForm,
    residuals: tuple[float, ...],
    stages: Stages,
    properties: BodyProperties,
) -> SolverReport:
    faces = len(form.outside.surface.triangles)
    return SolverReport(
        form=form.name,
        tetrahedra=0,
        surface_faces=faces,
        charged_faces=faces,
        unknowns=form.unknowns,
        magnetic_bodies=int(surface.pieces.max()) + 1,
        iterations=len(residuals),
        residual=residuals[-1],
        matrix_bytes=_BYTES_PER_PAIR * len(surface.triangles) ** 2,
        seconds=stages.seconds,
        assumptions=properties.assumptions + geometry_notes(device),
        storage="dense",
    )


def _require_memory(surface: IronSurface, device: Device) -> None:
    have, needed = memory_bytes(), _BYTES_PER_PAIR * len(surface.triangles) ** 2
    if have is None or needed < have:
        return
    received = f"{len(surface.triangles)} triangles, {needed / 1e9:.1f} GB"
    must_hold = f"the dense matrices of the surface form must fit into {have / 1e9:.1f} GB of memory"
    remedy = 'use a smaller refinement, larger mesh sizes, or form="auto"'
    raise InputError(Problem(f"surface mesh of {device.name}", must_hold, received, remedy))
