"""Fields and gradients at points, as tables."""

from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from fieldmap.cli.printing import place, table, without_noise


def currents_text(coil_names: tuple[str, ...], currents: Any) -> str:
    """The currents in words: "1.5 A in each of 6 coils", "1.5 A in coil 3", or coil by coil."""
    values = [float(value) for value in currents]
    if len(values) == 1:
        return f"{values[0]:g} A in coil {coil_names[0]}"
    if len(set(values)) == 1:
        return f"{values[0]:g} A in each of {len(values)} coils"
    return ", ".join(f"{name}: {value:g} A" for name, value in zip(coil_names, values, strict=True))


def field_table(rows: list[dict[str, Any]], coil_names: tuple[str, ...], currents: Any) -> RenderableType:
    """B and the gradient at each point."""
    parts: list[RenderableType] = [Text(currents_text(coil_names, currents))]
    for row in rows:
        lines = []
        flux_density, gradient = without_noise(row["B"]), without_noise(row["gradient"])
        for i, axis in enumerate("xyz"):
            entries = (f"{1e3 * gradient[i][j]:.6g}" for j in range(3))
            lines.append((f"B{axis}", f"{1e3 * flux_density[i]:.6g}", *entries))
        columns = (f"at {place(row['at'])}", "mT", "d/dx  mT/m", "d/dy  mT/m", "d/dz  mT/m")
        parts.append(table(columns, lines))
    return Group(*parts)
