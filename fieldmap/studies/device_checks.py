"""What a study asks of the device that it varies."""

from collections.abc import Iterator

from fieldmap.device.model import Device
from fieldmap.inputs.findings import Finding
from fieldmap.maps.recipe import Recipe
from fieldmap.studies.quantities import NEED_LIMIT, NEED_PAYLOAD, NEED_POINTS
from fieldmap.studies.schema import StudyFile


def device_findings(contents: StudyFile, device: Device, recipe: Recipe | None) -> list[Finding]:
    """What the device lacks for the currents and quantities of the study."""
    saturating = recipe is not None and recipe.currents is not None
    saturating |= contents.iron is not None and contents.iron.model == "saturating"
    return [
        *_of_currents(contents, device),
        *_of_quantities(contents, device, saturating),
        *_of_iron(contents, device),
    ]


def _of_currents(contents: StudyFile, device: Device) -> Iterator[Finding]:
    coils = len(device.coils)
    for k, entry in enumerate(contents.currents):
        for key in ("amperes_A", "shares"):
            given = getattr(entry, key)
            if isinstance(given, list) and len(given) != coils:
                must_hold = f"one number for each of the {coils} coils ({', '.join(device.coil_names)}), or one for all"
                yield Finding(
                    ("currents", k, key),
                    must_hold,
                    f"{len(given)} numbers",
                    "list as many as there are coils",
                )
        if entry.division is not None and coils != 6:
            must_hold = "the division of the thesis is that of six coils"
            yield Finding(
                ("currents", k, "division"), must_hold, f"{coils} coils", "write amperes_A or shares"
            )
        if entry.carries_at_mm is not None and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            remedy = "add them to the device file, or write amperes_A"
            yield Finding(("currents", k, "carries_at_mm"), must_hold, "none", remedy)


def _of_quantities(contents: StudyFile, device: Device, saturating: bool) -> Iterator[Finding]:
    record = contents.record
    for k, name in enumerate(record.quantities or ()):
        place = ("record", "quantities", k)
        if name in NEED_PAYLOAD and (device.payload is None or device.workspace is None):
            remedy = "add them to the device file, or leave the quantity out"
            yield Finding(place, f"{name} needs the device's [payload] and [workspace]", "none", remedy)
        if name in NEED_LIMIT and record.current_limit_A is None and device.driver is None:
            yield Finding(
                place, f"{name} needs the limit of the currents", "none", "add record.current_limit_A"
            )
        if name in NEED_POINTS and not record.points_mm:
            yield Finding(place, f"{name} needs record.points_mm", "none", "add points_mm = [[x, y, z]]")
        if name == "reachable_share" and saturating:
            remedy = "leave it out; reach is recorded of saturating iron as well"
            yield Finding(
                place, "reachable_share superposes coils: linear iron only", "saturating iron", remedy
            )
        if name in ("iron", "error") and not device.bodies:
            yield Finding(place, f"{name} needs iron", "a device without bodies", "leave it out")
        if name == "error" and device.workspace is None:
            yield Finding(place, "error needs the device's [workspace]", "none", "add it, or leave error out")


def _of_iron(contents: StudyFile, device: Device) -> Iterator[Finding]:
    keys = contents.iron
    if keys is None:
        return
    if keys.model == "saturating" and not device.bodies:
        yield Finding(
            ("iron", "model"), "there must be iron to saturate", "a device without bodies", 'write "linear"'
        )
    if keys.accuracy is not None and device.workspace is None:
        must_hold = "the error is estimated in the device's [workspace]"
        yield Finding(("iron", "accuracy"), must_hold, "none", "add one to the device file")
