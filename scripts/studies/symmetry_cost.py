"""Savings by the symmetry of the iron: processor seconds and memory with and without it, in one run.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/studies/symmetry_cost.py [DEVICE ...]

With one thread processor seconds are meaningful on a busy machine.
"""

import sys
import time

import numpy as np

import fieldmap as fm
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.symmetry import find_symmetry


def timed(work):
    """The result of work() and its processor seconds."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def compare(name: str) -> None:
    """Print one line for each way to treat a device."""
    device = fm.read_device(name)
    group, seconds = timed(lambda: find_symmetry(device))
    print(f"{name}: {group}, {group.order} operations, found in {seconds:.3f} s")
    for word in ("none", "auto"):
        mesh, meshing = timed(lambda word=word: generate_mesh(device, symmetry=word))
        iron, assembly = timed(lambda mesh=mesh: assemble(mesh))
        charge = np.random.default_rng(0).standard_normal((len(iron.surface.areas), 6))
        _, solving = timed(lambda iron=iron, charge=charge: iron.mutual.solve(iron.mutual @ charge, 1))
        print(
            f"  {word}: {len(mesh.tets)} tetrahedra, {len(iron.surface.areas)} faces, mesh {meshing:.1f} s, "
            f"W and factor {assembly:.2f} s, {iron.mutual.bytes / 1e6:.0f} MB, three products and two solutions "
            f"with 6 columns {solving:.2f} s"
        )


if __name__ == "__main__":
    # Compile everything on a small device first.
    assemble(generate_mesh(fm.read_device("loop_and_sphere"), symmetry="auto"))
    assemble(generate_mesh(fm.read_device("loop_and_sphere")))
    for chosen in sys.argv[1:] or ["disk_six_cores", "drive_unit_a3"]:
        compare(chosen)
