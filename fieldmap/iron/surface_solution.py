"""Linear iron solved by its surface alone: what its solution knows without a mesh of the volume.

Outside, charges on the surface make the field, as in the other forms. Inside a region of one material the total field
is that of another layer of charges on the region's boundary, which make the total potential there: nothing cancels, and
B is mu_r times that field. Where the iron links the currents of a source its total potential has no single value; there
the second layer makes the iron's own field, to which that of the source is added.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.constants import MU0
from fieldmap.device.drawing import Outline, source_outline, winding_outline
from fieldmap.device.model import Section
from fieldmap.errors import InputError, Problem
from fieldmap.field import Currents, coil_currents
from fieldmap.iron.elements.surface_form import RegionPotential, SurfacePotential
from fieldmap.iron.mesh.surface_mesh import AIR, IronSurface, enclosed_volume
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.iron.quantities.air import checked_points
from fieldmap.iron.quantities.forces import Magnetised
from fieldmap.iron.quantities.sections import SNAP, SectionFlux, check_section, named_section, no_iron_at
from fieldmap.iron.solution import FluxDensitySamples, LinearSolution, LinearState
from fieldmap.kernels.iron.containment import solid_angle_sums
from fieldmap.records import Record
from fieldmap.sources import unit_flux_densities
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class RegionField(Record):
    """The field inside one region of constant permeability, of several sources (columns c).

    solids (k,): its solids in the mesh; remanence (c, 3) in T; faces: its boundary; triangles (n,): their numbers in
    the mesh, and turned (n,): -1 where the normal of the mesh enters the region; strength (c, n, 3): mu0 H in T just
    inside; density (c, n) in T: charges whose field inside is mu0 H, or that of the iron where `linked` (c,).
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

    def at(self, currents: Currents) -> SurfaceState:
        """The state at these currents. Raises InputError for currents that do not fit the coils."""
        amperes = np.array(coil_currents(currents, self.coil_names))
        weights = np.append(amperes, 1.0) if self.has_constant else amperes
        about = (self.coils, amperes, None, self.state, weights, self.report, self.sections)
        return SurfaceState(*about, self, bounds=self.bounds, background=self.background, origin=self.origin)

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

    def _refuse_inside(self, x: Array) -> None:
        inside = np.flatnonzero(self.surface_of(x) != AIR)
        if len(inside):
            name = self.surface.body_names[self.surface.body[self.surface_of(x[inside[:1]])[0]]]
            must_hold = "the gradient is defined outside the iron only"
            received = (
                f"{len(inside)} of {len(x)} points inside, the first at {x[inside[0]]} m in body '{name}'"
            )
            raise InputError(Problem("points", must_hold, received, "keep the points in the air"))

    def surface_of(self, x: Array) -> Index:
        """Number (n,) of the solid that contains each point (n, 3), -1 in the air."""
        found = np.full(len(x), AIR)
        for number, (faces, lower, upper) in enumerate(self._solids):
            near = np.flatnonzero(((x >= lower) & (x <= upper)).all(axis=1) & (found == AIR))
            if len(near):
                geometry = (faces.corners, faces.normals, faces.areas, faces.centres, faces.radii)
                angles = np.empty(len(near))
                points = np.ascontiguousarray(x[near])
                over_rows(solid_angle_sums, len(near), points, *geometry, angles, work=len(faces.areas))
                found[near[angles < -0.5]] = number
        return found

    @cached_property
    def _solids(self) -> tuple[tuple[ChargedFaces, Array, Array], ...]:
        """Boundary and bounding box of every solid."""
        boundaries = (
            ChargedFaces.from_nodes(self.surface.points, self.surface.around(np.array([number])))
            for number in self.surface.all_solids
        )
        return tuple(
            (faces, faces.corners.min(axis=(0, 1)), faces.corners.max(axis=(0, 1))) for faces in boundaries
        )


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceState(LinearState):
    """A solution of the surface form at currents (c,) in A."""

    solution: SurfaceSolution

    def field(self, points: ArrayLike) -> Array:
        """Flux density (n, 3) or (3,), inside the iron too. Raises InputError for bad points."""
        x, single = checked_points(points)
        b = np.empty(x.shape)
        solid = self.solution.surface_of(x)
        air = solid == AIR
        b[air] = self._field_of_charges(x[air])
        for strength, mine, region in self._inside(x, solid):
            b[mine] = region.mu_r * strength + self.weights @ region.remanence
        return b[0] if single else b

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient dB_i/dx_j (n, 3, 3) or (3, 3), outside the iron. Raises InputError for points inside it."""
        x, single = checked_points(points)
        self.solution._refuse_inside(x)
        g = self._gradient_of_charges(x)
        return g[0] if single else g

    def polarisation(self, points: ArrayLike) -> Array:
        """mu0 M (n, 3) or (3,), T: zero in the air."""
        x, single = checked_points(points)
        values = np.zeros(x.shape)
        for strength, mine, region in self._inside(x, self.solution.surface_of(x)):
            values[mine] = (region.mu_r - 1) * strength + self.weights @ region.remanence
        return values[0] if single else values

    def _inside(self, x: Array, solid: Index):
        """mu0 H (k, 3), numbers (k,) of the points and region, of every region with points (n, 3) in it."""
        for number, region in enumerate(self.solution.regions):
            mine = np.flatnonzero(np.isin(solid, region.solids))
            if len(mine):
                yield self._strength(number, x[mine]), mine, region

    def _strength(self, number: int, x: Array) -> Array:
        """mu0 H (n, 3) at points (n, 3) of a region."""
        region = self.solution.regions[number]
        h = region.faces.field(x, np.ascontiguousarray((self.weights @ region.density)[None]))[0]
        if region.linked.any():
            applied = np.zeros((len(self.weights), *x.shape))
            applied[: len(self.coils)] = unit_flux_densities(self.coils, x)
            if self.background is not None:
                applied[-1] += self.background.field(x)
            h = h + np.tensordot(self.weights * region.linked, applied, 1)
        return h

    def flux_density(self, body: str) -> Array:
        """Mean flux density (3,) in T over the volume of a named body. Raises InputError for an unknown name.

        By the mean of x B.n over its boundary: B has no divergence.
        """
        surface = self.solution.surface
        if body not in surface.body_names:
            must_hold = f"the name must be one of {', '.join(surface.body_names)}"
            raise InputError(Problem("flux_density, body", must_hold, repr(body), "use one of these"))
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
        # Within a region there are no charges: the field is that of any other point inside.
        missing = np.flatnonzero(~known[numbers])
        for number, region in enumerate(self.solution.regions):
            mine = missing[np.isin(surface.sides[numbers[missing], 0], region.solids)]
            if len(mine):
                b = (
                    region.mu_r * self._strength(number, faces.centres[mine])
                    + self.weights @ region.remanence
                )
                out[mine] = np.einsum("nd,nd->n", b, faces.normals[mine])
        return out

    def section_flux(self, section: str | Section) -> SectionFlux:
        """Flux, area and mean normal flux density of a section, by what leaves the iron on one side of its plane.

        Raises InputError for an unknown name, for a plane that cuts no iron, and for a section with half widths, which
        need the field inside: solve in another form.
        """
        surface = self.solution.surface
        cut = named_section(self.sections, section)
        check_section(cut, surface.body_names)
        if cut.half_widths is not None:
            must_hold, remedy = "half widths need the field inside the iron", 'solve with form="potential"'
            raise InputError(Problem(f"section '{cut.name}'", must_hold, "the surface form", remedy))
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
                flux = self._normal_flux_density(solids) @ _areas_above(corners, height)
                return SectionFlux(cut.name, area, sign * float(flux))
        raise no_iron_at(cut)

    def outlines(self) -> tuple[Outline, ...]:
        """The surfaces of bodies and windings."""
        fixed = () if self.background is None else self.background.sources
        return (
            *self.solution.surface.outlines(),
            *(winding_outline(coil) for coil in self.coils),
            *(source_outline(source) for source in fixed),
        )

    @property
    def _magnetised(self) -> Magnetised:
        iron = self.iron
        assert iron is not None
        density = self.weights @ iron.density
        return Magnetised(
            self.coils, self.currents, self.solution.surface, iron.faces, density, self.background
        )


def _areas_above(corners: Array, height: Array) -> Array:
    """Area (n,) of the part of triangles (n, 3, 3) where a linear function with corner values (n, 3) is positive."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low, middle, high = np.sort(height, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        tip = high**2 / ((high - low) * (high - middle))
        base = 1 - low**2 / ((low - middle) * (low - high))
    share = np.select([low >= 0, high <= 0, middle <= 0], [1.0, 0.0, tip], base)
    return 0.5 * np.linalg.norm(cross, axis=1) * share


