"""Solved iron: the linear solution, which gives the field for any currents, and states at fixed currents.

Every state has the same interface, whether the iron is linear (`LinearSolution.at`), saturates (`NonlinearSolver.at`)
or has hysteresis (`HysteresisSolver.step`): fields, flux densities, forces, section fluxes, flux linkages. Fields in T,
gradients G[..., i, j] = dB_i/dx_j in T/m, points (n, 3) or (3,) in m, global frame.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_choice
from fieldmap.device.drawing import Outline, source_outline, winding_outline
from fieldmap.device.model import Background, Coil, Section
from fieldmap.errors import InputError
from fieldmap.field import Bounds, Currents, FieldAtCurrents, FieldOfStates, coil_currents
from fieldmap.iron.elements.potential_form import PotentialState
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.forces import Magnetised, force_and_torque, magnetic_bodies
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import IronMesh, checked_points, refuse_inside, volumes
from fieldmap.iron.mesh.surface_mesh import IronSurface
from fieldmap.iron.report import SolverReport
from fieldmap.iron.sections import SectionFlux, named_section, section_flux
from fieldmap.records import Record, card, count_of, shortened
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.inductance import background_linkage, bare_inductance
from fieldmap.typing import Array, Index

if TYPE_CHECKING:
    from fieldmap.iron.sensitivity.changes import Parameters
    from fieldmap.iron.sensitivity.quantities import Derivatives, Quantity


class Origin(Protocol):
    """The device that a state was solved for, and its derivatives (`fieldmap.iron.sensitivity.adjoint.Origin`)."""

    def derivative(
        self,
        state: SolvedState,
        quantity: Quantity,
        parameters: Sequence[str],
        followed: Parameters | None = None,
    ) -> Derivatives:
        """See `SolvedState.derivative`; followed: how the device depends on the keys, if not as in its own file."""
        ...


class _Reported:
    """Names, assumptions and printed form that states and linear solutions have in common."""

    coils: tuple[Coil, ...]
    report: SolverReport

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return tuple(coil.name for coil in self.coils)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The assumptions of the result, in words."""
        return self.report.assumptions

    @property
    def has_iron(self) -> bool:
        """Whether the device has iron."""
        return self.report.magnetic_bodies > 0

    @property
    def _title(self) -> str:
        return f"{type(self).__name__} of {count_of(len(self.coils), 'coil', 'coils')}"

    def __repr__(self) -> str:
        return shortened(f"<{self._title}: {self.report}>")

    def _repr_html_(self) -> str:
        return card(self._title, self.report.card_rows())

    @cached_property
    def _air_inductance(self) -> Array:
        return bare_inductance(self.coils)


