"""`fieldmap check`: is a device file or map file sound, and what is in it? `fieldmap schema`: what files may hold."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_settings
from fieldmap.errors import InputError
from fieldmap.records import count_of

if TYPE_CHECKING:
    from rich.table import Table

    from fieldmap.iron.notes import DeviceContents
    from fieldmap.store import MapCheck


def check(
    source: options.DeviceOrMapArgument,
    toml: Annotated[bool, typer.Option("--toml")] = False,
    changes: options.Changes = None,
    json: options.Json = False,
) -> None:
    """Read a device file, check its geometry, and list its bodies, coils and assumptions.

    Of a map file, verify the seal, every data set, the units and the provenance, and that the numbers are a magnetic
    field.

    Example: fieldmap check drive_unit

    Parameters
    ----------
    toml
        Print the device as a file in which every copy is written out.
    """
    from fieldmap.io import IronOptions, existing_map, is_map_file, named_device

    settings = parse_settings(changes)
    if is_map_file(source):
        from fieldmap.store import check_map, warn_of_missed_accuracy

        options.refuse_iron_of_map(IronOptions(), settings)
        checked = check_map(existing_map(source))
        warn_of_missed_accuracy(source, checked.info.provenance.solver_report)
        page.print_result(checked, partial(_map_page, source), json, map=source)
        return
    from fieldmap.iron.notes import device_contents

    contents = device_contents(named_device(source, settings))
    if toml:
        print(contents.device.to_toml(), end="")
    else:
        page.print_result(contents, _device_page, json)


def _device_page(contents: DeviceContents) -> Iterator[page.Section]:
    yield page.heading(contents.device.name, contents.device.title)
    yield _body_table(contents) if contents.bodies else None
    yield _coil_table(contents) if contents.coils else None
    yield page.facts([*_device_facts(contents), *page.assumption_lines(contents.assumptions)])
    bodies = count_of(len(contents.bodies), "body", "bodies")
    yield f"{bodies}, {count_of(len(contents.coils), 'coil', 'coils')}: no problem found."


def _body_table(contents: DeviceContents) -> Table:
    rows = (
        (
            body.name,
            body.material,
            f"{1e6 * body.volume:.2f}",
            f"{1e3 * body.mesh_size:.3g}",
            page.axis_text(body.axis),
        )
        for body in contents.bodies
    )
    return page.table(("body", "material", "volume cm3", "element mm", "axis"), rows, left=2)


def _coil_table(contents: DeviceContents) -> Table:
    rows = (
        (
            coil.name,
            of_device.kind.replace("_", " "),
            f"{coil.turns:g}",
            f"{coil.polarity:+d}",
            *page.cells((coil.resistance,), ".4g"),
            *page.cells((coil.inductance,), ".4g", 1e3),
            page.place(coil.centre, 2),
            page.axis_text(coil.axis),
        )
        for coil, of_device in zip(contents.coils, contents.device.coils, strict=True)
    )
    return page.table(
        ("coil", "winding", "turns", "polarity", "ohm", "mH", "centre, mm", "axis"), rows, left=2
    )


def _device_facts(contents: DeviceContents) -> Iterator[tuple[str, str]]:
    device = contents.device
    if device.payload is not None:
        inertia = ""
        if (moments := device.payload.principal_moments) is not None:
            uniform = " as a uniform body" if device.payload.inertia is None else ""
            inertia = f", inertia {', '.join(page.cells(moments, '.4g', 1e9))} g mm2{uniform}"
        yield "payload", f"{1e3 * device.payload.mass:.4g} g, {device.payload.description}{inertia}"
    if (driver := device.driver) is not None:
        drive = "" if driver.mode in (None, "ideal") else f", {driver.mode.replace('_', ' ')}"
        supply = f" at {driver.supply_voltage:g} V" if drive and driver.supply_voltage else ""
        yield "driver", f"{driver.gain:g} A/V, at most {driver.current_limit:g} A per coil{drive}{supply}"
    if device.bounds is not None:
        yield "workspace", f"{page.place(device.bounds[0])} mm to {page.place(device.bounds[1])} mm"
    if device.joints:
        yield "joints", "; ".join(joint.description for joint in device.joints)
    if device.background is not None:
        yield "background", device.background.description
    if device.references:
        yield "references", f"{len(device.references)} known values; compare: fieldmap solve"


def _map_page(name: str, checked: MapCheck) -> Iterator[page.Section]:
    yield page.heading(Path(name).name, checked.info.provenance.title)
    yield page.facts(_map_facts(checked))
    yield page.facts([("note", text) for text in checked.notes]) if checked.notes else None
    sound = checked.missed_accuracy is None
    found = "no problem found" if sound else "undamaged, but less accurate than asked for"
    yield f"{count_of(checked.data_sets, 'data set', 'data sets')}, {checked.bytes / 1e6:.2f} MB: {found}."


def _map_facts(checked: MapCheck) -> Iterator[tuple[str, str]]:
    from fieldmap.store.map_check import DIVERGENCE_AND_CURL, TOTAL, VALUES_AND_GRADIENTS

    info, source = checked.info, checked.info.provenance
    yield "file", "length and SHA-256 are those of its seal; format, completeness, links"
    shape = " x ".join(str(n) for n in info.grid.shape)
    fields = count_of(len(info.field_names), "field", "fields")
    yield "numbers", f"{fields} on {shape} nodes: checksums, shapes, units, finite"
    curls = f"divergence {checked.divergence:.1e}, curl {checked.curl:.1e}"
    yield "gradients", f"{curls} of the largest gradient (limit {DIVERGENCE_AND_CURL:g})"
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


def kinds_of_file(incomplete: str = "") -> list[str]:
    """Kinds of files that begin like this.

    >>> kinds_of_file("s")
    ['study', 'scenario']
    """
    from fieldmap.inputs.kinds import MARKS

    kinds = (name.replace(" ", "-") for name in MARKS)
    return [name for name in kinds if name.startswith(incomplete)]


def schema(
    kind: Annotated[str, typer.Argument(metavar="KIND", autocompletion=kinds_of_file)] = "device",
) -> None:
    """Print the JSON Schema of a kind of file, for editors that check a file while you type.

    Example: fieldmap schema recipe > recipe.schema.json

    Parameters
    ----------
    kind
        Kind of file: device, material, planar-device, recipe, study, fit or scenario.
    """
    from fieldmap.io.json_schema import FILE_KINDS, schema_text

    schemas = {one.name.replace(" ", "-"): one.schema for one in FILE_KINDS}
    if kind not in schemas:
        must_hold = f"must be one of {', '.join(schemas)}"
        raise InputError.of("schema", must_hold, kind, "choose one of these")
    print(schema_text(schemas[kind]), end="")
