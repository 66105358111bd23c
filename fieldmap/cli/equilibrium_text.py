"""The answer of `fieldmap equilibrium`, for people."""

from typing import Any

import numpy as np

from fieldmap.cli.fields import currents_text
from fieldmap.cli.printing import (
    assumption_lines,
    facts,
    heading,
    millimetres,
    print_page,
    table,
    without_noise,
)


def print_answer(answer: dict[str, Any]) -> None:
    """Print an answer of `fieldmap.cli.balance`."""
    special = _lift_rows(answer) if "lift_current" in answer else _balance_rows(answer)
    stiffness = without_noise(answer["stiffness"])
    lines = [(axis, *(f"{k:+.4g}" for k in stiffness[i])) for i, axis in enumerate("xyz")]
    directions = None
    if "stable" in answer:
        directions = table(("direction (x, y, z)", "stiffness N/m", "stable"), _directions(answer))
    print_page(
        heading(answer["source"], answer["kind"]),
        facts(_common_rows(answer) + special),
        table(("stiffness, N/m", "x", "y", "z"), lines),
        directions,
        _states_table(answer) if answer.get("states") else None,
        facts(assumption_lines(answer["assumptions"])),
    )


def _common_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    mass, weight, moment = 1e3 * answer["mass"], 1e3 * answer["weight"], answer["moment_magnitude"]
    offset = 1e3 * answer["magnet_offset"]
    rows = [
        ("payload", f"{mass:.4g} g (weight {weight:.4g} mN), moment {moment:.4g} A m2"),
        ("currents", currents_text(answer["coil_names"], answer["currents"])),
        ("magnet's centre", millimetres(answer["position"])),
    ]
    if answer["has_sensor"]:
        frame = f"in the thesis's frame (magnet_offset {offset:g} mm)"
        rows.append(("sensor reading", f"{answer['sensor_mm'] + 0.0:.3f} mm {frame}"))
    field = ", ".join(f"{1e3 * value:.4g}" for value in without_noise(answer["field"]))
    return [*rows, ("field there", f"({field}) mT")]


def _balance_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    report, stiffness = answer["report"], np.linalg.norm(answer["stiffness"])
    turned = "up" if answer["moment"][2] > 0 else "down"
    left = np.linalg.norm(answer["force_residual"]) / answer["weight"]
    rows = [
        ("moment", f"{turned}, {answer['angle_to_field_deg']:.2f} degrees from the field"),
        ("residual", f"{left:.1e} of the weight; {report.starts} starts, {report.evaluations} field points"),
        (
            "trace",
            f"{answer['trace'] / stiffness:.1e} of the stiffness (0 for a fixed dipole, below 0 for an aligned one)",
        ),
    ]
    return rows + [("also at", millimetres(point)) for point in answer["others"]]


def _lift_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    sideways = ", ".join(f"{1e3 * value:.3g}" for value in without_noise(answer["force"])[:2])
    each = " in every coil" if len(answer["coil_names"]) > 1 else ""
    rows = [("lift current", f"{answer['lift_current']:.4f} A{each}")]
    if answer["thesis"] is not None:
        measured = f"{answer['thesis']:.4f} A{each}, (7-18), measured"
        rows.append(("thesis", f"{measured}; this model needs {answer['ratio']:.2f} times as much"))
    limit = answer["current_limit"]
    if limit is not None and abs(answer["lift_current"]) > limit:
        rows.append(("driver", f"gives at most {limit:g} A per coil, less than this"))
    return [
        *rows,
        ("dF/di", f"{1e3 * answer['force_per_ampere'][2]:.4g} mN upward per ampere{each}"),
        ("left over", f"sideways force ({sideways}) mN"),
    ]


def _states_table(answer: dict[str, Any]) -> Any:
    """The nonlinear states on the way to the lift current."""
    rows = (
        (
            f"{state['current']:.4f}",
            f"{1e3 * state['lift']:.3f}",
            f"{1e3 * state['lift'] / state['current']:.3f}",
            f"{100 * state['lift'] / answer['weight']:.2f} %",
        )
        for state in answer["states"]
    )
    return table(("A per coil, states solved", "lift mN", "mN per A", "of the weight"), rows)


def _directions(answer: dict[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            "(" + ", ".join(f"{component:+.3f}" for component in without_noise(direction)) + ")",
            f"{value:+.4g}",
            "yes" if stable else "no",
        )
        for direction, value, stable in zip(
            answer["directions"], answer["eigenvalues"], answer["stable"], strict=True
        )
    ]
