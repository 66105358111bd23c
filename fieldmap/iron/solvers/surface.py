"""A device with linear iron, solved on the surfaces of its bodies alone, and its solution without a mesh of the volume.

Outside, charges on the surface make the field, as in the other forms. Inside a region of one material another layer of
charges on the region's boundary makes the total potential and field: no large fields cancel, and B is mu_r times this
field. If the iron links the currents of a source, its total potential has no single value; then the second layer makes
the iron's own field, to which the source's field is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fieldmap.constants import MU0
from fieldmap.device.model import Background, Coil, Device, Section
from fieldmap.device.surfaces import enclosed_volume
from fieldmap.errors import InputError
from fieldmap.field import Currents
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.elements.surface_form import RegionPotential, SurfaceForm, SurfacePotential, regions_of
from fieldmap.iron.geometry.checks import geometry_notes
from fieldmap.iron.materials import BodyProperties
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.surface_mesh import IronSurface, generate_surface
from fieldmap.iron.operators.assembled import require_memory
from fieldmap.iron.report import SolverReport, Stages
from fieldmap.iron.sections import SNAP, SectionFlux, areas_above, check_section, named_section, no_iron_at
from fieldmap.iron.solution import FluxDensitySamples, LinearSolution, LinearState
from fieldmap.iron.topology import area_vectors
from fieldmap.records import Record
from fieldmap.sources import unit_flux_densities
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class RegionField(Record):
    """The field inside one region of constant permeability, of several sources (columns c).

    solids (k,): its solids in the mesh; remanence (c, 3) in T; faces: its boundary; triangles (n,): their numbers in
    the mesh, and turned (n,): -1 where the normal of the mesh enters the region; strength (c, n, 3): mu0 H in T just
    inside; density (c, n) in T: charges whose field inside is mu0 H, or the iron's part of it where `linked` (c,).
    """

    solids: Index
    mu_r: float
    remanence: Array
    faces: ChargedFaces
    triangles: Index
    turned: Array
    strength: Array
    density: Array
    linked: NDArray[np.bool_]

    @property
    def flux_density(self) -> Array:
        """B (c, n, 3) in T just inside the boundary."""
        return self.mu_r * self.strength + self.remanence[:, None]


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSolution(LinearSolution):
    """Linear iron of the surface form: everything that `LinearSolution` has, but for flux through sections that are
    limited by half widths. `mesh` is None; surface: the triangles; regions: the field inside."""

    surface: IronSurface = field(kw_only=True)
    regions: tuple[RegionField, ...] = field(kw_only=True)

    @property
    def _state_type(self) -> type[LinearState]:
        return SurfaceState

    @property
    def _bodies(self) -> IronSurface:
        return self.surface

    def flux_density_samples(self, currents: Currents) -> FluxDensitySamples:
        """|B| just inside every triangle at these currents, weighted by area."""
        weights = self.at(currents).weights
        size, area, body = [], [], []
        for region in self.regions:
            size.append(np.linalg.norm(np.tensordot(weights, region.flux_density, 1), axis=1))
            area.append(region.faces.areas)
            own = self.surface.sides[region.triangles]
            body.append(self.surface.body[np.where(region.turned > 0, own[:, 0], own[:, 1])])
        return FluxDensitySamples(
            np.concatenate(size), np.concatenate(area), np.concatenate(body), self.surface.body_names
        )


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceState(LinearState):
    """A solution of the surface form at currents (c,) in A."""

    solution: SurfaceSolution

    @property
    def _bodies(self) -> IronSurface:
        return self.solution.surface

    def _inside(self, x: Array, within: Index) -> Array:
        return self._of_regions(x, within, 0.0)

    def _polarised(self, x: Array, within: Index) -> Array:
        return self._of_regions(x, within, 1.0)

    def _of_regions(self, x: Array, within: Index, less: float) -> Array:
        """(mu_r - less) mu0 H and the remanence (n, 3) at points inside these solids."""
        values = np.zeros(x.shape)
        for region in self.solution.regions:
            mine = np.flatnonzero(np.isin(within, region.solids))
            if len(mine):
                own = (region.mu_r - less) * self._strength(region, x[mine])
                values[mine] = own + self.weights @ region.remanence
        return values

    def _strength(self, region: RegionField, x: Array) -> Array:
        """mu0 H (n, 3) at points (n, 3) of a region."""
        h = region.faces.field(x, np.ascontiguousarray((self.weights @ region.density)[None]))[0]
        if region.linked.any():
            applied = _applied(self.coils, self.background, len(self.weights), x)
            h = h + np.tensordot(self.weights * region.linked, applied, 1)
        return h

    def _mean_over(self, body: str) -> Array:
        """Mean B (3,), T, from the integral of x B.n over the boundary, because B has no divergence."""
        surface = self.solution.surface
        solids = surface.solids_of(body)
        triangles = surface.around(solids)
        faces = ChargedFaces.from_nodes(surface.points, triangles)
        flux = self._normal_flux_density(solids) * faces.areas
        return (flux @ faces.centres) / enclosed_volume(surface.points, triangles)

    def _normal_flux_density(self, solids: Index) -> Array:
        """B.n (k,) in T on the triangles around some solids, outward, in the order of `IronSurface.around`."""
        surface = self.solution.surface
        numbers = surface.faces_around(solids)
        faces = ChargedFaces.from_nodes(surface.points, surface.around(solids))
        value = np.zeros(len(surface.triangles))
        known = np.zeros(len(surface.triangles), bool)
        for region in self.solution.regions:
            outward = np.einsum("cnd,nd->cn", region.flux_density, region.faces.normals)
            value[region.triangles] = (self.weights @ outward) * region.turned
            known[region.triangles] = True
        turned = np.where(np.isin(surface.sides[numbers, 0], solids), 1.0, -1.0)
        out = value[numbers] * turned
        # Triangles within a region have no charges: B there is computed as at any point inside.
        missing = np.flatnonzero(~known[numbers])
        b = self._inside(faces.centres[missing], surface.sides[numbers[missing], 0])
        out[missing] = np.einsum("nd,nd->n", b, faces.normals[missing])
        return out

    def section_flux(self, section: str | Section) -> SectionFlux:
        """Flux, area and mean normal flux density of a section, from the flux out of the iron on one side of its plane.

        Raises InputError for an unknown name, for a plane that cuts no iron, and for a section with half widths, which
        need the field inside: solve in another form.
        """
        surface = self.solution.surface
        cut = named_section(self.sections, section)
        check_section(cut, surface.body_names)
        if cut.half_widths is not None:
            must_hold, remedy = "half widths need the field inside the iron", 'solve with form="potential"'
            raise InputError.of(f"section '{cut.name}'", must_hold, "the surface form", remedy)
        names = cut.bodies or surface.body_names
        solids = np.concatenate([surface.solids_of(name) for name in names])
        corners = surface.points[surface.around(solids)]
        normal = np.asarray(cut.normal, dtype=float) / np.linalg.norm(cut.normal)
        extent = float(np.ptp(surface.points, axis=0).max())
        # A plane in the very surface of the iron cuts it from the other side.
        for sign in (1.0, -1.0):
            height = sign * ((corners - np.asarray(cut.origin, dtype=float)) @ normal)
            height[np.abs(height) < SNAP * extent] = 0.0
            area = _enclosed_area(corners, height, sign * normal)
            if area > 0:
                flux = self._normal_flux_density(solids) @ areas_above(corners, height)
                return SectionFlux(cut.name, area, sign * float(flux), None)
        raise no_iron_at(cut)


def _applied(coils: Sequence[Coil], background: Background | None, columns: int, x: Array) -> Array:
    """Flux densities (c, n, 3) at points (n, 3) of one ampere in each coil and, last, of the background."""
    out = np.zeros((columns, *x.shape))
    out[: len(coils)] = unit_flux_densities(coils, x)
    if background is not None:
        out[-1] = background.field(x)
    return out


def _enclosed_area(corners: Array, height: Array, normal: Array) -> float:
    """Area inside the lines in which the plane of height zero cuts triangles (n, 3, 3) with outward normals."""
    above = height >= 0
    crossing = above.any(axis=1) & ~above.all(axis=1)
    corners, height, above = corners[crossing], height[crossing], above[crossing]
    lone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    order = (lone[:, None] + np.arange(3)) % 3
    x, h = np.take_along_axis(corners, order[:, :, None], axis=1), np.take_along_axis(height, order, axis=1)
    ends = [x[:, 0] + (h[:, 0] / (h[:, 0] - h[:, k]))[:, None] * (x[:, k] - x[:, 0]) for k in (1, 2)]
    outward = area_vectors(x)
    # Counter-clockwise about the normal, with the iron on the left.
    forward = np.sign(np.einsum("nd,nd->n", ends[1] - ends[0], np.cross(normal, outward)))
    centre = corners.reshape(-1, 3).mean(axis=0) if len(corners) else np.zeros(3)
    return float(0.5 * forward @ (np.cross(ends[0] - centre, ends[1] - centre) @ normal))


def region_field(
    surface: IronSurface, solved: SurfacePotential, of: RegionPotential, remanence: Array
) -> RegionField:
    """The field inside a region by its potentials; remanence (c, 3) in T."""
    own, region = of.side.surface, of.region
    normal = of.side.normal_derivative(of.total)
    triangles = surface.faces_around(region.solids)
    outer = surface.faces_around(surface.all_solids)
    place = np.full(len(surface.triangles), -1)
    place[outer] = np.arange(len(outer))
    air = np.flatnonzero(place[triangles] >= 0)
    at = np.ix_(air, np.flatnonzero(solved.linked))
    normal[at] = -solved.normal[place[triangles[air]]][:, solved.linked] / region.mu_r
    # The tangential part of -grad u is n x (n x grad u).
    across = np.cross(own.faces.normals[:, :, None], of.total.curl, axis=1) / own.faces.areas[:, None, None]
    strength = across - own.faces.normals[:, :, None] * normal[:, None]
    potential = np.where(solved.linked, solved.reduced, solved.total)[own.nodes]
    means = own.means @ potential
    # A constant has no field inside but for the discretisation error, which would dominate at large mu_r.
    means = means - own.faces.areas @ means / own.faces.areas.sum()
    density = np.ascontiguousarray((own.charge(means) / own.faces.areas[:, None]).T)
    turned = np.where(np.isin(surface.sides[triangles, 0], region.solids), 1.0, -1.0)
    strength = np.ascontiguousarray(np.moveaxis(strength, 2, 0))
    of_region = (region.solids, region.mu_r, remanence)
    return RegionField(*of_region, own.faces, triangles, turned, strength, density, solved.linked)


def iron_linkages(solved: SurfacePotential, coils: int) -> Array:
    """The iron's flux linkages (coils, c) in Wb: int t_k . (B - mu0 H) dV / mu0 with the field t_k of one ampere in
    coil k (docs/theory/forces.md)."""
    total = np.zeros((coils, len(solved.magnets)))
    for of in solved.regions:
        own = of.applied.part(slice(coils))
        total = total + (of.region.mu_r - 1) * of.side.energy(own, of.total)
        # int t dV = int x t.n dS, and t.n = -d psi / dn.
        applied = -(of.side.normal_derivative(own) * of.side.surface.faces.areas[:, None]).T
        mean = applied @ of.side.surface.faces.centres
        total = total + np.outer(mean @ of.region.remanence, solved.magnets)
    return total / MU0


# Bytes per pair of triangles: W with its factor in single precision (12), K (4), D and its factor (4), and room for the
# matrices inside several bodies.
_BYTES_PER_PAIR = 30


def solve_by_surface(
    device: Device, properties: BodyProperties, tolerance: float, refinement: float, stages: Stages
) -> SurfaceSolution:
    """The surface form on the mesh of a sound device with iron and sources; see `fieldmap.solve_linear`. tolerance: of
    the residual. Raises NotConverged."""
    stages.next("meshing the surface", 0.02)
    surface = generate_surface(device, refinement)
    count = len(surface.triangles)
    needed, what = _BYTES_PER_PAIR * count**2, "the dense matrices of the surface form"
    remedy = 'use a smaller refinement, larger mesh sizes, or form="auto"'
    require_memory(f"surface mesh of {device.name}", what, needed, f"{count} triangles", remedy)
    stages.next("operators of the surface", 0.1)
    form = SurfaceForm(surface, regions_of(surface, properties.mu_r, properties.remanence))
    stages.next("coil fields and solution", 0.7)
    has_remanence = bool(properties.remanence.any())
    background = device.background
    has_constant = has_remanence or background is not None

    coils = len(device.coils)
    magnets = np.zeros(coils + has_constant)
    magnets[coils:] = 1.0
    solved = form.solve(lambda x: _applied(device.coils, background, len(magnets), x), magnets, tolerance)
    faces = solved.outside.surface.faces
    density = np.ascontiguousarray((solved.charges / faces.areas[:, None]).T)
    state = IronState(faces, density, np.zeros((len(density), 0, 3)), len(solved.residuals), solved.residuals)
    regions = tuple(
        region_field(surface, solved, of, np.outer(magnets, of.region.remanence)) for of in solved.regions
    )
    linkage = iron_linkages(solved, coils)
    stages.done()
    report = SolverReport(
        form=form.name,
        tetrahedra=0,
        surface_faces=len(faces.areas),
        charged_faces=len(faces.areas),
        unknowns=form.unknowns,
        magnetic_bodies=int(surface.pieces.max()) + 1,
        iterations=len(solved.residuals),
        residual=solved.residuals[-1],
        matrix_bytes=needed,
        seconds=stages.seconds,
        assumptions=properties.assumptions + geometry_notes(device),
        storage="dense",
    )
    about = (device.sections, device.bounds, device.background)
    solution = (device.coils, None, state, has_remanence, report, linkage, *about)
    return SurfaceSolution(*solution, surface=surface, regions=regions)
