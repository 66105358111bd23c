"""Hostile input: outcomes of 1000 mutations of each kind of file and argument."""

from collections.abc import Iterator

from validation.fuzzing.table import figures
from validation.row import Row

MUTATIONS = 1000
SEED = 20261123
# Names in `fuzzing.kinds`, repeated here because that module imports everything that its kinds need.
KINDS = (
    *("device files", "map recipes", "scenarios", "studies", "optimisations", "fits", "planar devices"),
    *("B-H curves", "expressions"),
    *("map files", "recorded runs", "readings of B (CSV)", "logs of rigs (CSV)", "mag_manip (YAML)"),
    *(
        "surfaces (STL)",
        "meshes (VTK, gmsh, medit)",
        "solids (STEP)",
        "FMUs, by their importer",
        "Python machines",
    ),
)


def fuzz() -> Iterator[Row]:
    """One row per kind: number of mutations with a wrong answer, an error that is not ours, too much time or memory, a
    forbidden access, or a crash."""
    for kind in KINDS:
        found = figures(kind, MUTATIONS, SEED)
        counts = found.counts
        others = ("wrong", "traceback", "slow", "memory", "reached out", "crash")
        yield Row(
            f"{MUTATIONS} mutations, {kind}",
            "not read as before and not refused",
            float(sum(counts[other] for other in others)),
            0,
            f"{counts['refused']} refused, {counts['read']} read; at most {found.seconds:.2g} s, "
            f"{found.megabytes:.0f} MB",
            seconds=found.wall,
            note="; ".join(found.faults[:3]),
            figures={
                "kind": kind,
                "mutations": f"{sum(counts.values())}",
                **{what: f"{counts[what]}" for what in ("read", "refused", *others)},
                "slowest s": f"{found.seconds:.2f}",
                "most MB": f"{found.megabytes:.0f}",
            },
        )
