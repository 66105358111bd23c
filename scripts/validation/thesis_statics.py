"""The thesis's static tables on the shipped mesh: bounds of the deviations that the documentation claims."""

from collections.abc import Iterator

import numpy as np

from fieldmap.thesis.computation import PartResult, compute_part
from validation.row import Row

# Part -> (name of the printed number or table, slice of its rows, description, largest deviation).
DEVIATIONS = {
    "S14_table_6_2": [
        ("n125_held[1,", "x, n = 1.25, h = 15 mm, lift held", 0.20),
        ("n150_held[0,", "x, n = 1.5, h = 10 mm, lift held", 0.17),
    ],
    "S14_table_6_3": [("lower_held[1,", "x at z_s = 11.5 mm, h = 15 mm, lift held", 0.10)],
    "S14_limits": [
        ("n125_last_signal", "signal at 3.55 A, n = 1.25", 0.02),
        ("n150_last_signal", "signal at 3.55 A, n = 1.5", 0.08),
    ],
    "S13_field": [("directions", "Table 6-1 from the field", 0.0)],
}


def thesis_statics() -> Iterator[Row]:
    """Rows of all deviations. Needs the map of `fieldmap map division`; missing states are solved, about 7 s each."""
    for part, claims in DEVIATIONS.items():
        result = compute_part(part)
        for name, what, bound in claims:
            of_name = [c for c in result.comparisons if c.name.startswith(name)]
            off = [abs(c.ours - c.thesis) / abs(c.thesis or 1.0) for c in of_name]
            yield _row(result, what, max(off), bound, of_name[0].place)
    converged = compute_part("S14_convergence")
    places = np.array([c.ours for c in converged.comparisons]).reshape(3, -1)
    mesh, by_map = (float(np.abs(places[0] - places[k]).max()) for k in (1, 2))
    yield _row(converged, "equilibria, mesh sizes over 1.3, mm", mesh, 0.05, "shipped mesh")
    yield _row(converged, "equilibria, map against solved states, mm", by_map, 0.1, "shipped mesh")


def _row(result: PartResult, what: str, value: float, bound: float, place: str) -> Row:
    return Row(result.title, what, value, bound, f"thesis, {place}", cpu_seconds=result.seconds)
