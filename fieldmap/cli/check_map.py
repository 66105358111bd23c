"""`fieldmap check MAP`: everything that can be verified about a map file."""

from collections.abc import Iterator
from typing import Any

from fieldmap.cli.opening import check_map_path
from fieldmap.cli.printing import count_of, facts, heading, print_json, print_page
from fieldmap.store import MapCheck, check_map
from fieldmap.store.verification import DIVERGENCE_AND_CURL, TOTAL, VALUES_AND_GRADIENTS


def print_check(name: str, json: bool) -> None:
    """Verify a map and print what was verified; MapFileError with every problem."""
    path = check_map_path(name)
    check = check_map(path)
    if json:
        print_json(_contents(name, check))
        return
    info = check.info
    print_page(
        heading(path.name, info.provenance.title),
        facts(_facts(check)),
        facts([("note", text) for text in check.notes]) if check.notes else None,
        f"{count_of(check.data_sets, 'data set', 'data sets')}, {check.bytes / 1e6:.2f} MB: no problem found.",
    )


def _contents(name: str, check: MapCheck) -> dict[str, Any]:
    info = check.info
    return {
        "map": name,
        "title": info.provenance.title,
        "device": info.provenance.device_name,
        "coil_names": info.coil_names,
        "grid": info.grid,
        "bytes": check.bytes,
        "data_sets": check.data_sets,
        "divergence": check.divergence,
        "curl": check.curl,
        "values_and_gradients": check.values_and_gradients,
        "total": check.total,
        "fingerprint": info.provenance.fingerprint,
        "versions": dict(info.provenance.versions),
        "created": info.provenance.created,
        "interpolation_error": info.interpolation_error,
        "error_bounds": info.error_bounds,
        "current_error": info.current_error,
        "notes": check.notes,
    }


def _facts(check: MapCheck) -> Iterator[tuple[str, str]]:
    info, source = check.info, check.info.provenance
    yield "file", "length and SHA-256 are those of its seal; format, completeness, links"
    shape = " x ".join(str(n) for n in info.grid.shape)
    fields = count_of(len(info.field_names), "field", "fields")
    yield "numbers", f"{fields} on {shape} nodes: checksums, shapes, units, finite"
    yield (
        "gradients",
        (
            f"divergence {check.divergence:.1e}, curl {check.curl:.1e} of the largest gradient "
            f"(limit {DIVERGENCE_AND_CURL:g})"
        ),
    )
    if check.values_and_gradients is not None:
        yield (
            "B",
            f"agrees with its gradients to {check.values_and_gradients:.1e} (limit {VALUES_AND_GRADIENTS:g})",
        )
    yield "total", f"is the sum of the fields to {check.total:.1e} (limit {TOTAL:g})"
    if info.reduced_model is not None:
        yield "currents", "the reduced model of saturating iron fits together"
    versions = ", ".join(f"{name} {version}" for name, version in source.versions.items())
    yield "made", f"{source.created or 'at an unknown time'}" + (f" by {versions}" if versions else "")
