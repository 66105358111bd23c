"""`fieldmap check`: is this device file or map sound, and what is in it?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldmap.cli.options import devices

if TYPE_CHECKING:
    from fieldmap.device.model import Coil, Device


def check(
    source: Annotated[
        str,
        typer.Argument(
            metavar="DEVICE_OR_MAP",
            help="Device file, the name of a shipped device, or a map file.",
            autocompletion=devices,
        ),
    ],
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Read a device file, check its geometry, and list its bodies, coils and assumptions.

    Of a map file verify everything: its seal, every data set, units, provenance, and that its numbers are a magnetic
    field.
    """
    from fieldmap.cli.opening import is_map, open_device

    if is_map(source):
        from fieldmap.cli.check_map import print_check

        print_check(source, json)
        return
    from fieldmap.iron import check_geometry

    machine = open_device(source)
    check_geometry(machine)
    contents = _contents(machine)
    if json:
        from fieldmap.cli.printing import print_json

        print_json(contents)
    else:
        _print(machine, contents)


def _contents(device: Device) -> dict[str, Any]:
    from fieldmap.cli.assumptions import material_assumptions, payload_assumptions

    return {
        "device": device.name,
        "title": device.title,
        "source": device.source,
        "bodies": [
            {
                "name": body.name,
                "material": body.material,
                "volume": _volume(body),
                "mesh_size": body.mesh_size,
                "parts": len(body.parts),
            }
            for body in device.bodies
        ],
        "coils": [_coil(coil) for coil in device.coils],
        "payload": device.payload,
        "driver": device.driver,
        "workspace": device.workspace,
        "references": len(device.references),
        "assumptions": material_assumptions(device) + payload_assumptions(device.payload),
    }


def _volume(body: Any) -> float:
    """Volume in m^3."""
    from fieldmap.iron.geometry.solids import body_solid

    return 1e-9 * float(body_solid(body).mass)


def _coil(coil: Coil) -> dict[str, Any]:
    return {
        "name": coil.name,
        "kind": type(coil).__name__,
        "turns": coil.turns,
        "polarity": coil.polarity,
        "centre": coil.placement.position,
        "height": coil.height,
        "resistance": coil.resistance,
        "inductance": coil.inductance,
    }


def _print(device: Device, contents: dict[str, Any]) -> None:
    from fieldmap.cli.printing import assumption_lines, count_of, facts, heading, print_page

    bodies = count_of(len(device.bodies), "body", "bodies")
    coils = count_of(len(device.coils), "coil", "coils")

    print_page(
        heading(device.name, device.title),
        _body_table(contents["bodies"]) if device.bodies else None,
        _coil_table(device, contents["coils"]) if device.coils else None,
        facts([*_extras(device), *assumption_lines(contents["assumptions"])]),
        f"{bodies}, {coils}: no problem found.",
    )


def _body_table(bodies: list[dict[str, Any]]) -> Any:
    from fieldmap.cli.printing import table

    rows = (
        (b["name"], b["material"], f"{1e6 * b['volume']:.2f}", f"{1e3 * b['mesh_size']:.3g}") for b in bodies
    )
    return table(("body", "material", "volume cm3", "element mm"), rows, left=2)


def _coil_table(device: Device, coils: list[dict[str, Any]]) -> Any:
    from fieldmap.cli.printing import place, table

    rows = (
        (
            c["name"],
            coil.kind.replace("_", " "),
            f"{c['turns']:g}",
            f"{c['polarity']:+d}",
            _number(c["resistance"]),
            _number(c["inductance"], 1e3),
            place(c["centre"], 2).removesuffix(" mm"),
        )
        for coil, c in zip(device.coils, coils, strict=True)
    )
    return table(("coil", "winding", "turns", "polarity", "ohm", "mH", "centre, mm"), rows, left=2)


def _number(value: float | None, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.4g}"


def _extras(device: Device) -> list[tuple[str, str]]:
    from fieldmap.cli.opening import workspace_corners
    from fieldmap.cli.printing import place

    rows = []
    if device.payload is not None:
        rows.append(
            ("payload", f"{1e3 * device.payload.mass:.4g} g, moment {device.payload.moment:.4g} A m2")
        )
    if device.driver is not None:
        rows.append(
            ("driver", f"{device.driver.gain:g} A/V, at most {device.driver.current_limit:g} A per coil")
        )
    box = workspace_corners(device)
    if box is not None:
        rows.append(("workspace", f"{place(box[0])} to {place(box[1])}"))
    if device.references:
        rows.append(("references", f"{len(device.references)} known values; compare: fieldmap solve"))
    return rows
