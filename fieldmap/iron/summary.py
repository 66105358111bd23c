"""A solved device in numbers: field at points, forces, sections, bodies, and comparison with the file's known values.

The design figures of a machine at given currents are its windings, inductances, forces, flux densities and heat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from fieldmap.arguments import check_names, check_positive
from fieldmap.device import read_device
from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.model import Device, Section
from fieldmap.device.tetrahedra import volumes
from fieldmap.field import Currents, coil_currents
from fieldmap.iron.notes import saturates, saturation_warnings
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solution import LinearSolution, LinearState, SolvedState
from fieldmap.iron.solvers.linear import solve_linear
from fieldmap.iron.solvers.nonlinear import NonlinearSolver
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

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
    """Mean flux density, T, along the normal of a section, flux, Wb, area, m^2, and estimated error of the flux, Wb,
    None in the surface form."""

    section: str
    flux_density: float
    flux: float
    area: float
    error: float | None


@dataclass(frozen=True, eq=False, repr=False)
class BodyFlux(Record):
    """Flux density in a body, T: volume mean of |B|, largest |B| of its elements, volume mean of B (3,)."""

    body: str
    mean_magnitude: float
    largest_magnitude: float
    mean: Array


@dataclass(frozen=True, eq=False, repr=False)
class ReferenceComparison(Record):
    """A known value of a device file and the computed one, `ours`, SI units.

    If the known value holds for other iron, or for other currents than those of a nonlinear state, `ours` and
    `deviation` are None and `why_not` says why. deviation: ours / reference - 1; tolerance: of the known value.
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
    """The summary that `fieldmap solve` prints. currents: (n_coils,), A, None without coils."""

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
        own = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "device"}
        device = self.device
        return plain_items(device=device.name, title=device.title, coil_names=device.coil_names, **own)


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

    points (n, 3), m: places of the field. groups: names of bodies and coils; each group gets one force. sections: the
    device file's unless given. mu_r: the permeability that was given to all iron in place of the file's.
    """
    amperes = np.zeros(0) if currents is None else np.asarray(currents, dtype=float)
    state = field.at(amperes)
    nonlinear = not isinstance(state, LinearState)
    wanted = np.reshape(np.asarray(() if points is None else points, dtype=float), (-1, 3))
    warnings: tuple[str, ...] = ()
    if isinstance(state, LinearState) and currents is not None:
        warnings = saturation_warnings(state.solution, device, amperes)
    return SolutionSummary(
        device=device,
        nonlinear=nonlinear,
        report=state.report,
        currents=currents,
        points=tuple(map(PointField, wanted, state.field(wanted), state.gradient(wanted)))
        if len(wanted)
        else (),
        bodies=body_fluxes(state) if nonlinear else (),
        forces=tuple(_force(state, tuple(group)) for group in groups),
        sections=tuple(
            SectionMean(one.name, found.flux_density, found.flux, found.area, found.error)
            for one in (device.sections if sections is None else sections)
            for found in [state.section_flux(one)]
        ),
        references=compare_references(device, field, amperes, mu_r),
        warnings=warnings,
    )


def body_fluxes(state: SolvedState) -> tuple[BodyFlux, ...]:
    """Flux density in every body of a state; none without iron."""
    mesh = state.mesh
    if mesh is None:
        return ()
    size = np.linalg.norm(state.element_flux_density, axis=1)
    volume = volumes(mesh.points, mesh.tets)
    found = []
    for index, name in enumerate(mesh.body_names):
        mine = mesh.body == index
        mean = float(volume[mine] @ size[mine] / volume[mine].sum())
        found.append(BodyFlux(name, mean, float(size[mine].max()), state.flux_density(name)))
    return tuple(found)


def compare_references(
    device: Device, field: LinearSolution | NonlinearSolver, currents: Array, mu_r: float | None = None
) -> tuple[ReferenceComparison, ...]:
    """Compare every known value of the device file with the computed one. currents (n_coils,), A: of a nonlinear state;
    a linear solution is compared at the currents of each value. mu_r: as for `summarise_solution`."""
    nonlinear = isinstance(field, NonlinearSolver)
    compared = []
    for known in device.references:
        ours = off = None
        why_not = ""
        if known.mu_r is not None:
            common = common_mu_r(device, nonlinear, mu_r)
            if not abs(known.mu_r - common) <= 1e-9 * known.mu_r:
                why_not = f"linear iron, --mu-r {known.mu_r:g}"
        if not why_not and nonlinear and not np.array_equal(known.currents, currents):
            why_not = "other currents than this state's"
        if not why_not:
            state, point = field.at(known.currents), known.at[None, :]
            ours = component(known.quantity, state.field(point)[0], state.gradient(point)[0])
            off = ours / known.value - 1.0
        about = (known.quantity, known.at, known.currents, known.mu_r, known.value)
        compared.append(ReferenceComparison(*about, ours, off, why_not, known.tolerance, known.source))
    return tuple(compared)


def component(quantity: str, field: Array, gradient: Array) -> float:
    """One entry of B (3,) or of its gradient (3, 3) by its name: "Bz", "dBz/dx".

    >>> component("dBz/dx", np.zeros(3), np.arange(9.0).reshape(3, 3))
    6.0
    """
    if "/" not in quantity:
        return float(field[_AXES[quantity[1]]])
    return float(gradient[_AXES[quantity[2]], _AXES[quantity[5]]])


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
    """Raise InputError, with a problem for each, for names that are neither a body nor a coil of the device."""
    known = (*(body.name for body in device.bodies), *device.coil_names)
    remedy = "use one of these; several that are taken together stand with commas between"
    must_hold = f"must be a body or coil of the device: {', '.join(known)}"
    check_names(where, [name for group in groups for name in group or ("",)], must_hold, known, remedy)


def named_sections(device: Device, names: Sequence[str], where: str = "sections") -> tuple[Section, ...]:
    """The sections of the device file with these names. Raises InputError, with a problem for each unknown name."""
    by_name = {section.name: section for section in device.sections}
    listed = ", ".join(by_name) or "the file has no [[section]]"
    must_hold = f"must be a section of the device file: {listed}"
    check_names(where, names, must_hold, by_name, "use one of these")
    return tuple(by_name[name] for name in names)


COPPER = 1.724e-8
"""Resistivity of annealed copper at 20 C, ohm m (IEC 60028)."""
FILL = 0.6
"""Share of copper in a winding's section if none is given: usual for round wire."""


