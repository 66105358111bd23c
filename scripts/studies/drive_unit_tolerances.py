"""Tolerances of the drive unit: docs/derivatives.md, "The drive unit".

    python scripts/studies/drive_unit_tolerances.py [--samples 50] [--kept FOLDER]

Lift current with the magnet 102 mm below the disk, and shift of the equilibrium by the direction signal x = 0.2:
first-order standard deviations, shares of each number, and random devices. Saturating iron on a coarse mesh. Devices
are kept in FOLDER; a second run prints the same table without solves, and a run with more samples continues.
"""

import argparse
from pathlib import Path

from fieldmap.currents import divide_currents
from fieldmap.studies import Carrying, Linked, Number, Uncertain, analyse_tolerances, read_design_problem

# Divisor of the device file's mesh sizes.
REFINEMENT = 0.4
AT = (0.0, 0.0, -0.102)


def uncertain_numbers() -> list[Uncertain]:
    """Keys with standard deviations in their units, and steps of differences for keys that change bodies: assumptions
    of this project for a machine that is turned, milled and wound with usual care."""
    # Bodies on the disk move up with its thickness, as in the study.
    thickness = read_design_problem("pole_piece").variables[1]
    return [
        *(Uncertain(f"coil.{k}.turns", 4.0) for k in range(1, 7)),
        Uncertain("body.disk.height_mm", 0.1, thickness.linked, step=1.0),
        Uncertain("body.disk.radius_mm", 0.2, step=2.0),
        Uncertain("body.core *.radius_mm", 0.05, (Linked(("body.centre core.radius_mm",)),), step=0.5),
        Uncertain("payload.magnet.remanence_T", 0.013),
        Uncertain("payload.mass_g", 0.1),
    ]


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--samples", type=int, default=50, help="random devices")
    arguments.add_argument(
        "--kept", type=Path, default=Path("maps/out/drive_unit_tolerances"), help="folder of the devices"
    )
    wanted = arguments.parse_args()
    signal = divide_currents(1.0, 0.2, 0.0, n=1.25)
    found = analyse_tolerances(
        "drive_unit",
        uncertain_numbers(),
        [Number("common_current", "equal"), Number("equilibrium_x", "x = 0.2", minus="equal")],
        currents={"equal": Carrying(AT), "x = 0.2": Carrying(AT, signal)},
        refinement=REFINEMENT,
        samples=wanted.samples,
        output=wanted.kept / "devices.nc",
        progress=lambda text, share: print(f"{100 * share:.0f} %: {text}", flush=True),
    )
    current, shift = found.numbers
    print("| key | deviation | of the lift current, mA | share | of the shift, um | share | derivatives |")
    print(f"|{'---|' * 7}")
    for key, deviation in found.deviations.items():
        parts = [
            f"{factor * abs(one.derivatives[key]) * deviation:.2f} | {100 * one.shares[key]:.0f} %"
            for one, factor in ((current, 1e3), (shift, 1e6))
        ]
        kinds = " and ".join(dict.fromkeys((current.kinds[key], shift.kinds[key])))
        print(f"| `{key}` | {deviation:g} | {' | '.join(parts)} | {kinds} |")
    for one, unit, factor in ((current, "mA", 1e3), (shift, "um", 1e6)):
        sampled = one.sampled
        print(f"{one.number}: {factor * one.value:.2f} {unit}, deviation {factor * one.deviation:.2f}")
        if sampled is not None:
            print(
                f"  {sampled.count} random devices: mean {factor * sampled.mean:.2f} +- "
                f"{factor * sampled.mean_error:.2f}, deviation {factor * sampled.deviation:.2f} +- "
                f"{factor * sampled.deviation_error:.2f}, 95 % within {factor * sampled.range[0]:.2f} and "
                f"{factor * sampled.range[1]:.2f}"
            )
    print(f"{len(found.failed)} random devices failed")


if __name__ == "__main__":
    main()
