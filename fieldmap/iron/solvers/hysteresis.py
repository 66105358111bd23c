"""Iron with rate-independent hysteresis (play model) at a sequence of currents: docs/theory/hysteresis.md.

The elements of the potential form have play cells at their points. At a given history of the cells, B is the gradient
by h of a convex function, as without hysteresis. The functional, Newton's method and its line search are therefore the
same as in the potential form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from fieldmap.arguments import check, check_count, check_not_negative
from fieldmap.constants import MU0
from fieldmap.core.play_cells import PlayCells
from fieldmap.device.materials import SaturatingMaterial
from fieldmap.device.model import Device
from fieldmap.errors import NotConverged
from fieldmap.field import Bounds, Currents, coil_currents
from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.potential_form import ConvexForm, Magnetised, PotentialForm
from fieldmap.iron.geometry.checks import geometry_notes
from fieldmap.iron.materials import materials_on
from fieldmap.iron.reaction import DipoleAnswers, ReactionFields, answers_to_sensors, reaction_fields
from fieldmap.iron.report import report_of
from fieldmap.iron.solution import PotentialSolution
from fieldmap.iron.solvers.linear import check_arguments, images_of
from fieldmap.iron.solvers.meshed_device import MeshedDevice
from fieldmap.iron.solvers.nonlinear import StateImage
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class HysteresisMagnetisation(Magnetisation):
    """A `Magnetisation` of one source with hysteresis.

    pinning (l, k): pinning fields of the k play cells in each law, T; weights (k,), their sum 1; remembered
    (e, 4, k, 4): memory of the cells at the points of every element, as in `fieldmap.core.play_cells`.
    """

    pinning: Array
    weights: Array
    remembered: Array

    _last: list[tuple[Array, Array, Array]] = field(default_factory=list, init=False, repr=False)

    def polarisation(self, h: Array, source: int) -> Array:
        """mu0 M (e, 4, 3), remanence of magnets included, at h (e, 4, 3), T; there is one source."""
        return self._response(h)[0]

    def susceptibility(self, h: Array) -> Array:
        """Derivative (e, 4, 6) of mu0 M by h: xx, xy, xz, yy, yz, zz."""
        return self._response(h)[1]

    def _response(self, h: Array) -> tuple[Array, Array]:
        """Polarisation and derivative. The last are kept: residual, tangent and line search use one field in turn."""
        if not self._last or not np.array_equal(self._last[0][0], h):
            tangent = np.empty((*h.shape[:2], 6))
            polarisation = self._polarise(h, None, tangent) + self.remanence[0][:, None]
            self._last[:] = [(h, polarisation, tangent)]
        return self._last[0][1:]

    def after(self, h: Array) -> HysteresisMagnetisation:
        """The same iron after the field h (e, 4, 3)."""
        remembered = np.empty_like(self.remembered)
        self._polarise(h, remembered, None)
        # The step is done: a memory that is kept does not need the last result.
        self._last.clear()
        return replace(self, remembered=remembered)

    def dissipated(self, after: HysteresisMagnetisation, volume: Array) -> float:
        """Loss, T^2 m^3 (over mu0: J), on the path to a later state, for volumes (e,): pinning field times the distance
        by which the polarisation of every cell moved."""
        before, now = (of.remembered[..., 3:] * of.remembered[..., :3] for of in (self, after))
        way = np.linalg.norm(now - before, axis=-1)
        return float(np.einsum("e,eqk,ek,k->", 0.25 * volume, way, self.pinning[self.law], self.weights))

    def _polarise(self, h: Array, after: Array | None, tangent: Array | None) -> Array:
        """Polarisation (e, 4, 3) of the cells at h; fills after (their memory) and tangent (the derivative)."""
        polarisation, (offset, knots, coefficients) = np.empty(h.shape), self.tables.arrays
        law = np.repeat(self.law.astype(float), h.shape[1])
        cells = PlayCells(law, offset.astype(float), knots, coefficients, self.pinning, self.weights)
        before = self.remembered.reshape(len(law), -1, 4)
        cells.respond(np.ascontiguousarray(h.reshape(-1, 3)), before, polarisation, after, tangent)
        return polarisation


class HysteresisForm(PotentialForm):
    """One mesh in the potential form, for iron with hysteresis. Its states interpolate the field between the points of
    an element, because there are play cells only at these points."""

    _inside = ConvexForm._inside


# As in `fieldmap.iron.solvers.nonlinear`: the residual as a fraction of the requested tolerance.
_RESIDUAL_PER_TOLERANCE = 1e-3
_MOST_HALVINGS = 4
# Newton's method starts from an extrapolation of the last step if the cosine between the changes of the currents is at
# least the first number. The last change of the potential is added at most the second number of times.
_ALONG, _FURTHEST = 0.8, 2.0


@dataclass(frozen=True, repr=False)
class Pinning(Record):
    """The distribution of pinning fields in the iron: an assumption, as no device file states it.

    coercive_field: A/m, half the width of the major loop at b = 0 where the anhysteretic law is straight; 0 means none.
    cells: number of play cells for the distribution, which is uniform from 0 to twice the coercive field (so that small
    loops are parabolas, as Rayleigh found, Phil. Mag. 23 (1887) 225); 1: all at the coercive field.

    >>> pinning = Pinning(100.0, cells=5)
    >>> print(pinning.fields.tolist(), float(pinning.fields @ pinning.weights))
    [0.0, 50.0, 100.0, 150.0, 200.0] 100.0
    """

    coercive_field: float
    cells: int = 6

    def __post_init__(self) -> None:
        check_not_negative("Pinning", coercive_field=self.coercive_field)
        check_count("Pinning", cells=self.cells)

    @property
    def fields(self) -> Array:
        """Pinning fields (k,) of the cells, A/m."""
        if self.cells == 1:
            return np.array([self.coercive_field])
        return np.linspace(0.0, 2.0 * self.coercive_field, self.cells)

    @property
    def weights(self) -> Array:
        """Shares (k,) of the cells: the trapezoidal rule."""
        weights = np.ones(self.cells)
        weights[[0, -1]] = 0.5
        return weights / weights.sum()

    @property
    def assumption(self) -> str:
        """The assumption in words."""
        return self.of("")

    def of(self, material: str) -> str:
        """The assumption in words, of one material of several.

        Parameters
        ----------
        material
            Name of the material.

        Returns
        -------
        str
            The words.
        """
        which = f"iron '{material}'" if material else "iron"
        spread = "one cell" if self.cells == 1 else f"{self.cells} cells from 0 to twice that"
        return (
            f"{which}: rate-independent hysteresis, coercive field {self.coercive_field:g} A/m ({spread}), about the "
            "device's B(H) as the anhysteretic law"
        )


@dataclass(frozen=True, eq=False, repr=False)
class IronMemory(Record):
    """History of the iron of one solver: its material with the memory of the play cells, the last potential (n,) and
    currents (c,), and the changes of both in the last step."""

    material: HysteresisMagnetisation
    potential: Array
    currents: Array
    potential_change: Array
    currents_change: Array

    def continued(self, currents: Array) -> Array:
        """Estimate of the potential at other currents: the last step is extrapolated, or, if the currents turn, the
        potential is scaled with them.

        Parameters
        ----------
        currents
            Currents (c,), A.

        Returns
        -------
        Array
            Nodal potential (n,).
        """
        before, now = self.currents_change, currents - self.currents
        if before @ now >= _ALONG * np.linalg.norm(before) * np.linalg.norm(now) > 0.0:
            share = min(float(now @ before) / float(before @ before), _FURTHEST)
            return self.potential + share * self.potential_change
        square = float(self.currents @ self.currents)
        return self.potential * (float(currents @ self.currents) / square if square > 0.0 else 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class HystereticState(PotentialSolution):
    """Coils and iron after one step.

    memory: where the next step begins. loss: hysteresis loss in the step, J. steps: Newton steps. parts: number of
    parts into which the step was divided.
    """

    memory: IronMemory
    loss: float
    steps: int
    parts: int = 1


class HysteresisSolver(MeshedDevice):
    """A device with hysteresis, meshed and assembled once.

    Parameters
    ----------
    device
        The device, without a background field.
    pinning
        The pinning of all saturating materials. None: each has its own `coercive_field`, as the device file
        states it, with six cells. Magnets and linear iron have no pinning.
    refinement
        Divides the mesh sizes of the device file.

    Raises
    ------
    GeometryError, InputError
        As `fieldmap.solve`.

    Example::

        solver = HysteresisSolver(fieldmap.read_device("drive_unit"), Pinning(100.0), refinement=0.5)
        memory = solver.demagnetised
        for currents in sequence:
            state = solver.step(currents, memory)
            memory = state.memory
    """

    _form_class, _many_solutions = HysteresisForm, False

    def __init__(self, device: Device, pinning: Pinning | None = None, refinement: float = 1.0) -> None:
        where, must_hold = f"device '{device.name}'", "a device without [background] for iron with hysteresis"
        remedy = "leave it out, or solve without"
        check(device.background is None, where, must_hold, "a background field", remedy)
        super().__init__(device, refinement, None, "auto")
        self.pinning, self._notes = pinning, geometry_notes(device)

    def with_pinning(self, pinning: Pinning | None) -> HysteresisSolver:
        """The same device and mesh with other pinning.

        Parameters
        ----------
        pinning
            The pinning; None for the materials' own.

        Returns
        -------
        HysteresisSolver
            The solver.
        """
        other = copy(self)
        other.pinning = pinning
        other.__dict__.pop("demagnetised", None)
        return other

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The assumptions of every state, in words."""
        if self.pinning is not None:
            return (self.pinning.assumption, *self._notes)
        return (*(pinning.of(name) for name, pinning in self._pinnings.items()), *self._notes)

    @property
    def _pinnings(self) -> dict[str, Pinning]:
        """The pinning by name of the saturating material."""
        used = {body.material: self.device.materials[body.material] for body in self.device.bodies}
        soft = {name: material for name, material in used.items() if isinstance(material, SaturatingMaterial)}
        if self.pinning is not None:
            return dict.fromkeys(soft, self.pinning)
        return {name: Pinning(material.coercive_field) for name, material in soft.items()}

    @cached_property
    def demagnetised(self) -> IronMemory:
        """The iron without currents and without history."""
        materials, plain = materials_on(self.device, self._iron.mesh), self._material
        any_pinning = self.pinning or Pinning(0.0)
        without = np.zeros(any_pinning.cells)
        pinning = [self._pinnings[one.name].fields if one.saturates else without for one in materials]
        remembered = np.zeros((len(plain.law), 4, any_pinning.cells, 4))
        cells = MU0 * np.array(pinning), any_pinning.weights, remembered
        material = HysteresisMagnetisation(plain.law, plain.tables, plain.remanence, *cells)
        nothing, coils = np.zeros(self._form.elements.count), np.zeros(len(self.device.coils))
        return IronMemory(material, nothing, coils, nothing, coils)

    images: ClassVar[tuple[StateImage, ...]] = ()
    """Empty: the image of a path is not known without a solve."""

    def energy_operator(self, memory: IronMemory) -> Callable[[Array], Array]:
        """The tangent of iron and air at a state, with the memory of its cells.

        Parameters
        ----------
        memory
            The memory of the state.

        Returns
        -------
        Callable[[Array], Array]
            A function of nodal potentials (n, k): symmetric and positive.
        """
        return self._energy_operator(memory.currents, memory.potential, memory.material)

    def reaction_in(self, box: Bounds, share: float = 2e-3) -> ReactionFields | None:
        """The reaction of iron that was never magnetised to magnets in a box, to first order in their moments and by
        the anhysteretic law.

        Parameters
        ----------
        box
            Lower and upper corner (3,) of the workspace, m; it holds no iron.
        share
            Wanted error: see `fieldmap.iron.reaction.reaction_fields`.

        Returns
        -------
        ReactionFields | None
            The fields of the reaction; None for iron as permeable as air.

        Raises
        ------
        NotConverged
            If the iron cannot be solved.
        """
        return reaction_fields(self._untouched, self.surface, box, share, images=images_of(self._iron))

    def answers_to_sensors(self) -> DipoleAnswers | None:
        """As `NonlinearSolver.answers_to_sensors`, of iron that was never magnetised, by the anhysteretic law."""
        sensors = self.device.sensors
        return answers_to_sensors(self._untouched, self.surface, sensors) if sensors else None

    @property
    def _untouched(self) -> Magnetised:
        return self.magnetised_at(np.zeros(len(self.device.coils)), np.zeros(self._form.elements.count))

    def project(self, basis: Array, air: Array | None = None) -> GalerkinModel:
        """The iron on a basis of nodal potentials, with its play cells: as `NonlinearSolver.project`."""
        material = self.demagnetised.material
        return replace(super().project(basis, air), pinning=material.pinning, shares=material.weights)

    def magnetised(
        self, memory: IronMemory, currents: Array, potentials: Array
    ) -> Iterator[tuple[Array, Array]]:
        """The iron's polarisation along a path that is solved already.

        Parameters
        ----------
        memory
            The memory of the state where the path begins.
        currents
            Currents (s, c), A, at the ends of the steps.
        potentials
            Nodal potentials (s, n) there.

        Yields
        ------
        tuple of Array
            At the end of each step the polarisation (p, 3), T, at the points of `project`, without the remanence of
            magnets, and its derivative (p, 6) by mu0 H with the memory before the step: xx, xy, xz, yy, yz, zz.
        """
        material, elements = memory.material, self._form.elements
        for amperes, potential in zip(currents, potentials, strict=True):
            field = self.coil_field(amperes)
            h = elements.strength_at_points(potential[:, None], field, material)[0]
            polarisation = material.polarisation(h, 0) - material.remanence[0][:, None]
            yield polarisation.reshape(-1, 3), material.susceptibility(h).reshape(-1, 6)
            material = material.after(h)

    def step(
        self,
        currents: Currents,
        memory: IronMemory,
        tolerance: float = 1e-3,
        near: HystereticState | None = None,
    ) -> HystereticState:
        """The state after a straight path from the currents of `memory`.

        The cells move once in a step: currents that turn back must do so between steps. Where Newton's method fails,
        the step is halved, up to four times.

        Parameters
        ----------
        currents
            Currents (c,), A.
        memory
            The memory of the state where the path begins, or `demagnetised`.
        tolerance
            Bounds the algebraic error.
        near
            A state of this device that is likely to be close, where Newton's method begins. Its history has no
            effect.

        Returns
        -------
        HystereticState
            The state, with the memory from which the next step goes on.

        Raises
        ------
        InputError
            For bad arguments.
        NotConverged
        """
        values = np.array(coil_currents(currents, self.device.coil_names))
        check_arguments("step", tolerance)
        residual = tolerance * _RESIDUAL_PER_TOLERANCE
        start = memory.continued(values) if near is None else near.memory.potential
        if not np.array_equal(start, memory.potential):
            try:
                return self._at(values, memory, residual, start)
            except NotConverged:
                pass
        return self._step(values, memory, residual, _MOST_HALVINGS)

    def _step(self, currents: Array, memory: IronMemory, residual: float, halvings: int) -> HystereticState:
        try:
            return self._at(currents, memory, residual, memory.potential)
        except NotConverged:
            if halvings == 0:
                raise
        first = self._step(0.5 * (currents + memory.currents), memory, residual, halvings - 1)
        second = self._step(currents, first.memory, residual, halvings - 1)
        both = {name: getattr(first, name) + getattr(second, name) for name in ("loss", "steps", "parts")}
        return replace(second, **both)

    def _at(self, currents: Array, memory: IronMemory, residual: float, start: Array) -> HystereticState:
        field = self.coil_field(currents)
        elements, before = self._form.elements, memory.material
        state = self._form.solve(before, field, residual, start[:, None])
        potential = state.potential[:, 0]
        h = elements.strength_at_points(state.potential, field, before)[0]
        polarisation, after = before.polarisation(h, 0), before.after(h)
        report, device = report_of(self._form, state.iron, {}, self.assumptions), self.device
        about = (device.coils, currents, self._iron.mesh, state.iron, np.ones(1), report, device.sections)
        changes = (potential - memory.potential, currents - memory.currents)
        now = IronMemory(after, potential, currents, *changes)
        loss = before.dissipated(after, elements.volume) / MU0
        iron = (state, self._linkage(polarisation), now, loss, state.iron.iterations)
        return HystereticState(*about, *iron, bounds=device.bounds)

    def _linkage(self, polarisation: Array) -> Array:
        """Flux linkages (c,), Wb, of a polarisation (e, 4, 3), T: docs/theory/forces.md (5)."""
        unit = self._form.elements.coil_field_at_points(self._unit)
        weight = 0.25 * self._form.elements.volume / MU0
        return np.einsum("e,ceqd,eqd->c", weight, unit, polarisation, optimize=True)
