"""Pole pieces compared by the motion of a controlled magnet below them: sway and noise in closed loop (thesis 8.2).

    python scripts/studies/pole_piece_sway.py                       radii of the shipped study, 6 mm thick, linear iron
    python scripts/studies/pole_piece_sway.py --disks 66,6 56,4.65 48.84,5.31    these radii and thicknesses, mm
    python scripts/studies/pole_piece_sway.py --refinement 0.7

Variants and equilibrium area are those of `fieldmap study pole_disk`. Every variant is solved once with linear iron on
a coarse mesh, mapped around the magnet, and simulated with the PID of the thesis and with the regulator of all axes.
"""

import argparse
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.dynamics import linearise, modes, prepare, read_scenario
from fieldmap.iron import solve_linear
from fieldmap.levitation import find_equilibrium, lift_current
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData
from fieldmap.studies import Study, read_study
from fieldmap.studies.equilibrium_area import equilibrium_area

_LOWER, _UPPER, _SPACING = np.array([-0.009, -0.009, -0.114]), np.array([0.009, 0.009, -0.090]), 0.003
_AT = np.array([0.0, 0.0, -0.102])
# A push from the side without the block; no noise of the field, but noise of the sensors.
_PUSHED = {
    "duration_s": 8.0,
    "start.depth_mm": 10.0,
    "field.scale": 1.0,
    "reference.0.by_mm": 0.0,
    "reference.1.by_mm": 0.0,
    "control.coupled.depths_mm": [8.0, 12.0],
    "control.coupled.designs": 3,
}


def small_map(device, refinement):
    """Map of the device's coils with linear iron, around the magnet at a sensor reading of 10 mm."""
    unit = solve_linear(device, refinement=refinement)
    counts = np.round((_UPPER - _LOWER) / _SPACING).astype(int) + 1
    grid = Grid(_LOWER, [_SPACING] * 3, tuple(counts))
    flux, slope = unit.unit_fields(grid.points())
    shape = (len(unit.coil_names), *grid.shape)
    data = MapData(
        grid,
        unit.coil_names,
        np.ones(len(unit.coil_names)),
        flux_density=flux.reshape(*shape, 3),
        gradient=slope.reshape(*shape, 3, 3),
    )
    return interpolate(data, kind="harmonic")


def judged(opened, scale):
    """Sway on a map with its field multiplied by `scale`: natural frequency, Hz; with the regulator the largest
    distance after a push and the RMS at rest, um; with the thesis's PID the largest distance, um, and the end, s."""
    changes = {**_PUSHED, "field.scale": scale}
    experiment = prepare(read_scenario("without_block", changes), opened)
    sway = [
        mode.frequency
        for mode in modes(linearise(experiment.machine, experiment.operating_point))
        if mode.frequency > 0
    ]
    run = experiment.run(1)
    aside = 1e6 * np.hypot(*(run.sensed - run.references)[:, :2].T)
    quiet = run.time > 4.0
    without_coupled = {key: value for key, value in changes.items() if not key.startswith("control.coupled")}
    pid = prepare(read_scenario("without_block_pid", without_coupled), opened).run(1)
    wide = 1e6 * np.hypot(*(pid.sensed - pid.references)[:, :2].T)
    return min(sway), aside[~quiet].max(), np.sqrt(np.mean(aside[quiet] ** 2)), wide.max(), pid.time[-1]


Disk = tuple[float, float, Device, float]


def disks_of(study: Study) -> Iterator[Disk]:
    """Radius and thickness, mm, device, and force share that defines the equilibrium area, of each variant."""
    for variant in study.variants:
        values = {axis.name: axis.values[k] for axis, k in zip(study.axes, variant.place, strict=True)}
        yield values["radius"], values["thickness"], device_of(variant.document), study.record.force_share


def of_the_study(thickness: float) -> list[Disk]:
    """Disks of one thickness, mm."""
    return [disk for disk in disks_of(read_study("pole_disk")) if disk[1] == thickness]


def others(wanted: Sequence[str]) -> Iterator[Disk]:
    """Disks of other radii and thicknesses, each as the only variant of the shipped study."""
    shipped = read_study("pole_disk").path.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        for sizes in wanted:
            text = shipped
            for name, value in zip(("radius", "thickness"), sizes.split(","), strict=True):
                text = re.sub(
                    rf'(name = "{name}".*?values = )\[[^]]*\]',
                    rf"\g<1>[{float(value)}]",
                    text,
                    flags=re.DOTALL,
                )
            path = Path(folder) / "pole_disk.toml"
            path.write_text(text, encoding="utf-8")
            yield from disks_of(read_study(path))


def main() -> None:
    """Print one line for each radius."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--refinement", type=float, default=0.5, help="of the device's mesh sizes")
    words.add_argument("--thickness", type=float, default=6.0, help="of the study's disks, mm: 3, 6 or 12")
    words.add_argument("--disks", nargs="+", help="RADIUS,THICKNESS in mm, in the place of the study's")
    wanted = words.parse_args()
    disks = of_the_study(wanted.thickness) if wanted.disks is None else others(wanted.disks)
    print(
        f"linear iron, mesh sizes over {wanted.refinement:g}; magnet at {1e3 * _AT} mm; field scaled to lift at 1.558 A"
    )
    print(
        "radius mm  thickness mm  lift A  area mm2  sway Hz   regulator: peak um  RMS um   PID of 7.1.1: largest um"
        "  until s"
    )
    for radius, thickness, device, force_share in disks:
        opened = small_map(device, wanted.refinement)
        lift = lift_current(opened, device.payload, _AT)
        try:
            rest = find_equilibrium(opened, currents=lift.currents, payload=device.payload, start=_AT)
            area = 1e6 * equilibrium_area(opened, rest, device.payload, force_share)
        except Exception as error:  # as a study does: report the error and continue
            print(f"  no area: {error}")
            area = np.nan
        sway, peak, rms, wide, until = judged(opened, float(lift.currents.max()) / 1.558)
        print(
            f"{radius:9g}  {thickness:12g}  {lift.currents.max():6.3f}  {area:8.4f}  {sway:7.3f}  {peak:18.1f}"
            f"  {rms:6.2f}  {wide:24.0f}  {until:7.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
