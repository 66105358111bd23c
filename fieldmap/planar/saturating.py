"""A planar device with saturating iron at given currents: the energy of its triangles, and Newton's method."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from fieldmap.arguments import check
from fieldmap.device.materials import SaturatingMaterial
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.field import Currents
from fieldmap.iron.elements.bh_law import LawTables, law_tables
from fieldmap.planar import solution
from fieldmap.planar.boundary_operator import BoundaryOperator
from fieldmap.planar.conductors import coil_vector_potential, complex_points
from fieldmap.planar.geometry import check_planar_geometry, inside
from fieldmap.planar.linear import air_operator, normal_moments, panel_size, planar_report
from fieldmap.planar.mesh import Outline, make_outline, triangulate
from fieldmap.planar.model import PlanarDevice
from fieldmap.records import Record
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class IronTriangles(Record):
    """points (n,), the outline's nodes first; triangles (t, 3) counter-clockwise, body (t,) of each; area (t,) in m2;
    slopes (t, 3): gradients of the hat functions as complex numbers, 1/m; tables: the laws of the bodies."""

    points: Complex
    triangles: Indices
    body: Indices
    area: Array
    slopes: Complex
    tables: LawTables

    def gradient(self, potential: Array) -> Complex:
        """dA/dx + i dA/dz = B_z - i B_x in each triangle (t,), T, for potentials (n,) in T m."""
        return np.asarray((potential[self.triangles] * self.slopes).sum(axis=1))

    def energy(self, potential: Array) -> float:
        """Integral over the iron of the integral of h over b, T2 m2."""
        density = field_strength(self.tables, self.body, np.abs(self.gradient(potential)))[1]
        return float(self.area @ density)

    def derivatives(self, potential: Array) -> tuple[Array, csc_array]:
        """First (n,) and second (n, n) derivatives of the energy."""
        gradient = self.gradient(potential)
        size = np.abs(gradient)
        h, _, tangent = field_strength(self.tables, self.body, size)
        chord = np.divide(h, size, out=tangent.copy(), where=size > 1e-30)
        along = np.divide(gradient, size, out=np.zeros_like(gradient), where=size > 1e-30)
        parallel = (along.conj()[:, None] * self.slopes).real
        first = (self.area * h)[:, None] * parallel
        residual = np.zeros(len(self.points))
        np.add.at(residual, self.triangles, first)
        across = (self.slopes[:, :, None].conj() * self.slopes[:, None, :]).real
        second = chord[:, None, None] * across
        second += (tangent - chord)[:, None, None] * parallel[:, :, None] * parallel[:, None, :]
        second *= self.area[:, None, None]
        rows = np.repeat(self.triangles, 3, axis=1).ravel()
        columns = np.tile(self.triangles, (1, 3)).ravel()
        count = len(self.points)
        return residual, csc_array(coo_array((second.ravel(), (rows, columns)), shape=(count, count)))


def iron_triangles(outline: Outline, tables: LawTables, size: float) -> IronTriangles:
    """Triangles of all bodies on the outline's own nodes."""
    points, triangles, body = [outline.nodes], [], []
    count = len(outline.nodes)
    for k, panels in enumerate(outline.bodies):
        ring = panels[:, 0]
        places, corners = triangulate(outline.nodes[ring], size)
        inner = len(places) - len(ring)
        numbers = np.concatenate([ring, count + np.arange(inner)])
        points.append(places[len(ring) :])
        triangles.append(numbers[corners])
        body.append(np.full(len(corners), k))
        count += inner
    everything, indices = np.concatenate(points), np.concatenate(triangles)
    a, b, c = everything[indices].T
    area = 0.5 * ((b - a).conj() * (c - a)).imag
    slopes = 1j * np.stack([c - b, a - c, b - a], axis=1) / (2 * area[:, None])
    return IronTriangles(everything, indices, np.concatenate(body), area, slopes, tables)


_BISECTIONS = 20
_NEWTON_STEPS = 6


def field_strength(tables: LawTables, law: Indices, b: Array) -> tuple[Array, Array, Array]:
    """h = mu0 H (n,), the integral of h over b from 0 (n,), and dh/db (n,), at b (n,) >= 0; all with h and b in T.

    Bisection on 0 <= h <= b / smallest chord, then Newton's method, clipped to the bracket. b(h) rises everywhere.
    """
    low, high = np.zeros_like(b), b.copy()
    while np.any(short := tables.flux_density(high, law)[0] < b):
        high[short] *= 2.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = tables.flux_density(middle, law)[0] < b
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    h = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        value, slope = tables.flux_density(h, law)
        h = np.clip(h - (value - b) / slope, low, high)
    return h, h * b - tables.integral(h, law), 1.0 / tables.flux_density(h, law)[1]


_MOST_STEPS = 60
_MOST_HALVINGS = 40


