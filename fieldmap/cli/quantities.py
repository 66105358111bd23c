"""Forces, torques and section flux densities of a solved device on the command line."""

from typing import Any

import numpy as np

from fieldmap.cli.printing import table, without_noise
from fieldmap.device.model import Device, Section
from fieldmap.errors import InputError, Problem


def checked_groups(device: Device, texts: list[str] | None) -> list[tuple[str, ...]]:
    """The groups of bodies and coils that --force names, each taken together."""
    known = (*(body.name for body in device.bodies), *device.coil_names)
    groups = [tuple(name.strip() for name in text.split(",") if name.strip()) for text in texts or []]
    problems = [
        Problem(
            "--force",
            f"must be a body or coil of the device: {', '.join(known)}",
            repr(name),
            "use one of these; several that are taken together stand with commas between",
        )
        for group in groups
        for name in group or ("",)
        if name not in known
    ]
    if problems:
        raise InputError(*problems)
    return groups


def checked_sections(device: Device, names: list[str] | None) -> tuple[Section, ...]:
    """The sections that --section names, all of the file if there is none."""
    by_name = {section.name: section for section in device.sections}
    listed = ", ".join(by_name) or "the file has no [[section]]"
    problems = [
        Problem(
            "--section", f"must be a section of the device file: {listed}", repr(name), "use one of these"
        )
        for name in names or []
        if name not in by_name
    ]
    if problems:
        raise InputError(*problems)
    return tuple(by_name[name] for name in names) if names else device.sections


def force_rows(solution: Any, groups: list[tuple[str, ...]], currents: Any) -> list[dict[str, Any]]:
    """Force in N and torque in N m about the origin on every group; currents are None for a state that has its own."""
    at = () if currents is None else (currents,)
    return [
        {
            "names": group,
            "force": solution.force_on(group, *at),
            "torque": solution.torque_on(group, *at, np.zeros(3)),
        }
        for group in groups
    ]


def section_rows(solution: Any, sections: tuple[Section, ...], currents: Any) -> list[dict[str, Any]]:
    """Mean normal flux density in T, flux in Wb and area in m^2 of every section."""
    at = () if currents is None else (currents,)
    rows = []
    for section in sections:
        found = solution.section_flux(section, *at)
        rows.append(
            {
                "section": section.name,
                "flux_density": found.flux_density,
                "flux": found.flux,
                "area": found.area,
            }
        )
    return rows


def force_table(rows: list[dict[str, Any]]) -> Any:
    """Forces in mN and torques about the origin in mN m."""
    columns = ("force on", "Fx mN", "Fy", "Fz", "torque Tx mN m", "Ty", "Tz")
    cells = (
        (
            ", ".join(row["names"]),
            *(f"{1e3 * value + 0.0:.5g}" for value in without_noise(row["force"])),
            *(f"{1e3 * value + 0.0:.5g}" for value in without_noise(row["torque"])),
        )
        for row in rows
    )
    return table(columns, cells)


def section_table(rows: list[dict[str, Any]]) -> Any:
    """Sections: mean flux density along the normal, flux, area."""
    cells = (
        (
            row["section"],
            f"{row['flux_density']:.5f}",
            f"{1e6 * row['flux']:.5g}",
            f"{1e6 * row['area']:.5g}",
        )
        for row in rows
    )
    return table(("section", "mean B along its normal, T", "flux uWb", "area mm2"), cells)