@dataclass(frozen=True, repr=False)
class WindingFigures(Record):
    """One winding at a current, A.

    resistance, ohm: as the device states it, otherwise of copper at 20 C (`resistance_is_stated` says which).
    voltage, V, and power, W, of the steady current. current_density: ampere-turns per area of the whole section,
    A/m^2; divide it by the share of copper for the density in the copper. inductance, H: of this winding alone at the
    state, dlambda/di; time_constant, s: inductance over resistance. temperature_rise, K: power times a stated thermal
    resistance; None without one.
    """

    coil: str
    current: float
    resistance: float
    resistance_is_stated: bool
    voltage: float
    power: float
    current_density: float
    inductance: float
    time_constant: float
    temperature_rise: float | None


@dataclass(frozen=True, eq=False, repr=False)
class DesignFigures(Record):
    """A machine at currents (c,), A.

    inductance (c, c), H: derivatives of the flux linkages by the currents at this state. coil_forces: on each winding;
    iron_forces: on each connected piece of iron, named by its bodies; torques about the origin. bodies: flux density
    in each body, none without iron. power: of all windings, W.
    """

    device: str
    currents: Array
    windings: tuple[WindingFigures, ...]
    inductance: Array
    coil_forces: tuple[GroupForce, ...]
    iron_forces: tuple[GroupForce, ...]
    bodies: tuple[BodyFlux, ...]
    power: float
    assumptions: tuple[str, ...]


def winding_length(path: WindingPath) -> float:
    """Length of the middle line, m: arcs at their middle radius, and bars.

    >>> from fieldmap.device.model import CircularCoil
    >>> round(winding_length(CircularCoil("a", 0.02, 0.03, 0.01, 100).winding()), 6)
    0.15708
    """
    turned = 2.0 * path.arcs[:, 4] * 0.5 * (path.arcs[:, 5] + path.arcs[:, 6])
    return float(turned.sum() + 2.0 * path.bars[:, 4].sum())


