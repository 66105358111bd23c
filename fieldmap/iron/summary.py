"""A solved device in numbers: field at points, forces, sections, bodies, and known values of the file beside ours."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.device.model import Device, Reference, Section
from fieldmap.errors import InputError, Problem
from fieldmap.iron.notes import saturation_warnings
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solution import LinearSolution, LinearState, SolvedState
from fieldmap.iron.solvers.nonlinear import NonlinearSolver
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, eq=False, repr=False)
class PointField(Record):
    """B (3,), T, and its gradient (3, 3), T/m, at a point (3,), m."""

    at: Array
    B: Array
    gradient: Array


@dataclass(frozen=True, eq=False, repr=False)
class GroupForce(Record):
    """Force (3,), N, and torque (3,), N m about the origin, on bodies and coils together."""

    names: tuple[str, ...]
    force: Array
    torque: Array


@dataclass(frozen=True, repr=False)
class SectionMean(Record):
    """Mean flux density, T, along the normal of a section, flux, Wb, and area, m^2."""

    section: str
    flux_density: float
    flux: float
    area: float


@dataclass(frozen=True, eq=False, repr=False)
class BodyFlux(Record):
    """Flux density in a body, T: volume mean of |B|, largest |B| of its elements, volume mean of B (3,)."""

    body: str
    mean_magnitude: float
    largest_magnitude: float
    mean: Array


@dataclass(frozen=True, eq=False, repr=False)
class ReferenceComparison(Record):
    """A known value of a device file beside ours, SI units.

    Where it holds for other iron, or for other currents than those of a nonlinear state, `ours` and `deviation` are
    None and `why_not` says why. deviation: ours / reference - 1; tolerance: to which the value is known.
    """

    quantity: str
    at: Array
    currents: Array
    mu_r: float | None
    reference: float
    ours: float | None
    deviation: float | None
    why_not: str
    tolerance: float | None
    source: str


@dataclass(frozen=True, eq=False, repr=False)
class SolutionSummary(Record):
    """What `fieldmap solve` prints. currents: (n_coils,), A, None without coils."""

    device: Device
    nonlinear: bool
    report: SolverReport
    currents: Array | None
    points: tuple[PointField, ...]
    bodies: tuple[BodyFlux, ...]
    forces: tuple[GroupForce, ...]
    sections: tuple[SectionMean, ...]
    references: tuple[ReferenceComparison, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Plain]:
        """The summary as plain Python, SI units."""
        return plain_items(
            device=self.device.name,
            title=self.device.title,
            nonlinear=self.nonlinear,
            coil_names=self.device.coil_names,
            report=self.report,
            currents=self.currents,
            points=self.points,
            bodies=self.bodies,
            forces=self.forces,
            sections=self.sections,
            references=self.references,
            warnings=self.warnings,
        )


def summarise_solution(
    device: Device,
    field: LinearSolution | NonlinearSolver,
    currents: Array | None,
    points: Array | None = None,
    groups: Sequence[Sequence[str]] = (),
    sections: Sequence[Section] | None = None,
    mu_r: float | None = None,
) -> SolutionSummary:
    """The state of a solved device at currents (n_coils,), A, None without coils, in numbers.

    points (n, 3), m: where the field is asked for. groups: names of bodies and coils whose force is asked for, each
    taken together. sections: those of the device file unless given. mu_r: the permeability that was given to all iron
    in the place of the file's.
    """
    amperes = np.zeros(0) if currents is None else np.asarray(currents, dtype=float)
    state = field.at(amperes)
    nonlinear = not isinstance(state, LinearState)
    wanted = np.zeros((0, 3)) if points is None else np.asarray(points, dtype=float).reshape(-1, 3)
    return SolutionSummary(
        device=device,
        nonlinear=nonlinear,
        report=state.report,
        currents=currents,
        points=_points(state, wanted),
        bodies=body_fluxes(state) if nonlinear else (),
        forces=tuple(
            GroupForce(tuple(group), *state.force_and_torque_on(group, np.zeros(3))) for group in groups
        ),
        sections=tuple(
            _section_mean(state, section) for section in (device.sections if sections is None else sections)
        ),
        references=compare_references(device, field, amperes, mu_r),
        warnings=saturation_warnings(state.solution, device, amperes)
        if isinstance(state, LinearState) and currents is not None
        else (),
    )


def _points(state: SolvedState, points: Array) -> tuple[PointField, ...]:
    if not len(points):
        return ()
    return tuple(map(PointField, points, state.field(points), state.gradient(points)))


def _section_mean(state: SolvedState, section: Section) -> SectionMean:
    found = state.section_flux(section)
    return SectionMean(section.name, found.flux_density, found.flux, found.area)


def body_fluxes(state: SolvedState) -> tuple[BodyFlux, ...]:
    """Flux density in every body of a state; none without iron."""
    mesh = state.mesh
    if mesh is None:
        return ()
    size = np.linalg.norm(state.element_flux_density, axis=1)
    corners = mesh.points[mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    found = []
    for index, name in enumerate(mesh.body_names):
        mine = mesh.body == index
        mean = float(volume[mine] @ size[mine] / volume[mine].sum())
        found.append(BodyFlux(name, mean, float(size[mine].max()), state.flux_density(name)))
    return tuple(found)


def compare_references(
    device: Device,
    field: LinearSolution | NonlinearSolver,
    currents: Array,
    mu_r: float | None = None,
) -> tuple[ReferenceComparison, ...]:
    """Every known value of the device's file beside ours. currents (n_coils,), A: of a nonlinear state; a linear
    solution is compared at the currents of each value. mu_r: as for `summarise_solution`."""
    nonlinear = isinstance(field, NonlinearSolver)
    compared = []
    for reference in device.references:
        why_not, ours = _why_not(device, reference, nonlinear, currents, mu_r), None
        if not why_not:
            state, point = field.at(reference.currents), reference.at[None, :]
            ours = component(reference.quantity, state.field(point)[0], state.gradient(point)[0])
        compared.append(
            ReferenceComparison(
                reference.quantity,
                reference.at,
                reference.currents,
                reference.mu_r,
                reference.value,
                ours,
                None if ours is None else ours / reference.value - 1.0,
                why_not,
                reference.tolerance,
                reference.source,
            )
        )
    return tuple(compared)


def component(quantity: str, field: Array, gradient: Array) -> float:
    """One entry of B (3,) or of its gradient (3, 3) by its name: "Bz", "dBz/dx".

    >>> component("dBz/dx", np.zeros(3), np.arange(9.0).reshape(3, 3))
    6.0
    """
    if "/" not in quantity:
        return float(field[_AXES[quantity[1]]])
    return float(gradient[_AXES[quantity[2]], _AXES[quantity[5]]])


def _why_not(
    device: Device, reference: Reference, nonlinear: bool, currents: Array, mu_r: float | None
) -> str:
    if reference.mu_r is not None:
        common = common_mu_r(device, nonlinear, mu_r)
        if not abs(reference.mu_r - common) <= 1e-9 * reference.mu_r:
            return f"linear iron, --mu-r {reference.mu_r:g}"
    if nonlinear and not np.array_equal(reference.currents, currents):
        return "other currents than this state's"
    return ""


def common_mu_r(device: Device, nonlinear: bool, mu_r: float | None = None) -> float:
    """The one relative permeability of all iron; NaN, which equals no reference, if bodies differ or saturate."""
    if mu_r is not None:
        return mu_r
    values = set()
    for body in device.bodies:
        material = device.materials[body.material]
        if material.role == "iron":
            values.add(float("nan") if nonlinear and material.saturates else material.initial_mu_r)
    return values.pop() if len(values) == 1 else float("nan")


def checked_groups(device: Device, groups: Sequence[Sequence[str]], where: str = "groups") -> None:
    """Raise InputError, for all at once, unless every name is that of a body or coil of the device."""
    known = (*(body.name for body in device.bodies), *device.coil_names)
    remedy = "use one of these; several that are taken together stand with commas between"
    problems = [
        Problem(where, f"must be a body or coil of the device: {', '.join(known)}", repr(name), remedy)
        for group in groups
        for name in group or ("",)
        if name not in known
    ]
    if problems:
        raise InputError(*problems)


def named_sections(device: Device, names: Sequence[str], where: str = "sections") -> tuple[Section, ...]:
    """The sections of the device file with these names. Raises InputError, for all at once, for unknown ones."""
    by_name = {section.name: section for section in device.sections}
    listed = ", ".join(by_name) or "the file has no [[section]]"
    problems = [
        Problem(where, f"must be a section of the device file: {listed}", repr(name), "use one of these")
        for name in names
        if name not in by_name
    ]
    if problems:
        raise InputError(*problems)
    return tuple(by_name[name] for name in names)
