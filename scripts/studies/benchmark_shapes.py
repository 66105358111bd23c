"""Convergence of field, sections and force of saturating iron, on devices in the shape of published benchmarks.

python scripts/studies/benchmark_shapes.py                       (both devices at refinements 0.5, 0.7, 1: some minutes)
python scripts/studies/benchmark_shapes.py --refinements 0.5,0.7,1,1.4   (the last needs 8 GB for thin_plates)
"""

import argparse
from dataclasses import replace

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Device
from fieldmap.iron import NonlinearSolution, NonlinearSolver

# Points in the gaps, m: the first in the middle of a gap, the second at its end.
GAP_POINTS = {
    "thin_plates": [[1.85e-3, 0.02, 0.0624], [1.85e-3, 0.025, 0.0624]],
    "pole_in_box": [[0.0, 0.0, 0.5e-3], [0.013, 0.0, 0.0575]],
}
# Bodies that are surrounded by air.
PIECES: dict[str, tuple[tuple[str, ...], ...]] = {
    "thin_plates": (
        *(
            (part, f"{part} upper end", f"{part} lower end")
            for part in ("centre plate", "right channel", "left channel")
        ),
        ("coil",),
    ),
    "pole_in_box": (("pole",), ("box", "floor pad", "lid collar"), ("coil",)),
}
CURRENTS = {"thin_plates": (1.0, 3.0), "pole_in_box": (1.0, 3.0, 5.0)}
# Displacement of the pole to either side for the force by coenergy, m.
STEP = 2.5e-5


def moved(device: Device, name: str, shift: float) -> Device:
    """The device with one body moved along z."""
    bodies = []
    for body in device.bodies:
        parts = tuple(
            replace(part, placement=replace(part.placement, position=part.placement.position + [0, 0, shift]))
            for part in body.parts
        )
        bodies.append(replace(body, parts=parts) if body.name == name else body)
    return replace(device, bodies=tuple(bodies))


def state_row(state: NonlinearSolution, current: float) -> str:
    """One state: gap field, sections, forces."""
    name = "thin_plates" if "centre plate" in state.mesh.body_names else "pole_in_box"
    gap = np.linalg.norm(state.field(GAP_POINTS[name]), axis=1)
    sections = [f"{state.section_flux_density(section):.4f}" for section in state.sections]
    forces = np.array([state.force_on(group) for group in PIECES[name]])
    residue = np.abs(forces.sum(axis=0)).max() / np.abs(forces).max()
    pull = f"{forces[0, 2]:.3f}" if name == "pole_in_box" else f"{np.abs(forces).max():.4f}"
    return (
        f"| {current:g} | {state.report.surface_faces} | {state.report.iterations} | "
        f"{' '.join(f'{b:.4f}' for b in gap)} | {' '.join(sections)} | {pull} | {residue:.1e} | "
        f"{state.report.total_seconds:.0f} |"
    )


def study(name: str, refinements: list[float], virtual_work: bool) -> None:
    """The table of one device."""
    device = fm.read_device(name)
    print(f"\n{device.title}; sections: {', '.join(section.name for section in device.sections)}")
    print("| A | faces | Newton | gap fields, T | sections, T | force, N | sum of forces | s |")
    print("|---|---|---|---|---|---|---|---|")
    for refinement in refinements:
        solver, state = NonlinearSolver(device, refinement), None
        for current in CURRENTS[name]:
            state = solver.solve([current], start=state)
            print(state_row(state, current), flush=True)
        if virtual_work and name == "pole_in_box" and state is not None:
            work = [
                NonlinearSolver(moved(device, "pole", s * STEP), refinement).solve([3.0]).coenergy()
                for s in (1, -1)
            ]
            print(f"force at 3 A from the coenergy: {(work[0] - work[1]) / (2 * STEP):.3f} N", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--refinements", default="0.5,0.7,1", help="divide the mesh sizes by these")
    parser.add_argument("--devices", default="pole_in_box,thin_plates", help="which devices")
    parser.add_argument("--virtual-work", action="store_true", help="the force from the coenergy as well")
    arguments = parser.parse_args()
    for name in arguments.devices.split(","):
        study(name, [float(text) for text in arguments.refinements.split(",")], arguments.virtual_work)


if __name__ == "__main__":
    main()