@dataclass(frozen=True, eq=False, repr=False)
class SolvedState(_Reported, FieldAtCurrents):
    """Coils and iron at fixed currents (c,) in A: the common base of all states.

    iron: charges and flux densities, one column for each source, or None without iron; weights (columns,): the share of
    each column in this state. bounds: the box around the workspace. background: the field that nothing in
    the device drives, if any; it is part of every field and force here.
    """

    coils: tuple[Coil, ...]
    currents: Array
    mesh: IronMesh | None
    iron: IronState | None
    weights: Array
    report: SolverReport
    sections: tuple[Section, ...]
    bounds: Bounds | None = field(default=None, kw_only=True)
    background: Background | None = field(default=None, kw_only=True)
    origin: Origin | None = field(default=None, kw_only=True)

    @property
    def _title(self) -> str:
        return f"{type(self).__name__} at {', '.join(f'{i:g}' for i in self.currents)} A"

    def field(self, points: ArrayLike) -> Array:
        """Flux density at points, inside the iron too; within an element it is the element's mean.

        On faces and edges of the iron it is the field of the adjacent air. At an edge it grows without limit as the
        mesh gets finer.

        Raises
        ------
        InputError
            For points that are not finite or have another shape.
        """
        x, single = checked_points(points)
        if self.iron is not None:
            x = self.iron.faces.off_surface(x)
        b = self._in_air(x)
        if self.iron is not None:
            within, inside = self._within(x)
            b[inside] = self._inside(x[inside], within[inside])
        return b[0] if single else b

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the flux density outside the iron.

        Raises
        ------
        InputError
            For points inside the iron.
        """
        return self.field_and_gradient(points)[1]

    def field_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """`field` and `gradient` in one pass.

        Parameters
        ----------
        points
            Positions outside the iron (3,), (n, 3) or (..., 3), m.

        Returns
        -------
        tuple[Array, Array]
            B (..., 3), T, and dB_i/dx_j (..., 3, 3), T/m.

        Raises
        ------
        InputError
            For points inside the iron.
        """
        x, single = checked_points(points)
        if self.iron is not None:
            x = self.iron.faces.off_surface(x)
        refuse_inside(self._bodies, x)
        b, g = np.zeros(x.shape), np.zeros((*x.shape, 3))
        for coil, current in zip(self.coils, self.currents, strict=True):
            flux, slope = unit_flux_density_and_gradient(coil, x)
            b += current * flux
            g += current * slope
        if self.background is not None:
            flux, slope = self.background.field_and_gradient(x)
            b, g = b + flux, g + slope
        if self.iron is not None:
            (flux,), (slope,) = self.iron.faces.field_and_gradient(x, self._density)
            b, g = b + flux, g + slope
        return (b[0], g[0]) if single else (b, g)

    @cached_property
    def element_flux_density(self) -> Array:
        """Mean flux density (e, 3) in T of every element of the iron."""
        return self._mean_in(slice(None))

    @property
    def largest_flux_density(self) -> float:
        """Largest of the elements' flux densities, T; NaN without iron."""
        size = np.linalg.norm(self.element_flux_density, axis=1)
        return float(size.max()) if len(size) else float("nan")

    def flux_density(self, body: str) -> Array:
        """Mean flux density over the volume of a body.

        Parameters
        ----------
        body
            Name of the body.

        Returns
        -------
        Array
            B (3,), T.

        Raises
        ------
        InputError
            For an unknown name.
        """
        names = () if self._bodies is None else self._bodies.body_names
        return self._mean_over(check_choice("flux_density, body", body, names))

    def section_flux(self, section: str | Section) -> SectionFlux:
        """Flux, area and mean normal flux density of a section, and the estimated error of the flux.

        The flux is the one that the solution conserves, at inner corners too (docs/theory/forces.md).

        Parameters
        ----------
        section
            Name of a section of the device file, or any plane.

        Returns
        -------
        SectionFlux
            Flux, area, flux density and error.

        Raises
        ------
        InputError
            For an unknown name, and for a plane that cuts no iron.
        """
        cut = named_section(self.sections, section)
        return section_flux(self.mesh, self.iron, cut, self.weights, self._in_air)

    def section_flux_density(self, section: str | Section) -> float:
        """Mean flux density along the normal of a section.

        Parameters
        ----------
        section
            As for `section_flux`.

        Returns
        -------
        float
            Flux density, T.

        Raises
        ------
        InputError
            As for `section_flux`.
        """
        return self.section_flux(section).flux_density

    def force_on(self, name: str | Sequence[str]) -> Array:
        """Force on a body or coil, or on several together.

        Parameters
        ----------
        name
            Name, or names. Bodies that touch have a force only together: name them all.

        Returns
        -------
        Array
            Force (3,), N.

        Raises
        ------
        InputError
            For unknown names, and for a body without the bodies that touch it.
        """
        return self.force_and_torque_on(name, np.zeros(3))[0]

    @property
    def pieces_of_iron(self) -> tuple[tuple[str, ...], ...]:
        """Names of the bodies of each connected piece of iron, in the order of the device."""
        mesh, faces = self._charged
        if mesh is None or faces is None:
            return ()
        bodies = magnetic_bodies(mesh, faces)
        return tuple(dict.fromkeys(bodies.touched_by(mesh, name) for name in mesh.iron_names))

    def torque_on(self, name: str | Sequence[str], about: ArrayLike) -> Array:
        """Torque on a body or coil, or on several together.

        Parameters
        ----------
        name
            As for `force_on`.
        about
            Point (3,), m.

        Returns
        -------
        Array
            Torque (3,), N m.

        Raises
        ------
        InputError
            As for `force_on`.
        """
        return self.force_and_torque_on(name, about)[1]

    def force_and_torque_on(self, name: str | Sequence[str], about: ArrayLike) -> tuple[Array, Array]:
        """`force_on` and `torque_on` in the time of one.

        Parameters
        ----------
        name
            As for `force_on`.
        about
            Point (3,) of the torque, m.

        Returns
        -------
        tuple[Array, Array]
            Force (3,), N, and torque (3,), N m.

        Raises
        ------
        InputError
            As for `force_on`.
        """
        density = None
        if self.iron is not None:
            density = self.weights @ (self.iron.separated or self.iron).density
        whole = Magnetised(self.coils, self.currents, *self._charged, density, self.background)
        return force_and_torque(whole, name, about)

    def flux_linkage(self) -> Array:
        """Flux linkages (c,) of the coils in Wb, all turns; with the flux of magnets and background."""
        of_others = self._background_linkage + self._iron_linkage
        # At zero currents the inductances are not needed; those of many coils take long.
        return self._air_inductance @ self.currents + of_others if self.currents.any() else of_others

    def derivative(self, quantity: Quantity, parameters: Sequence[str]) -> Derivatives:
        """Derivatives of a quantity by numbers of the device, exact for the discrete equations.

        They take one linear solve for each number of the quantity, for any number of parameters
        (docs/theory/iron_derivatives.md).

        Parameters
        ----------
        quantity
            `FluxDensityAt`, `GradientAt`, `DipoleForce`, `FluxLinkage` or `FieldFunction` of `fieldmap.iron`.
        parameters
            Key paths of the device file, in the units of their keys, and "current.NAME" for the current of a
            coil (A; "current.*" for all together): currents, turns, places and sizes of coils, remanence,
            permeability and B-H parameters, the background, places of bodies, sizes of boxes, cylinders,
            rings and spheres.

        Returns
        -------
        Derivatives
            The derivatives by key.

        Raises
        ------
        InputError
            For points inside the iron, for keys of joints, for keys that change shapes in other ways, and for a
            solution that was read from a file, has hysteresis, or is not of the potential form.
        DeviceFileError
            For keys that the device lacks.
        NotConverged
            If a linear solve does not converge.

        Examples
        --------
        >>> import fieldmap as fm
        >>> from fieldmap.iron import FluxDensityAt
        >>> state = fm.solve_linear("loop_and_sphere").at([2.0])
        >>> found = state.derivative(FluxDensityAt([0.0, 0.0, -0.014]), ["current.loop"])
        >>> print(f"{1e3 * found['current.loop'][2]:.2f} mT/A")
        1.01 mT/A
        """
        if self.origin is None:
            received = "a state with hysteresis, or a solution without its device"
            raise InputError.of(
                "derivative", "the equations of the state are needed", received, "solve the device again"
            )
        return self.origin.derivative(self, quantity, parameters)

    def polarisation(self, points: ArrayLike) -> Array:
        """mu0 M: within an element of iron or magnets the element's mean, zero in the air.

        Parameters
        ----------
        points
            Positions (n, 3) or (3,), m.

        Returns
        -------
        Array
            mu0 M (n, 3) or (3,), T.

        Raises
        ------
        InputError
            For a solution that was read back from a file: it holds only the charges of the iron.
        """
        x, single = checked_points(points)
        values = np.zeros(x.shape)
        if self.iron is not None:
            within, inside = self._within(x)
            if inside.any() or self._bodies is None:
                values[inside] = self._polarised(x[inside], within[inside])
        return values[0] if single else values

    def outlines(self) -> tuple[Outline, ...]:
        """The surfaces of bodies and windings."""
        bodies = () if self._bodies is None else self._bodies.outlines()
        fixed = () if self.background is None else self.background.sources
        return (*bodies, *map(winding_outline, self.coils), *map(source_outline, fixed))

    @property
    @abstractmethod
    def _iron_linkage(self) -> Array:
        """The iron's part of the flux linkages (c,), Wb."""

    @cached_property
    def _background_linkage(self) -> Array:
        return background_linkage(self.coils, self.background)

    @property
    def _bodies(self) -> IronMesh | IronSurface | None:
        return self.mesh

    @property
    def _density(self) -> Array:
        """Charge (1, m) per area of the faces, T."""
        assert self.iron is not None
        return np.ascontiguousarray((self.weights @ self.iron.density)[None])

    @property
    def _charged(self) -> tuple[IronMesh | IronSurface | None, ChargedFaces | None]:
        """Bodies and their charged faces. A thin drawn gap is air here, also where the mesh has a sheet in it."""
        if self.iron is None:
            return None, None
        apart = self.iron.separated
        return (self._bodies, self.iron.faces) if apart is None else (apart.surface.mesh, apart.surface.faces)

    def _in_air(self, x: Array) -> Array:
        """B (n, 3) at points (n, 3) in the air."""
        b = np.zeros(x.shape)
        if self.background is not None:
            b += self.background.field(x)
        for coil, current in zip(self.coils, self.currents, strict=True):
            b += current * unit_flux_density(coil, x)
        return b if self.iron is None else b + self.iron.faces.field(x, self._density)[0]

    def _within(self, x: Array) -> tuple[Index, NDArray[np.bool_]]:
        """The element or solid (n,) that contains each point (n, 3), and whether one does."""
        within = np.full(len(x), -1) if self._bodies is None else self._bodies.containing(x)
        return within, within >= 0

    def _inside(self, x: Array, within: Index) -> Array:
        """B (n, 3) at points inside these elements or solids."""
        return self._mean_in(within)

    def _polarised(self, x: Array, within: Index) -> Array:
        """mu0 M (n, 3) at points inside these elements or solids."""
        assert self.iron is not None
        return self.iron.mean_polarisation(within, self.weights)

    def _mean_in(self, element: Index | slice) -> Array:
        if self.iron is None:
            return np.zeros((0, 3))
        return np.einsum("c,ced->ed", self.weights, self.iron.flux_density[:, element])

    def _mean_over(self, body: str) -> Array:
        """B (3,) over the volume of a body."""
        assert self.mesh is not None
        mine = self.mesh.body == self.mesh.body_names.index(body)
        volume = volumes(self.mesh.points, self.mesh.tets)[mine]
        return volume @ self.element_flux_density[mine] / volume.sum()


