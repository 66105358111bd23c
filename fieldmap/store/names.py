"""Where things lie in a map file, and names that every reader of openPMD accepts."""

import re
from collections.abc import Sequence

FORMAT_VERSION = 1
MESHES = "/data/0/meshes"
OWN = "/fieldmap"
VECTOR = ("x", "y", "z")
TENSOR = tuple(i + j for i in VECTOR for j in VECTOR)
"""Components of the gradient: "xy" is dB_x/dy."""


def record_names(coil_names: Sequence[str]) -> tuple[str, ...]:
    """One distinct record name part per coil, of ASCII letters, digits and underscores only.

    >>> record_names(["1", "upper left", "upper-left"])
    ('1', 'upper_left', 'upper_left_2')
    """
    taken: list[str] = []
    for name in coil_names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
        candidate, count = plain, 1
        while candidate in taken:
            count += 1
            candidate = f"{plain}_{count}"
        taken.append(candidate)
    return tuple(taken)


def component_paths(record: str) -> dict[str, list[str]]:
    """Paths of the flux density's and the gradient's components of one coil."""
    return {
        "flux_density": [f"{MESHES}/B_{record}/{c}" for c in VECTOR],
        "gradient": [f"{MESHES}/gradB_{record}/{c}" for c in TENSOR],
    }