def _enclosed_area(corners: Array, height: Array, normal: Array) -> float:
    """Area inside the lines in which the plane of height zero cuts triangles (n, 3, 3) with outward normals."""
    above = height >= 0
    crossing = above.any(axis=1) & ~above.all(axis=1)
    corners, height, above = corners[crossing], height[crossing], above[crossing]
    lone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    order = (lone[:, None] + np.arange(3)) % 3
    x, h = np.take_along_axis(corners, order[:, :, None], axis=1), np.take_along_axis(height, order, axis=1)
    ends = [x[:, 0] + (h[:, 0] / (h[:, 0] - h[:, k]))[:, None] * (x[:, k] - x[:, 0]) for k in (1, 2)]
    outward = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
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
    # The curl n x grad u, turned about n once more.
    across = np.cross(own.faces.normals[:, :, None], of.total.curl, axis=1) / own.faces.areas[:, None, None]
    strength = across - own.faces.normals[:, :, None] * normal[:, None]
    potential = np.where(solved.linked, solved.reduced, solved.total)[own.nodes]
    means = own.means @ potential
    # A constant has no field inside, but for the discretisation: at large mu_r it would be all there is.
    means = means - own.faces.areas @ means / own.faces.areas.sum()
    density = own.charge(means) / own.faces.areas[:, None]
    turned = np.where(np.isin(surface.sides[triangles, 0], region.solids), 1.0, -1.0)
    return RegionField(
        region.solids,
        region.mu_r,
        remanence,
        own.faces,
        triangles,
        turned,
        np.ascontiguousarray(np.moveaxis(strength, 2, 0)),
        np.ascontiguousarray(density.T),
        solved.linked,
    )


def iron_linkages(solved: SurfacePotential, coils: int) -> Array:
    """Flux linkages (coils, c) in Wb that the iron adds: int t_k . (B - mu0 H) dV / mu0 with the field t_k of one
    ampere in coil k (docs/theory/forces.md)."""
    total = np.zeros((coils, len(solved.magnets)))
    for of in solved.regions:
        own = of.applied.part(slice(coils))
        total = total + (of.region.mu_r - 1) * of.side.energy(own, of.total)
        # int t dV = int x t.n dS, and t.n = -d psi / dn.
        applied = -(of.side.normal_derivative(own) * of.side.surface.faces.areas[:, None]).T
        mean = applied @ of.side.surface.faces.centres
        total = total + np.outer(mean @ of.region.remanence, solved.magnets)
    return total / MU0
