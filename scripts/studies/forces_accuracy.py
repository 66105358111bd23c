"""Compare forces and inductances with energy differences and with each other: the table of docs/theory/forces.md.

python scripts/studies/forces_accuracy.py            (a minute; --unit adds the drive unit, some minutes)
"""

import argparse
from collections.abc import Callable

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Body, Box, Device, LinearMaterial, Part, Placement, RoundedRectangleCoil
from fieldmap.iron import LinearSolution


def at(x: float, y: float, z: float) -> Placement:
    """Upright at a place."""
    return Placement(np.array([x, y, z], float), np.eye(3))


def lifting_magnet(gap: float, mesh_size: float, edge_size: float | None) -> Device:
    """A U of iron, 40 x 30 x 10 mm, with a coil on one leg, above a bar of 6 mm at a gap."""
    legs = (Part(Box((0.01, 0.01, 0.02)), at(x, 0, 0)) for x in (-0.015, 0.015))
    yoke = Body("yoke", "iron", (Part(Box((0.04, 0.01, 0.01)), at(0, 0, 0.02)), *legs), mesh_size, edge_size)
    bar = Body("bar", "iron", (Part(Box((0.04, 0.01, 0.006)), at(0, 0, -0.006 - gap)),), mesh_size, edge_size)
    coil = RoundedRectangleCoil(
        "coil", 0.008, 0.008, 0.0025, 0.004, 0.015, 100.0, placement=at(-0.015, 0, 0.01)
    )
    return Device("lifting magnet", "", (coil,), (yoke, bar), {"iron": LinearMaterial("iron", 1000.0)})


def gap_row(gap: float, mesh_size: float, edge_size: float | None, form: str) -> str:
    """Force on the bar from charges and from the energy, and the sum of action and reaction."""

    def solved(g: float) -> LinearSolution:
        return fm.solve_linear(lifting_magnet(g, mesh_size, edge_size), form=form)

    unit, step = solved(gap), 0.01 * gap
    forces = np.array([unit.force_on(name, [1.0])[2] for name in ("bar", "yoke", "coil")])
    energy = -(solved(gap + step).energy([1.0]) - solved(gap - step).energy([1.0])) / (2 * step)
    graded = "" if edge_size is None else f", edges {1e3 * edge_size:g} mm"
    case = f"lifting magnet, gap {1e3 * gap:g} mm, mesh {1e3 * mesh_size:g} mm{graded}, {form}"
    return (
        f"| {case} | {forces[0]:.4f} N | {energy:.4f} N | {forces[0] / energy - 1:+.1e} | "
        f"{abs(forces.sum()) / np.abs(forces).max():.1e} |"
    )


def drive_unit(say: Callable[[str], None]) -> None:
    """One coil of the drive unit: in air, on its core alone and in the whole unit, and the measured inductance."""
    device = fm.read_device("drive_unit")
    measured = [1e3 * coil.inductance for coil in device.coils if coil.inductance is not None]
    say(f"measured (thesis Table 3-1): {min(measured):.2f} to {max(measured):.2f} mH")
    core = tuple(body for body in device.bodies if body.name == "core 1")
    for what, bodies in (("air", ()), ("core 1 alone", core), ("whole unit", device.bodies)):
        alone = Device(device.name, "", device.coils[:1], bodies, device.materials)
        unit = fm.solve_linear(alone)
        say(f"coil 1, {what}, linear iron: {1e3 * unit.inductance()[0, 0]:.2f} mH")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--unit", action="store_true", help="add the inductance of a coil of the drive unit")
    arguments = parser.parse_args()
    print("| case | force | from the energy | difference | sum of all forces |\n|---|---|---|---|---|")
    for gap, mesh_size, edge_size in ((5e-4, 0.004, None), (2e-3, 0.004, None), (5e-4, 0.003, 5e-4)):
        for form in ("potential", "flux"):
            print(gap_row(gap, mesh_size, edge_size, form), flush=True)
    if arguments.unit:
        drive_unit(lambda text: print(text, flush=True))


if __name__ == "__main__":
    main()
