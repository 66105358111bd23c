"""Currents in words, and fields and gradients at points as tables."""

from collections.abc import Iterable
from typing import Protocol

from rich.console import Group, RenderableType
from rich.text import Text

from fieldmap.cli.printing import place, table, without_noise
from fieldmap.typing import Array


class FieldAtPoint(Protocol):
    """B (3,), T, and its gradient (3, 3), T/m, at a point (3,), m."""

    @property
    def at(self) -> Array:
        """The point."""

    @property
    def B(self) -> Array:  # noqa: N802 - the symbol of the field
        """Flux density."""

    @property
    def gradient(self) -> Array:
        """dB_i/dx_j."""


def currents_text(coil_names: tuple[str, ...], currents: Iterable[float]) -> str:
    """The currents in words.

    >>> currents_text(("left", "right"), [1.5, 1.5]), currents_text(("loop",), [2.0])
    ('1.5 A in each of 2 coils', '2 A in coil loop')
    """
    values = [float(value) for value in currents]
    if len(values) == 1:
        return f"{values[0]:g} A in coil {coil_names[0]}"
    if len(set(values)) == 1:
        return f"{values[0]:g} A in each of {len(values)} coils"
    return ", ".join(f"{name}: {value:g} A" for name, value in zip(coil_names, values, strict=True))


def field_table(
    points: Iterable[FieldAtPoint], coil_names: tuple[str, ...] = (), currents: Iterable[float] = ()
) -> RenderableType:
    """B and the gradient at each point, below the currents, unless these stand elsewhere."""
    parts: list[RenderableType] = [Text(currents_text(coil_names, currents))] if coil_names else []
    for point in points:
        lines = []
        flux_density, gradient = without_noise(point.B), without_noise(point.gradient)
        for i, axis in enumerate("xyz"):
            entries = (f"{1e3 * gradient[i][j]:.6g}" for j in range(3))
            lines.append((f"B{axis}", f"{1e3 * flux_density[i]:.6g}", *entries))
        columns = (f"at {place(point.at)}", "mT", "d/dx  mT/m", "d/dy  mT/m", "d/dz  mT/m")
        parts.append(table(columns, lines))
    return Group(*parts)
