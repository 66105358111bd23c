"""Notes on a solved state, in words: assumptions, iron beyond saturation, iron beyond its B-H law.

A linear solution knows no saturation: the notes name linear iron that carries more than iron can. Before a solve they
list the contents of a device: bodies with their volumes, coils, and the assumptions of its material laws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.materials import Material
from fieldmap.device.model import Device
from fieldmap.device.tetrahedra import longest_edge, volumes
from fieldmap.field import FieldAtCurrents
from fieldmap.iron.geometry.checks import check_geometry
from fieldmap.iron.geometry.solids import body_solid, own_mesh
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solution import LinearSolution, LinearState, SolvedState
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class BodyContents(Record):
    """One body: volume, m^3; mesh_size, m; number of parts; axis (3,): the common axis of their shapes, or None."""

    name: str
    material: str
    volume: float
    mesh_size: float
    parts: int
    axis: Array | None


@dataclass(frozen=True, eq=False, repr=False)
class CoilContents(Record):
    """One coil: kind, the name of its class; centre (3,), m; axis (3,), a unit vector, about which positive current
    runs counter-clockwise at polarity +1; height, m; resistance, ohm; inductance, H, if stated."""

    name: str
    kind: str
    turns: float
    polarity: int
    centre: Array
    axis: Array
    height: float
    resistance: float | None
    inductance: float | None


@dataclass(frozen=True, eq=False, repr=False)
class DeviceContents(Record):
    """The contents of a device with sound geometry, as `fieldmap check` lists them."""

    device: Device
    bodies: tuple[BodyContents, ...]
    coils: tuple[CoilContents, ...]
    assumptions: tuple[str, ...]

    def to_dict(self) -> dict[str, Plain]:
        """The contents as plain Python, SI units."""
        device = self.device
        return plain_items(
            device=device.name,
            title=device.title,
            source=device.source,
            bodies=self.bodies,
            coils=self.coils,
            payload=device.payload,
            driver=device.driver,
            workspace=device.workspace,
            references=len(device.references),
            assumptions=self.assumptions,
        )


def device_contents(device: Device) -> DeviceContents:
    """Check the geometry of a device and list its contents. Raises GeometryError.

    >>> import fieldmap as fm
    >>> (sphere,) = device_contents(fm.read_device("loop_and_sphere")).bodies
    >>> f"{sphere.name}: {1e6 * sphere.volume:.3f} cm^3"
    'sphere: 4.189 cm^3'
    """
    check_geometry(device)
    bodies = []
    for body in device.bodies:
        if body.has_own_mesh:
            mesh = own_mesh(body)
            # In a sound device the tetrahedra of a mesh do not overlap.
            volume, size = float(volumes(*mesh).sum()), longest_edge(*mesh)
        else:
            # Solids are built in mm.
            volume, size = 1e-9 * float(body_solid(body).mass), body.mesh_size or 0.0
        axes = [np.asarray(part.placement.rotation)[:, 2] for part in body.parts]
        axis = axes[0] if all(np.allclose(other, axes[0], atol=1e-9) for other in axes) else None
        bodies.append(BodyContents(body.name, body.material, volume, size, len(body.parts), axis))
    coils = []
    for coil in device.coils:
        place, kind = coil.placement, (coil.name, type(coil).__name__, coil.turns, coil.polarity)
        winding = (coil.height, coil.resistance, coil.inductance)
        coils.append(CoilContents(*kind, place.position, place.rotation[:, 2], *winding))
    payload = () if device.payload is None else device.payload.assumptions
    changed = (device.changed,) if device.changed else ()
    return DeviceContents(device, tuple(bodies), tuple(coils), _saturation_laws(device) + payload + changed)


def _saturation_laws(device: Device) -> tuple[str, ...]:
    """The laws of the saturating iron in use, with their initial permeability and what holds outside their range."""
    laws = []
    for name, material in device.materials.items():
        if material.saturates and name in {body.material for body in device.bodies}:
            words = material.description
            # A formula states its initial permeability itself.
            initial = "" if "initial mu_r" in words else f"; initial mu_r {material.initial_mu_r:.0f}"
            laws.append(f"iron '{name}': {words}{initial}")
    return tuple(laws)


WORTH_SAYING = 0.01
"""Least share of a body's volume worth a note: at sharp edges |B| grows without bound as the mesh is refined."""

MOST_OF_ANY_IRON = 2.45
"""Polarisation of saturated iron-cobalt, T, the largest of any known material (Bozorth, Ferromagnetism, ch. 6)."""


