"""What a solved state rests on, in words: assumptions, iron beyond saturation, iron beyond its B-H law."""

from __future__ import annotations

from fieldmap.device.model import Device
from fieldmap.field import FieldAtCurrents
from fieldmap.iron.beyond_saturation import bodies_beyond_saturation
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solution import LinearSolution, LinearState, SolvedState
from fieldmap.typing import Array


def saturates(device: Device) -> bool:
    """Whether some body of the device can saturate."""
    return any(device.materials[body.material].saturates for body in device.bodies)


def state_notes(device: Device, state: FieldAtCurrents) -> tuple[str, ...]:
    """What a state of a device rests on: its assumptions, with warnings where linear iron is driven beyond saturation,
    and how far saturating iron is driven."""
    if isinstance(state, LinearState):
        return (*state.assumptions, *saturation_warnings(state.solution, device, state.currents))
    if isinstance(state, SolvedState):
        report = state.report
        driven = f"iron up to {report.largest_flux_density:.2f} T; B-H law: {law_range(report, device)}"
        return (*state.assumptions, driven)
    return tuple(getattr(state, "assumptions", ()))


def saturation_warnings(solution: LinearSolution, device: Device, currents: Array) -> tuple[str, ...]:
    """A warning for every material of linear iron that carries more than it can polarise, with the bodies."""
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
