"""The known values of a device file beside ours, where they hold."""

from collections import Counter
from typing import Any

import numpy as np

from fieldmap.cli.iron import IronChoice
from fieldmap.device.model import Device, Reference

AXES = {"x": 0, "y": 1, "z": 2}


def component(quantity: str, field: Any, gradient: Any) -> float:
    """One entry of B (3,) or of its gradient (3, 3) by name: "Bz", "dBz/dx"."""
    if "/" not in quantity:
        return float(field[AXES[quantity[1]]])
    return float(gradient[AXES[quantity[2]], AXES[quantity[5]]])


def compare(device: Device, field: Any, choice: IronChoice, currents: Any) -> list[dict[str, Any]]:
    """Every known value of the device's file beside ours.

    field: with `field(points, currents)` and `gradient(points, currents)`. Where a value holds for other iron, or
    for other currents than a nonlinear state's, `ours` is None and `why_not` says why.
    """
    rows = []
    for reference in device.references:
        why_not, ours = _why_not(device, reference, choice, currents), None
        if not why_not:
            point = reference.at[None, :]
            b = field.field(point, reference.currents)[0]
            ours = component(reference.quantity, b, field.gradient(point, reference.currents)[0])
        rows.append(_row(reference, ours, why_not))
    return rows


def _why_not(device: Device, reference: Reference, choice: IronChoice, currents: Any) -> str:
    if reference.mu_r is not None:
        mu_r = common_mu_r(device, choice)
        if not abs(reference.mu_r - mu_r) <= 1e-9 * reference.mu_r:
            return f"linear iron, --mu-r {reference.mu_r:g}"
    if choice.nonlinear and not np.array_equal(reference.currents, currents):
        return "other currents than this state's"
    return ""


def _row(reference: Reference, ours: float | None, why_not: str) -> dict[str, Any]:
    deviation = None if ours is None else ours / reference.value - 1.0
    return {
        "quantity": reference.quantity,
        "at": reference.at,
        "currents": reference.currents,
        "mu_r": reference.mu_r,
        "reference": reference.value,
        "ours": ours,
        "deviation": deviation,
        "why_not": why_not,
        "tolerance": reference.tolerance,
        "source": reference.source,
    }


def common_mu_r(device: Device, choice: IronChoice) -> float:
    """The one relative permeability of the iron; NaN, which equals no reference, if bodies differ or saturate."""
    if choice.mu_r is not None:
        return choice.mu_r
    values = set()
    for body in device.bodies:
        material = device.materials[body.material]
        if material.role == "iron":
            saturates = material.saturates and choice.nonlinear
            values.add(float("nan") if saturates else material.initial_mu_r)
    return values.pop() if len(values) == 1 else float("nan")


def reference_table(rows: list[dict[str, Any]]) -> Any:
    """The known values that hold, ours, and where they come from; of the others, how many and what they need."""
    from rich.console import Group, RenderableType
    from rich.text import Text

    from fieldmap.cli.printing import table

    held = [row for row in rows if row["ours"] is not None]
    parts: list[RenderableType] = []
    if held:
        columns = ("known value", "at, mm", "reference", "ours", "deviation", "known to")
        parts.append(table(columns, (_cells(row) for row in held), left=2))
        sources = dict.fromkeys(row["source"] for row in held)
        parts += [Text(f" source: {source}", style="dim") for source in sources]
    for why_not, count in Counter(row["why_not"] for row in rows if row["why_not"]).items():
        values = "1 known value of the file holds" if count == 1 else f"{count} known values of the file hold"
        parts.append(Text(f" Not compared: {values} for {why_not}."))
    return Group(*parts)


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    from fieldmap.cli.printing import place

    unit = "T/m" if "/" in row["quantity"] else "T"
    known = "" if row["tolerance"] is None else f"{100 * row['tolerance']:.2g} %"
    verdict = (f"{row['ours']:.6g}", f"{100 * row['deviation']:+.3f} %", known)
    at = place(row["at"]).removesuffix(" mm")
    return (row["quantity"], at, f"{row['reference']:.6g} {unit}", *verdict)