@dataclass(frozen=True, eq=False, repr=False)
class FluxDensitySamples(Record):
    """Flux densities (e,) in T in the iron, the weight (e,) of each, and the index (e,) into `body_names`."""

    size: Array
    weight: Array
    body: Index
    body_names: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class LinearSolution(_Reported, FieldOfStates):
    """Coils and linear iron, solved once per coil; any currents by superposition.

    `at(currents)` is the state at these currents. Methods that take currents, from `field` to `energy`, are short for
    the methods of that state. Permanent magnets and the background, if any, add a field that no current changes: one
    more column after the coils' columns, `constant_fields`. Currents: (c,) in A, one number for all coils, or a mapping
    by name. Forces, inductances and energy: docs/theory/forces.md.

    >>> import fieldmap as fm
    >>> unit = fm.solve_linear(fm.read_device("loop_and_sphere"))
    >>> field = unit.field([0.0, 0.0, -0.014], currents=[1.0])
    >>> print(f"{1e3 * field[2]:.2f} mT; closed form 1.007 mT")
    1.01 mT; closed form 1.007 mT
    """

    coils: tuple[Coil, ...]
    mesh: IronMesh | None
    state: IronState | None
    has_remanence: bool
    report: SolverReport
    iron_linkage: Array | None = None
    sections: tuple[Section, ...] = ()
    bounds: Bounds | None = None
    background: Background | None = None
    origin: Origin | None = None

    @property
    def has_constant(self) -> bool:
        """Whether there is a field that no current drives."""
        return self.has_remanence or self.background is not None

    @property
    def proportional(self) -> bool:
        """Whether the field is proportional to the currents: True without permanent magnets and background."""
        return not self.has_constant

    @property
    def affine(self) -> bool:
        """The field is a constant and the sum of the coils' fields."""
        return True

    @property
    def sources(self) -> tuple[str, ...]:
        """The source of each column of `source_fields`, in words."""
        fixed = ["the permanent magnets"] * self.has_remanence
        fixed += ["the background"] * (self.background is not None)
        coils = tuple(f"1 A in coil '{name}'" for name in self.coil_names)
        return (*coils, " and ".join(fixed)) if fixed else coils

    @property
    def iron_points(self) -> Array:
        """Points (m, 3) all over the surface of the iron: the centres of its faces, m; none without iron."""
        return np.zeros((0, 3)) if self.state is None else self.state.faces.centres

    def at(self, currents: Currents) -> LinearState:
        """The state at these currents.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        LinearState
            The state.

        Raises
        ------
        InputError
            For currents that do not fit the coils.
        """
        amperes = np.array(coil_currents(currents, self.coil_names))
        weights = np.append(amperes, 1.0) if self.has_constant else amperes
        about = (self.coils, amperes, self.mesh, self.state, weights, self.report, self.sections)
        return self._state_type(
            *about, self, bounds=self.bounds, background=self.background, origin=self.origin
        )

    @property
    def _state_type(self) -> type[LinearState]:
        return LinearState

    @property
    def _bodies(self) -> IronMesh | IronSurface | None:
        return self.mesh

    def unit_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Total field and gradient of 1 A in each coil, outside the iron, without the field that no current
        drives.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        tuple[Array, Array]
            B (c, n, 3), T/A, and gradient (c, n, 3, 3), T/(m A).

        Raises
        ------
        InputError
            For points that are not (n, 3) or not finite, and for points inside the iron, where the gradient
            is not defined by the solver.
        """
        b, g = self.source_fields(points)
        return b[: len(self.coils)], g[: len(self.coils)]

    def source_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Fields and gradients of every column.

        The first columns are the fields of 1 A in each coil. If there are permanent magnets or a background, one
        more column is their field with all currents off.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        tuple[Array, Array]
            B (columns, n, 3), and gradient (columns, n, 3, 3).

        Raises
        ------
        InputError
            As for `unit_fields`.
        """
        x, _ = checked_points(points)
        if self.state is not None:
            x = self.state.faces.off_surface(x)
        refuse_inside(self._bodies, x)
        columns = len(self.coils) + self.has_constant
        b, g = np.zeros((columns, len(x), 3)), np.zeros((columns, len(x), 3, 3))
        for k, coil in enumerate(self.coils):
            b[k], g[k] = unit_flux_density_and_gradient(coil, x)
        if self.background is not None:
            b[-1], g[-1] = self.background.field_and_gradient(x)
        if self.state is not None:
            iron_b, iron_g = self.state.faces.field_and_gradient(x, self.state.density)
            b += iron_b
            g += iron_g
        return b, g

    def flux_density_samples(self, currents: Currents) -> FluxDensitySamples:
        """|B| all over the iron: one sample for every element, weighted by its volume.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        FluxDensitySamples
            The samples.
        """
        state, mesh = self.at(currents), self.mesh
        if mesh is None:
            return FluxDensitySamples(np.zeros(0), np.zeros(0), np.zeros(0, np.int64), ())
        size = np.linalg.norm(state.element_flux_density, axis=1)
        return FluxDensitySamples(size, volumes(mesh.points, mesh.tets), mesh.body, mesh.body_names)

    def constant_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Field and gradient of permanent magnets and background, with all currents off, outside the iron.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        tuple[Array, Array]
            B (n, 3), T, and gradient (n, 3, 3), T/m.

        Raises
        ------
        InputError
            As for `unit_fields`.
        """
        b, g = self.source_fields(points)
        if not self.has_constant:
            return np.zeros(b.shape[1:]), np.zeros(g.shape[1:])
        return b[-1], g[-1]

    def inductance(self) -> Array:
        """Inductance matrix (c, c) in H of the coils in their iron; symmetric up to the solver's tolerance.

        Raises InputError for a solution that was stored without its linkages.
        """
        return self._air_inductance + self._iron_linkages()[:, : len(self.coils)]

    def flux_density(self, body: str, currents: Currents) -> Array:
        """See `SolvedState.flux_density`.

        Parameters
        ----------
        body
            Name of the body.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            B (3,), T.
        """
        return self.at(currents).flux_density(body)

    def section_flux(self, section: str | Section, currents: Currents) -> SectionFlux:
        """See `SolvedState.section_flux`.

        Parameters
        ----------
        section
            Name of a section of the device file, or any plane.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        SectionFlux
            Flux, area, flux density and error.
        """
        return self.at(currents).section_flux(section)

    def section_flux_density(self, section: str | Section, currents: Currents) -> float:
        """See `SolvedState.section_flux_density`.

        Parameters
        ----------
        section
            Name of a section of the device file, or any plane.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        float
            Flux density, T.
        """
        return self.at(currents).section_flux_density(section)

    def force_on(self, name: str | Sequence[str], currents: Currents) -> Array:
        """See `SolvedState.force_on`.

        Parameters
        ----------
        name
            Name, or names.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            Force (3,), N.
        """
        return self.at(currents).force_on(name)

    def torque_on(self, name: str | Sequence[str], currents: Currents, about: ArrayLike) -> Array:
        """See `SolvedState.torque_on`.

        Parameters
        ----------
        name
            Name, or names.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.
        about
            Point (3,), m.

        Returns
        -------
        Array
            Torque (3,), N m.
        """
        return self.at(currents).torque_on(name, about)

    def flux_linkage(self, currents: Currents) -> Array:
        """See `SolvedState.flux_linkage`.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            Linkages (c,), Wb.
        """
        return self.at(currents).flux_linkage()

    def energy(self, currents: Currents) -> float:
        """See `LinearState.energy`.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        float
            Energy, J.
        """
        return self.at(currents).energy()

    def outlines(self) -> tuple[Outline, ...]:
        """See `SolvedState.outlines`."""
        return self.at(np.zeros(len(self.coils))).outlines()

    def _iron_linkages(self) -> Array:
        """The iron's part of the flux linkages (c, columns), Wb."""
        known = self.iron_linkage is not None or self.state is None
        must_hold, received = "the iron's flux linkages are needed", "a solution read back without them"
        check(known, "inductance", must_hold, received, "solve the device again")
        nothing = np.zeros((len(self.coils), len(self.coils) + self.has_constant))
        return nothing if self.iron_linkage is None else self.iron_linkage


