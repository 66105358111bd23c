"""`fieldmap check`: is this device file or map file sound, and what is in it?"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Changes, DeviceOrMapArgument, Json, changes_of_device, refuse_iron_of_map

if TYPE_CHECKING:
    from rich.table import Table

    from fieldmap.cli.printing import Section
    from fieldmap.iron.notes import DeviceContents
    from fieldmap.store import MapCheck


def check(
    source: DeviceOrMapArgument,
    toml: Annotated[
        bool,
        typer.Option("--toml", help="Print the device as a file in which every copy is written out."),
    ] = False,
    changes: Changes = None,
    json: Json = False,
) -> None:
    """Read a device file, check its geometry, and list its bodies, coils and assumptions.

    Of a map file, verify the seal, every data set, the units and the provenance, and that the numbers are a magnetic
    field.
    """
    from fieldmap.cli.printing import print_result
    from fieldmap.io import IronOptions, existing_map, is_map_file, named_device

    settings = changes_of_device(changes)
    if is_map_file(source):
        from fieldmap.store import check_map, warn_of_missed_accuracy

        refuse_iron_of_map(IronOptions(), settings)
        checked = check_map(existing_map(source))
        warn_of_missed_accuracy(source, checked.info.provenance.solver_report)
        print_result(checked, partial(_map_page, source), json, map=source)
    else:
        from fieldmap.iron.notes import device_contents

        contents = device_contents(named_device(source, settings))
        if toml:
            print(contents.device.to_toml(), end="")
        else:
            print_result(contents, _device_page, json)


def _device_page(contents: "DeviceContents") -> Iterator["Section"]:
    from fieldmap.cli.printing import assumption_lines, facts, heading
    from fieldmap.records import count_of

    yield heading(contents.device.name, contents.device.title)
    yield _body_table(contents) if contents.bodies else None
    yield _coil_table(contents) if contents.coils else None
    yield facts([*_facts(contents), *assumption_lines(contents.assumptions)])
    bodies = count_of(len(contents.bodies), "body", "bodies")
    yield f"{bodies}, {count_of(len(contents.coils), 'coil', 'coils')}: no problem found."


def _body_table(contents: "DeviceContents") -> "Table":
    from fieldmap.cli.printing import axis_text, table

    rows = (
        (
            body.name,
            body.material,
            f"{1e6 * body.volume:.2f}",
            f"{1e3 * body.mesh_size:.3g}",
            axis_text(body.axis),
        )
        for body in contents.bodies
    )
    return table(("body", "material", "volume cm3", "element mm", "axis"), rows, left=2)


def _coil_table(contents: "DeviceContents") -> "Table":
    from fieldmap.cli.printing import axis_text, place, table

    rows = (
        (
            coil.name,
            of_device.kind.replace("_", " "),
            f"{coil.turns:g}",
            f"{coil.polarity:+d}",
            _number(coil.resistance),
            _number(coil.inductance, 1e3),
            place(coil.centre, 2).removesuffix(" mm"),
            axis_text(coil.axis),
        )
        for coil, of_device in zip(contents.coils, contents.device.coils, strict=True)
    )
    return table(("coil", "winding", "turns", "polarity", "ohm", "mH", "centre, mm", "axis"), rows, left=2)


def _number(value: float | None, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.4g}"


def _facts(contents: "DeviceContents") -> Iterator[tuple[str, str]]:
    from fieldmap.cli.printing import place

    device = contents.device
    if device.payload is not None:
        inertia = ""
        if (moments := device.payload.principal_moments) is not None:
            uniform = " as a uniform body" if device.payload.inertia is None else ""
            inertia = f", inertia {', '.join(f'{1e9 * one:.4g}' for one in moments)} g mm2{uniform}"
        yield (
            "payload",
            f"{1e3 * device.payload.mass:.4g} g, {device.payload.description}{inertia}",
        )
    if device.driver is not None:
        yield "driver", f"{device.driver.gain:g} A/V, at most {device.driver.current_limit:g} A per coil"
    if device.bounds is not None:
        yield "workspace", f"{place(device.bounds[0])} to {place(device.bounds[1])}"
    if device.joints:
        yield "joints", "; ".join(joint.description for joint in device.joints)
    if device.background is not None:
        yield "background", device.background.description
    if device.references:
        yield "references", f"{len(device.references)} known values; compare: fieldmap solve"


def _map_page(name: str, checked: "MapCheck") -> Iterator["Section"]:
    from fieldmap.cli.printing import facts, heading
    from fieldmap.records import count_of

    yield heading(Path(name).name, checked.info.provenance.title)
    yield facts(_map_facts(checked))
    yield facts([("note", text) for text in checked.notes]) if checked.notes else None
    sets = count_of(checked.data_sets, "data set", "data sets")
    found = (
        "no problem found"
        if checked.missed_accuracy is None
        else "undamaged, but less accurate than asked for"
    )
    yield f"{sets}, {checked.bytes / 1e6:.2f} MB: {found}."


def _map_facts(checked: "MapCheck") -> Iterator[tuple[str, str]]:
    from fieldmap.records import count_of
    from fieldmap.store.map_check import DIVERGENCE_AND_CURL, TOTAL, VALUES_AND_GRADIENTS

    info, source = checked.info, checked.info.provenance
    yield "file", "length and SHA-256 are those of its seal; format, completeness, links"
    shape = " x ".join(str(n) for n in info.grid.shape)
    fields = count_of(len(info.field_names), "field", "fields")
    yield "numbers", f"{fields} on {shape} nodes: checksums, shapes, units, finite"
    yield (
        "gradients",
        (
            f"divergence {checked.divergence:.1e}, curl {checked.curl:.1e} of the largest gradient "
            f"(limit {DIVERGENCE_AND_CURL:g})"
        ),
    )
    if checked.values_and_gradients is not None:
        agreement = f"{checked.values_and_gradients:.1e} (limit {VALUES_AND_GRADIENTS:g})"
        yield "B", f"agrees with its gradients to {agreement}"
    yield "total", f"is the sum of the fields to {checked.total:.1e} (limit {TOTAL:g})"
    if info.reduced_model is not None:
        yield "currents", "the reduced model of saturating iron fits together"
    if info.fixed_sources:
        weight = ", a field of weight 1" if info.constant_field else ", in the fields of the iron"
        yield "no current", f"drives what {', '.join(info.fixed_sources)} make{weight}"
    versions = ", ".join(f"{name} {version}" for name, version in source.versions.items())
    yield "made", f"{source.created or 'at an unknown time'}" + (f" by {versions}" if versions else "")