@dataclass(frozen=True, eq=False, repr=False)
class Balance(Record):
    """Energy of iron and air in terms of the total vector potential u (n,) at the points of the triangles, T m.

    The first m points are the outline's nodes. air: operator of the air; stiffness (m, m): its energy matrix at the
    nodes; load (m,): linear terms of conductors and walls; coil (m,): the conductors' own potential at the nodes; wall
    (k,): the reaction at the walls' nodes.
    """

    iron: IronTriangles
    air: BoundaryOperator
    stiffness: Array
    load: Array
    coil: Array
    wall: Array

    def energy(self, u: Array) -> float:
        """The functional, T2 m2."""
        nodes = u[: len(self.coil)]
        reaction = nodes - self.coil
        return float(self.iron.energy(u) + 0.5 * reaction @ self.stiffness @ reaction + self.load @ nodes)

    def derivatives(self, u: Array) -> tuple[Array, csc_array]:
        """First derivatives (n,), and the iron's part of the second; the air's is `stiffness`."""
        residual, second = self.iron.derivatives(u)
        nodes = len(self.coil)
        residual[:nodes] += self.stiffness @ (u[:nodes] - self.coil) + self.load
        return residual, second


def minimise(balance: Balance, tolerance: float) -> tuple[Array, tuple[float, ...]]:
    """Potential (n,) at the minimum, and the residuals of the steps, relative to the drive of conductors and walls."""
    u = np.zeros(len(balance.iron.points))
    scale = float(np.linalg.norm(balance.load) + np.linalg.norm(balance.stiffness @ balance.coil)) or 1.0
    residuals = []
    for _ in range(_MOST_STEPS):
        residual, second = balance.derivatives(u)
        residuals.append(float(np.linalg.norm(residual)) / scale)
        if residuals[-1] <= tolerance:
            return u, tuple(residuals)
        step = -_solve(balance.stiffness, second, residual)
        energy, slope, share = balance.energy(u), float(residual @ step), 1.0
        for _ in range(_MOST_HALVINGS):
            moved = u + share * step
            # The last steps change the energy by less than its rounding.
            if balance.energy(moved) <= energy + 1e-4 * share * slope + 1e-12 * abs(energy):
                break
            share *= 0.5
        u = moved
    must_hold = f"the residual must fall to {tolerance:g}"
    received = f"{residuals[-1]:.3g} after {_MOST_STEPS} steps"
    problem = Problem("solve_planar_state", must_hold, received, "raise the tolerance, or lower the currents")
    raise NotConverged(problem, residuals=tuple(residuals))


def _solve(stiffness: Array, second: csc_array, right: Array) -> Array:
    """Solve with the inner points eliminated: sparse inside, dense on the outline."""
    nodes = len(stiffness)
    dense = stiffness + second[:nodes, :nodes].toarray()
    if len(right) == nodes:
        return np.asarray(cho_solve(cho_factor(dense), right))
    coupling = second[nodes:, :nodes].toarray()
    inner = splu(csc_array(second[nodes:, nodes:]))
    spread = inner.solve(np.column_stack([coupling, right[nodes:]]))
    dense -= coupling.T @ spread[:, :-1]
    outline = cho_solve(cho_factor(0.5 * (dense + dense.T)), right[:nodes] - coupling.T @ spread[:, -1])
    return np.concatenate([outline, spread[:, -1] - spread[:, :-1] @ outline])


@dataclass(frozen=True, eq=False, repr=False)
class PlanarState(solution.PlanarFieldAtCurrents):
    """Saturating iron at fixed currents (n_coils,), A.

    reaction: vector potential of iron and walls, without the conductors', at the nodes of the air's operator, T m.
    iron and potential: the triangles and the total vector potential at their points.
    """

    air: BoundaryOperator
    reaction: Array
    iron: IronTriangles
    potential: Array
    report: solution.PlanarReport

    def at(self, currents: Currents) -> PlanarState:
        """This state.

        Parameters
        ----------
        currents
            The state's currents (n_coils,), A.

        Returns
        -------
        PlanarState
            The state.

        Raises
        ------
        InputError
            For other currents.
        """
        same = np.array_equal(solution.planar_currents(self.device, currents), self.currents)
        own = f"{self.currents.tolist()} A"
        check(same, "PlanarState(currents)", own, repr(currents), "solve them anew")
        return self

    def derivatives(self, points: ArrayLike, currents: Currents | None = None) -> Complex:
        """f = B_x - i B_z and its first two derivatives by x + i z.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.
        currents
            None, or the state's own currents, as for linear iron.

        Returns
        -------
        Complex
            Derivatives (3, n), T, T/m and T/m^2.

        Raises
        ------
        InputError
            For currents other than the state's, and for points in iron, in conductors or outside the walls.
        """
        if currents is not None:
            self.at(currents)
        places = solution.field_places(self.device, points)
        for body in self.device.bodies:
            if inside(places, complex_points(body.corners)).any():
                must = "points outside the iron; iron_flux_density has the field inside"
                raise InputError.of("PlanarState(points)", must, f"points in {body.name}", "move them")
        total = solution.conductor_derivatives(self.device, self.currents, places)
        return np.asarray(-1j * (total + solution.harmonic_derivatives(self.air, self.reaction, places)))

    def iron_flux_density(self, body: str) -> tuple[Array, Array]:
        """Flux density in a body's triangles.

        Parameters
        ----------
        body
            Name of the body.

        Returns
        -------
        tuple[Array, Array]
            Middles (t, 2), m, and flux density (t, 2) of (B_x, B_z), T.
        """
        names = [known.name for known in self.device.bodies]
        known = f"one of {', '.join(names)}"
        check(body in names, "PlanarState(body)", known, repr(body), "choose one of them")
        mine = self.iron.body == names.index(body)
        middle = self.iron.points[self.iron.triangles[mine]].mean(axis=1)
        gradient = self.iron.gradient(self.potential)[mine]
        return np.column_stack([middle.real, middle.imag]), np.column_stack([-gradient.imag, gradient.real])