@dataclass(frozen=True, eq=False, repr=False)
class LinearState(SolvedState):
    """A linear solution at currents (c,) in A. Columns of the iron: 1 A in each coil; then all currents off, where
    magnets or a background make a field."""

    solution: LinearSolution

    def energy(self) -> float:
        """Energy in J that the currents have put into the field: half the sum of I L I."""
        return float(0.5 * self.currents @ self.solution.inductance() @ self.currents)

    def coenergy(self) -> float:
        """Co-energy in J: its derivative by a current is that coil's linkage. The co-energy at zero currents is
        left out."""
        own = self.currents @ self.solution.inductance() @ self.currents
        return float(self.currents @ self.flux_linkage() - 0.5 * own)

    @cached_property
    def _air_inductance(self) -> Array:
        return self.solution._air_inductance

    @property
    def _iron_linkage(self) -> Array:
        return self.solution._iron_linkages() @ self.weights


@dataclass(frozen=True, eq=False, repr=False)
class PotentialSolution(SolvedState):
    """Coils and iron at currents (c,) in A, solved for these in the potential form: one column.

    state: nodal potential and largest field strengths. iron_linkage (c,) in Wb: the iron's part of the linkages.
    """

    state: PotentialState
    iron_linkage: Array

    @property
    def _iron_linkage(self) -> Array:
        return self.iron_linkage


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearSolution(PotentialSolution):
    """Coils and saturating iron at currents (c,) in A.

    iron_coenergy in J: the iron's part of the co-energy. Forces, linkages and energies: docs/theory/forces.md.
    """

    iron_coenergy: float

    @property
    def sources(self) -> tuple[str, ...]:
        """There is one: all currents together."""
        return ("these currents",)

    @property
    def iron_points(self) -> Array:
        """Centres (m, 3) of the charged faces, m."""
        return self.state.iron.faces.centres

    def source_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Field and gradient of the one source of a state.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        tuple[Array, Array]
            B (1, n, 3), T, and gradient (1, n, 3, 3), T/m.
        """
        flux, slope = self.field_and_gradient(points)
        return flux[None], slope[None]

    def coenergy(self) -> float:
        """Co-energy in J: its derivative by a current is that coil's linkage, by a displacement it is the force.

        With permanent magnets or a background it contains the co-energy at zero currents.
        """
        linked = 0.5 * self._air_inductance @ self.currents + self._background_linkage
        return float(self.currents @ linked) + self.iron_coenergy

    def energy(self) -> float:
        """Field energy in J, iron included: sum of currents x linkages, less the co-energy."""
        return float(self.currents @ self.flux_linkage()) - self.coenergy()