@dataclass(frozen=True, repr=False)
class BodyBeyondSaturation(Record):
    """A body of linear iron in which |B| exceeds the largest polarisation its material can have.

    most: that polarisation, T; largest: |B| of the element with most, T; share: of the body's volume above `most`.
    """

    body: str
    material: str
    most: float
    largest: float
    share: float


def largest_polarisation(material: Material) -> float:
    """The polarisation B - mu0 H, T, that a law ends with or tends to. For a material without a law, or with one that
    never saturates, it is `MOST_OF_ANY_IRON`.

    >>> from fieldmap.device.model import Froehlich
    >>> largest_polarisation(Froehlich("iron", mu_r=1000.0, saturation=1.5))
    1.5
    """
    most = material.largest_polarisation
    return most if np.isfinite(most) else MOST_OF_ANY_IRON


def bodies_beyond_saturation(
    solution: LinearSolution, device: Device, currents: ArrayLike
) -> tuple[BodyBeyondSaturation, ...]:
    """Bodies of a linear solution with |B| above the largest polarisation of their material. The answer of linear iron
    does not hold there: solve a nonlinear state.

    |B| is compared in place of the polarisation, because mu0 H is small against B in soft iron.

    Parameters
    ----------
    solution
        The solution of linear iron.
    device
        The device that was solved.
    currents
        Currents (c,), A.

    Returns
    -------
    tuple[BodyBeyondSaturation, ...]
        One entry for every body that exceeds it in over a hundredth of its volume (of its surface, in the
        surface form).

    Examples
    --------
    >>> import fieldmap as fm
    >>> device = fm.read_device("loop_and_sphere")
    >>> unit = fm.solve_linear(device)
    >>> bodies_beyond_saturation(unit, device, [1.0]), len(bodies_beyond_saturation(unit, device, [1e6]))
    ((), 1)
    """
    samples = solution.flux_density_samples(np.asarray(currents, dtype=float))
    found = []
    for body in device.bodies:
        material = device.materials[body.material]
        if material.role != "iron" or body.name not in samples.body_names:
            continue
        mine = samples.body == samples.body_names.index(body.name)
        most = largest_polarisation(material)
        weight = samples.weight[mine]
        share = float(weight[samples.size[mine] > most].sum() / weight.sum())
        if share > WORTH_SAYING:
            found.append(
                BodyBeyondSaturation(body.name, material.name, most, float(samples.size[mine].max()), share)
            )
    return tuple(found)


def saturates(device: Device) -> bool:
    """Whether some body of the device can saturate."""
    return any(device.materials[body.material].saturates for body in device.bodies)


def state_notes(device: Device, state: FieldAtCurrents) -> tuple[str, ...]:
    """Notes on a state of a device: its assumptions, warnings where linear iron is driven beyond saturation, and how
    far saturating iron is driven."""
    if isinstance(state, LinearState):
        return (*state.assumptions, *saturation_warnings(state.solution, device, state.currents))
    if isinstance(state, SolvedState):
        report = state.report
        driven = f"iron up to {report.largest_flux_density:.2f} T; B-H law: {law_range(report, device)}"
        return (*state.assumptions, driven)
    return tuple(getattr(state, "assumptions", ()))


def saturation_warnings(solution: LinearSolution, device: Device, currents: Array) -> tuple[str, ...]:
    """A warning for every material of linear iron with |B| above its largest polarisation, with the bodies."""
    warnings: dict[str, str] = {}
    for found in sorted(bodies_beyond_saturation(solution, device, currents), key=lambda body: -body.largest):
        first = (
            f"warning: linear iron does not saturate: up to {found.largest:.3g} T, while '{found.material}' polarises "
            f"{found.most:.3g} T at most; above that are"
        )
        share = f" {100 * found.share:.3g} % of '{found.body}'"
        before = warnings.get(found.material, "")
        warnings[found.material] = f"{before},{share}" if before else first + share
    return tuple(
        f"{text}. Such an answer does not hold: --nonlinear follows a B-H law" for text in warnings.values()
    )


def law_range(report: SolverReport, device: Device) -> str:
    """How many elements lie outside the range of their B-H law."""
    if not saturates(device):
        return "none: all iron of this device is linear"
    if not report.beyond_table and not report.below_table:
        return "no element leaves the range of its points or formula"
    words = []
    for count, side in (
        (report.below_table, "below its first point"),
        (report.beyond_table, "above its last"),
    ):
        share = 100 * count / report.tetrahedra
        words.append(f"{count:,} elements ({share:.3g} %) {side}" if count else f"none {side}")
    return f"{', '.join(words)}; there its stated extensions hold"
