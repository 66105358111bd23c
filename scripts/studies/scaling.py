"""Memory and time of the iron solver over the number of faces: the table of docs/theory/iron_fast.md, "Compression".

    python scripts/studies/scaling.py [--device NAME] [--refinements R ...] [--storage auto|dense|compressed]

Each refinement runs in a process of its own, for its peak of memory. Seconds are processor time of all threads together
(wall time of the whole run in brackets); errors are the largest relative deviations of Bz and of dBz/dz from the
references of the device file. The whole study takes about a quarter of an hour on two free cores.
"""

import argparse
import resource
import subprocess
import sys
import time

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Device, LinearMaterial
from fieldmap.iron import IronMesh, generate_mesh
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.materials import body_properties
from fieldmap.iron.operators.assembled import STORAGES, assemble
from fieldmap.iron.operators.compressed import CompressedMutualPotential
from fieldmap.sources import unit_flux_densities, unit_flux_density_and_gradient

# About 5, 12, 20, 40 and 60 thousand faces of the drive unit.
REFINEMENTS = (0.7, 1.0, 1.33, 1.8, 2.3)
MU_R = 4000.0
HEAD = (
    "| faces | tetrahedra | nodes | W dense, GB | W as kept, GB | mean rank | peak, GB | mesh, s | W, s | air, s | "
    "coil field, s | solution, s | steps | Bz, % | dBz/dz, % | (all, wall s) |"
)


class Clock:
    """Processor seconds since the last call."""

    def __init__(self) -> None:
        self._last = time.process_time()

    def __call__(self) -> float:
        now = time.process_time()
        passed, self._last = now - self._last, now
        return passed


def deviations(device: Device, faces, density) -> tuple[float, float]:
    """Largest deviation, signed, of Bz and of dBz/dz from the device's references, in percent."""
    worst = {False: 0.0, True: 0.0}
    for known in device.references:
        if known.mu_r != MU_R:
            continue
        point, weights = np.asarray(known.at, float)[None], np.asarray(known.currents)
        iron_b, iron_g = faces.field_and_gradient(point, (weights @ density)[None])
        b, g = iron_b[0, 0], iron_g[0, 0]
        for current, coil in zip(weights, device.coils, strict=True):
            own_b, own_g = unit_flux_density_and_gradient(coil, point)
            b, g = b + current * own_b[0], g + current * own_g[0]
        is_gradient = known.quantity.startswith("d")
        ours = g[2, 2] if is_gradient else b[2]
        deviation = 100 * (ours / known.value - 1)
        worst[is_gradient] = max(worst[is_gradient], float(deviation), key=abs)
    return worst[False], worst[True]


def warm_up() -> None:
    """Load the compiled kernels, so that loading is not part of the first figures."""
    device = fm.read_device("loop_and_sphere")
    fm.solve_linear(device, refinement=0.5)
    CompressedMutualPotential(assemble(generate_mesh(device, 0.5)).surface)


def row(device: Device, refinement: float, storage: str) -> str:
    """One line of the table."""
    warm_up()
    begin, clock, seconds = time.perf_counter(), Clock(), []
    mesh: IronMesh = generate_mesh(device, refinement)
    seconds.append(clock())
    iron = assemble(mesh, storage)
    seconds.append(clock())
    form = PotentialForm(iron)
    seconds.append(clock())
    field = form.elements.coil_field(lambda x: unit_flux_densities(device.coils, x))
    seconds.append(clock())
    laws = law_tables([LinearMaterial("iron", mu) for mu in body_properties(device, MU_R).mu_r])
    nothing = np.zeros((len(device.coils), len(mesh.body), 3))
    solved = form.solve_linear(Magnetisation(mesh.body, laws, nothing), field, 1e-7)
    seconds.append(clock())
    field_error, gradient_error = deviations(device, solved.iron.faces, solved.iron.density)
    count = len(iron.surface.areas)
    rank = f"{iron.mutual.mean_rank:.1f}" if isinstance(iron.mutual, CompressedMutualPotential) else "-"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    times = " | ".join(f"{value:.1f}" for value in seconds)
    return (
        f"| {count} | {len(mesh.tets)} | {form.elements.count} | {12e-9 * count**2:.2f} | "
        f"{1e-9 * iron.mutual.bytes:.2f} | {rank} | {peak:.1f} | {times} | {solved.iron.iterations} | "
        f"{field_error:+.3f} | {gradient_error:+.2f} | ({time.perf_counter() - begin:.0f}) |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="drive_unit_a3")
    parser.add_argument("--refinements", nargs="+", type=float, default=list(REFINEMENTS))
    parser.add_argument("--storage", choices=STORAGES, default="auto")
    parser.add_argument("--here", action="store_true", help="one refinement, in this process, its line only")
    given = parser.parse_args()
    if given.here:
        print(row(fm.read_device(given.device), given.refinements[0], given.storage))
        return
    print(HEAD, "|" + "---|" * (HEAD.count("|") - 1), sep="\n", flush=True)
    for refinement in given.refinements:
        options = ["--device", given.device, "--storage", given.storage, "--here"]
        command = [sys.executable, __file__, "--refinements", str(refinement), *options]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        print(
            finished.stdout.strip() or f"refinement {refinement:g}: {finished.stderr.strip()[-200:]}",
            flush=True,
        )


if __name__ == "__main__":
    main()
