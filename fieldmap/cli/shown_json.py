"""What `fieldmap show --json` prints beside the picture: SI units, but for `ranges`, whose titles state theirs."""

from typing import Any

from fieldmap.plot.shown import Shown


def as_json(shown: Shown) -> dict[str, Any]:
    """Title, currents, box, and what was found for the picture; nothing that was not."""
    known: dict[str, Any] = {
        "title": shown.title,
        "currents": shown.currents,
        "lower": shown.lower,
        "upper": shown.upper,
        "equilibrium": shown.equilibrium,
        "assumptions": shown.assumptions or None,
        "tetrahedra": None if shown.mesh is None else len(shown.mesh.tets),
    }
    if shown.surface is not None:
        surface = shown.surface
        known |= {
            "x_signals": surface.x_signals,
            "y_signals": surface.y_signals,
            "positions": surface.positions,
            "levels": surface.levels,
            "stable": surface.stable,
            "field_scale": surface.field_scale,
            "assumptions": (*shown.assumptions, *surface.assumptions),
        }
    if shown.run is not None:
        known |= {
            "event": shown.run.event,
            "duration": float(shown.run.time[-1] - shown.run.time[0]),
            "last_position": shown.run.position[-1],
        }
    return {name: value for name, value in known.items() if value is not None}
