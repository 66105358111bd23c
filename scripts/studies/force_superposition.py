"""Growth of the error of added force formulas with the number of electromagnets: docs/theory/force_formulas.md.

python scripts/studies/force_superposition.py                (half a minute)
python scripts/studies/force_superposition.py --saturating   (a few minutes: may forces be added at all?)
"""

import argparse

import numpy as np
from numpy.typing import NDArray

import fieldmap as fm
from fieldmap.iron import NonlinearSolver
from fieldmap.thesis import spatial_force
from fieldmap.thesis.planar_force import DEPTHS, horizontal_fit, superposition_error, vertical_fit

DEPTH, HALF_WIDTH = 0.09, 0.03


def planar_rows() -> list[str]:
    """Two dimensions, pole piece 8 mm thick."""
    rows = ["two dimensions (S9)              magnets        error (N)  of the force  of it on |x| <= 50 mm"]
    for name, fit, depths in (
        ("horizontal (4-7), z = 125 mm", horizontal_fit((0.125,), 0.22), (0.125,)),
        ("vertical (4-6), z = 100..150 mm", vertical_fit(), DEPTHS),
    ):
        for currents in ((1.0, 0.0), (1.0, 1.0), (1.5, 0.5)):
            error = superposition_error(fit.formula, currents, depths)
            rows.append(
                f"{name:32s} {error.currents!s:12s} {error.rms:11.4f} {100 * error.whole:10.1f} %"
                f" {100 * error.middle:12.1f} %"
            )
    return rows


def spatial_rows() -> list[str]:
    """Three dimensions, linear iron."""
    rows = ["three dimensions (S10), 1 A each  magnets  error (mN)  of the force  of it on |x| <= 10 mm"]
    for name in (spatial_force.HORIZONTAL, spatial_force.QUADRATIC):
        for error in spatial_force.added_errors(DEPTH, HALF_WIDTH, name):
            rows.append(
                f"{name:33s} {len(error.currents):7d} {1e3 * error.rms:11.3f} {100 * error.whole:11.1f} %"
                f" {100 * error.middle:12.1f} %"
            )
    return rows


def saturating_rows(current: float) -> list[str]:
    """Sum of the forces of single electromagnets against the force of all at once, with the curve of Appendix A-3."""
    device = fm.read_device("drive_unit_a3")
    solver = NonlinearSolver(device, refinement=0.4)
    x = spatial_force.places(HALF_WIDTH)
    points = np.column_stack([x, 0 * x, 0 * x - DEPTH])
    moment = device.payload.moment if device.payload else 1.0

    def force(currents: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(moment * solver.solve(currents).gradient(points)[:, 2, 0])

    single = np.array([force(current * row) for row in np.eye(6)])
    linear = current * spatial_force.unit_forces(DEPTH, HALF_WIDTH, 0.0)
    rows = [
        f"saturating iron, {current:g} A each  magnets  singles added (mN)  at once (mN)  linear iron (mN)"
    ]
    for chosen in (("2",), ("2", "5"), device.coil_names):
        pick = np.array([name in chosen for name in device.coil_names])
        together = force(current * pick)
        values = [1e3 * np.sqrt(np.mean(v**2)) for v in (single[pick].sum(0), together, linear[pick].sum(0))]
        rows.append(
            f"{'root mean square F_x':33s} {pick.sum():7d} {values[0]:16.3f} {values[1]:13.3f} {values[2]:14.3f}"
        )
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--saturating", action="store_true", help="solve the saturating unit as well")
    parser.add_argument("--current", type=float, default=1.0, help="current of the saturating states, A")
    arguments = parser.parse_args()
    rows = planar_rows() + ["", *spatial_rows()]
    if arguments.saturating:
        rows += ["", *saturating_rows(arguments.current)]
    print("\n".join(rows))


if __name__ == "__main__":
    main()
