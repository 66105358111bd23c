"""Error over faces and processor seconds of uniform and of adaptive refinement: docs/theory/iron_errors.md, "Where
the mesh is refined".

    python scripts/studies/adaptive_study.py DEVICE --truth R [--mu-r M] [--uniform R ...] [--levels N] [--tolerance T]
                                            [--workspace X0 Y0 Z0 X1 Y1 Z1]

Errors are the largest over the surface of the workspace, relative to the largest value of the same quantity there. The
reference is the same device with its mesh sizes divided by R, which must be large enough. --workspace, mm, is for
devices without a workspace. Run it with one thread, because seconds are processor seconds.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Device, WorkspaceBox
from fieldmap.iron.error import Tolerance, estimate_error, workspace_surface
from fieldmap.iron.materials import body_properties
from fieldmap.iron.mesh.mesh import IronMesh, generate_mesh
from fieldmap.iron.mesh.mesher import LocalSizes
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.report import Stages
from fieldmap.iron.solvers.to_tolerance import START, Level

HEAD = "| mesh | faces | tetrahedra | error of B | of the gradient | shares of faces | gap | cpu s |"


def solved(device: Device, mesh: IronMesh, mu_r: float | None, tolerance: float) -> Level:
    """Solve both forms on one mesh."""
    points, properties = workspace_surface(device), body_properties(device, mu_r)
    return Level.solved(
        device, assemble(mesh), properties, points, tolerance, Stages(None), Tolerance(tolerance)
    )


def row(name: str, level: Level, truth, seconds: float) -> str:
    """One line of the table."""
    error = estimate_error(level.points, level.solution, truth, None).change
    gap = estimate_error(level.points, level.solution, None, level.complement).gap
    report = level.solution.report
    counts = f"{report.surface_faces} | {report.tetrahedra}"
    shares = f"{level.face_shares.total:.1e} | {'-' if gap is None else f'{gap[0]:.1e}'}"
    return f"| {name} | {counts} | {error[0]:.1e} | {error[1]:.1e} | {shares} | {seconds:.0f} |"


def study(device: Device, chosen: argparse.Namespace) -> None:
    """Print the table."""
    truth = fm.solve_linear(device, mu_r=chosen.mu_r, refinement=chosen.truth, symmetry="none")
    print(f"{device.name}, against {truth.report.surface_faces} faces\n\n{HEAD}\n|{'---|' * 8}", flush=True)
    for refinement in chosen.uniform:
        begin = time.process_time()
        level = solved(device, generate_mesh(device, refinement), chosen.mu_r, chosen.tolerance)
        print(row(f"uniform {refinement:g}", level, truth, time.process_time() - begin), flush=True)
    sizes: LocalSizes | None = None
    begin = time.process_time()
    for number in range(chosen.levels):
        level = solved(device, generate_mesh(device, START, local=sizes), chosen.mu_r, chosen.tolerance)
        sizes = level.next_sizes(max(1.5, 1.6 * level.own_excess))
        print(row(f"adaptive {number + 1}", level, truth, time.process_time() - begin), flush=True)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("device")
    parser.add_argument("--truth", type=float, required=True)
    parser.add_argument("--mu-r", type=float, default=None)
    parser.add_argument("--uniform", type=float, nargs="*", default=[0.7, 1.0, 1.4])
    parser.add_argument("--levels", type=int, default=3)
    parser.add_argument("--tolerance", type=float, default=4e-4)
    parser.add_argument("--workspace", type=float, nargs=6, default=None)
    chosen = parser.parse_args()
    device = fm.read_device(chosen.device)
    if chosen.workspace is not None:
        corners = 1e-3 * np.reshape(chosen.workspace, (2, 3))
        device = replace(device, workspace=WorkspaceBox(*corners))
    study(device, chosen)


if __name__ == "__main__":
    main()
