"""Effect of walls, elements and saturation on the planar drive units: tables of docs/theory/planar.md and
docs/thesis_models.md."""

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


SIDES = (
    (0.48, 0.0),
    (0.50, 0.0),
    (0.50, 0.025),
    (0.50, -0.025),
    (0.52, 0.0),
    (0.60, 0.0),
    (1.2, 0.0),
    (0.0, 0.0),
)
RATIOS = ((900.0, 1100.0), (800.0, 1200.0), (500.0, 1500.0))
PANELS = (0.01, 0.005, 0.0025)


def equilibria(device: PlanarDevice, size: float) -> str:
    """Rightmost stable points at 100 mm for three ratios of the currents, and the gradient for equal currents."""
    unit = solve_planar(device, size)
    places = [
        [p.x for p in stationary_points(unit, pair, -0.1, -WINDOW, WINDOW) if p.stable][-1] for pair in RATIOS
    ]
    gradient = unit.gradient([[0.0, -0.1]], [1e3, 1e3])[0, 1, 1]
    return f"{', '.join(f'{1e3 * x:.3f}' for x in places)} mm, {1e3 * gradient:.4f} mT/m"


def walls(side: float, higher: float) -> np.ndarray | None:
    """A square box about the middle of the pole piece's lower face, or no walls."""
    corners = 0.5 * side * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) + [0.0, higher]
    return corners if side else None


def row(device: PlanarDevice, currents: np.ndarray, z: float) -> str:
    """Largest flux density, points without horizontal force, and the lift over that of linear iron at x = 0."""
    state, unit = solve_planar_state(device, currents, SIZE), solve_planar(device, SIZE, mu_r=4000.0)
    largest = np.linalg.norm(state.iron_flux_density("iron")[1], axis=1).max()
    points = ", ".join(f"{1e3 * p.x:.1f}" for p in stationary_points(state, currents, z, -WINDOW, WINDOW))
    lift = state.gradient([[0.0, z]])[0, 1, 1] / unit.gradient([[0.0, z]], currents)[0, 1, 1]
    return f"{largest:9.2f} T   lift {lift:7.3f}   x = {points} mm"


def main() -> None:
    """Print the tables."""
    unit = read_planar_device("planar_drive_unit")
    for size in PANELS:
        print(f"panels of {1e3 * size:4.1f} mm: {equilibria(unit, size)}")
    for side, higher in SIDES:
        words = f"box of {side:.2f} m, {1e3 * higher:+.0f} mm" if side else "open space"
        print(f"{words:23s} {equilibria(replace(unit, walls=walls(side, higher)), SIZE)}")
    steel = read_device("drive_unit_a3").materials["steel"]
    for name, share, z in CASES:
        for law, words in ((Froehlich("iron", 4000.0, 2.1), "Froehlich"), (steel, "A-3 curve")):
            device = replace(read_planar_device(name), materials={"iron": law})
            for current in CURRENTS:
                print(f"{name:22s} {words:10s} {current:8.0e} A {row(device, current * np.array(share), z)}")


if __name__ == "__main__":
    main()
