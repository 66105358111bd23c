"""How far saturation matters in the thesis's planar drive units: the table of docs/theory/planar.md."""

from dataclasses import replace

import numpy as np

from fieldmap.device import read_device
from fieldmap.device.model import Froehlich
from fieldmap.planar import (
    PlanarDevice,
    read_planar_device,
    solve_planar,
    solve_planar_state,
    stationary_points,
)

CURRENTS = (1e3, 3e3, 1e4, 1e5, 1e6)
CASES = (("planar_drive_unit", (0.8, 1.2), -0.1), ("planar_drive_unit_8mm", (1.5, 0.5), -0.125))
SIZE, WINDOW = 0.01, 0.16


def row(device: PlanarDevice, currents: np.ndarray, z: float) -> str:
    """Largest flux density, points without horizontal force, and the lift over that of linear iron at x = 0."""
    state, unit = solve_planar_state(device, currents, SIZE), solve_planar(device, SIZE, mu_r=4000.0)
    largest = np.linalg.norm(state.iron_flux_density("iron")[1], axis=1).max()
    points = ", ".join(f"{1e3 * p.x:.1f}" for p in stationary_points(state, currents, z, -WINDOW, WINDOW))
    lift = state.gradient([[0.0, z]])[0, 1, 1] / unit.gradient([[0.0, z]], currents)[0, 1, 1]
    return f"{largest:9.2f} T   lift {lift:7.3f}   x = {points} mm"


def main() -> None:
    """Print the table."""
    steel = read_device("drive_unit_a3").materials["steel"]
    for name, share, z in CASES:
        for law, words in ((Froehlich("iron", 4000.0, 2.1), "Froehlich"), (steel, "A-3 curve")):
            device = replace(read_planar_device(name), materials={"iron": law})
            for current in CURRENTS:
                print(f"{name:22s} {words:10s} {current:8.0e} A {row(device, current * np.array(share), z)}")


if __name__ == "__main__":
    main()