# Grading of the panels, gentler than in the linear model, because the triangles have to match the panels.
_GRADING = 2


def solve_planar_state(
    device: PlanarDevice, currents: Currents, size: float | None = None, tolerance: float = 1e-9
) -> PlanarState:
    """Solve a planar device whose iron saturates, at given currents.

    Only the iron is filled with triangles, of first order; the air is exact. Method: docs/theory/planar.md.

    Parameters
    ----------
    device
        The device.
    currents
        Currents (n_coils,), A.
    size
        Longest panel of iron and walls, and largest triangle inside the iron, m; a sixtieth of the device's
        extent unless given.
    tolerance
        Tolerance of the residual, relative to its size without the iron's response.

    Returns
    -------
    PlanarState
        The state.

    Raises
    ------
    GeometryError
        Where parts do not fit together or the iron is thinner than its panels are long.
    InputError
        For arguments out of range, and for flux barriers or magnets.
    NotConverged
        With the residuals.

    Examples
    --------
    >>> from fieldmap.planar import read_planar_device, solve_planar_state
    >>> state = solve_planar_state(read_planar_device("planar_drive_unit"), [1000.0, 1000.0], size=0.02)
    >>> print(f"{1e3 * state.gradient([[0.0, -0.1]])[0, 1, 1]:.1f} mT/m")
    2.0 mT/m
    """
    started = time.process_time()
    check_planar_geometry(device)
    for body in device.bodies:
        if device.materials[body.material].role != "iron":
            where = f"solve_planar_state, body {body.name}"
            remedy = "use solve_planar, or walls instead of flux barriers"
            raise InputError.of(where, "must be soft iron", f"material {body.material}", remedy)
    remedy = "use solve_planar for coils alone"
    check(len(device.bodies) > 0, "solve_planar_state", "a device with iron", "none", remedy)
    amperes = solution.planar_currents(device, currents)
    outline, iron, air = _meshed(device, panel_size(device, size))
    balance = _balance(device, outline, iron, air, amperes)
    potential, residuals = minimise(balance, tolerance)
    notes = _material_assumptions(device)
    report = planar_report(device, outline, len(iron.points), started, notes, residuals)
    reaction = np.concatenate([potential[: len(outline.nodes)] - balance.coil, balance.wall])
    return PlanarState(device, amperes, balance.air, reaction, iron, potential, report)


# Kept for states of one device at several currents, one after the other. The key is the object: a device never changes.
@lru_cache(maxsize=1)
def _meshed(device: PlanarDevice, size: float) -> tuple[Outline, IronTriangles, BoundaryOperator]:
    """Outline, triangles of the iron, and operator of the air at a size, m."""
    outline = make_outline(device, size, _GRADING)
    tables = law_tables([device.materials[body.material] for body in device.bodies])
    return outline, iron_triangles(outline, tables, size), air_operator(outline)


def _material_assumptions(device: PlanarDevice) -> list[str]:
    notes = set()
    for body in device.bodies:
        material = device.materials[body.material]
        law = f"constant relative permeability {material.initial_mu_r:g}"
        if isinstance(material, SaturatingMaterial):
            law = f"{material.description}; {material.left_out}"
        notes.add(f"iron of {body.name}: {law}")
    return sorted(notes)


def _balance(
    device: PlanarDevice, outline: Outline, iron: IronTriangles, air: BoundaryOperator, amperes: Array
) -> Balance:
    """Everything that does not change with the iron's state, at these currents."""
    count = len(outline.nodes)
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