def copper_resistance(coil: Coil, fill: float = FILL) -> float:
    """Resistance, ohm, of a winding of copper at 20 C: rho N^2 length / (fill section)."""
    path = coil.winding()
    section = fill * path.thickness * path.height
    return COPPER * coil.turns**2 * winding_length(path) / section


def design_figures(
    device: Device | PathLike,
    currents: Currents,
    field: LinearSolution | NonlinearSolver | None = None,
    thermal_resistance: float | None = None,
    fill: float = FILL,
) -> DesignFigures:
    """Figures of a machine at currents, A, for its design: see `DesignFigures`.

    Parameters
    ----------
    device
        The machine, its file, or the name of a shipped one.
    currents
        Currents (c,), A.
    field
        The solution of the device, or its solver of saturating iron. None: a new solver if its iron
        saturates, otherwise a linear solution.
    thermal_resistance
        Thermal resistance of each winding to its surroundings, K/W. The temperature rise is this times the
        power, with the resistance at 20 C.
    fill
        Share of copper in a winding's section, for windings whose resistance the device does not state.

    Returns
    -------
    DesignFigures
        The figures of each winding, the inductances, and the forces.

    Raises
    ------
    InputError
        For currents that do not fit the coils.
    GeometryError, NotConverged
        As the solvers.

    Examples
    --------
    >>> import fieldmap as fm
    >>> figures = design_figures(fm.read_device("loop_and_sphere"), 1.0)
    >>> figures.windings[0].coil, figures.inductance.shape
    ('loop', (1, 1))
    """
    device = read_device(device)
    check_positive("design_figures", fill=fill)
    if thermal_resistance is not None:
        check_positive("design_figures", thermal_resistance=thermal_resistance)
    amperes = np.array(coil_currents(currents, device.coil_names))
    if field is None:
        field = NonlinearSolver(device) if saturates(device) else solve_linear(device)
    state = field.at(amperes)
    if isinstance(field, NonlinearSolver):
        inductance = field.differential_inductance(field.at(amperes))
    else:
        inductance = field.inductance()
    windings = tuple(
        _winding(coil, current, own, thermal_resistance, fill)
        for coil, current, own in zip(device.coils, amperes, np.diag(inductance), strict=True)
    )
    assumptions = ["resistances at 20 C, steady currents"]
    unstated = ", ".join(winding.coil for winding in windings if not winding.resistance_is_stated)
    if unstated:
        assumptions.append(f"resistance of {unstated}: copper in {100 * fill:g} % of the section")
    if thermal_resistance is not None:
        assumptions.append(f"temperature rise: {thermal_resistance:g} K/W of each winding, as given")
    return DesignFigures(
        device=device.name,
        currents=amperes,
        windings=windings,
        inductance=inductance,
        coil_forces=tuple(_force(state, (name,)) for name in device.coil_names),
        iron_forces=tuple(_force(state, names) for names in state.pieces_of_iron),
        bodies=body_fluxes(state),
        power=float(sum(winding.power for winding in windings)),
        assumptions=(*state.assumptions, *assumptions),
    )


def _force(state: SolvedState, names: tuple[str, ...]) -> GroupForce:
    return GroupForce(names, *state.force_and_torque_on(names, np.zeros(3)))


def _winding(
    coil: Coil, current: float, inductance: float, thermal_resistance: float | None, fill: float
) -> WindingFigures:
    path = coil.winding()
    resistance = copper_resistance(coil, fill) if coil.resistance is None else coil.resistance
    power = resistance * float(current) ** 2
    return WindingFigures(
        coil=coil.name,
        current=float(current),
        resistance=resistance,
        resistance_is_stated=coil.resistance is not None,
        voltage=resistance * float(current),
        power=power,
        current_density=abs(coil.turns * float(current)) / (path.thickness * path.height),
        inductance=float(inductance),
        time_constant=float(inductance) / resistance,
        temperature_rise=None if thermal_resistance is None else thermal_resistance * power,
    )
