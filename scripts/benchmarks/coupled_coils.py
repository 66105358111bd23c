"""Cost of a mechanical step with coils coupled by the flux linkages of a map, relative to ideal drives with R and L.

    cd scripts && python -m benchmarks.coupled_coils [MAP]

Without a map: six made-up coils with linear iron. MAP: of saturating iron; its currents begin in the middle of the
domain. Currents oscillate or are constant; with constant currents an ideal drive solves no iron. All kinds take turns,
and ratios are medians over the turns; times are processor times.
"""

import sys
import time
from dataclasses import replace

import numpy as np

import fieldmap as fm
from benchmarks.dynamics import dipoles
from fieldmap.dynamics import (
    CoilDrive,
    CurrentController,
    Machine,
    MatrixAllocation,
    RigidBody,
    Sensors,
    modelled,
    state_of,
    superposed,
)
from fieldmap.dynamics.field_of_currents import FieldOfCurrents
from fieldmap.instruments import Amplifier
from fieldmap.lookup import MagneticBody
from fieldmap.store import StoredLinkage

STEP, PER_PERIOD, LASTING, SWAYS, TURNS = 1e-4, 20, 0.05, (0.01, 0.0), 7


def main() -> None:
    """Print times and ratios."""
    angles = np.pi / 3 * np.arange(6)
    coils = np.column_stack([0.04 * np.cos(angles), 0.04 * np.sin(angles), np.zeros(6)])
    linkage = StoredLinkage(0.5 * np.eye(6) + 0.1, np.zeros(6))
    of, place = replace(superposed(dipoles(np.full(6, 30.0), coils)), linkage=linkage), np.array([0, 0, -0.1])
    level = np.ones(6)
    if len(sys.argv) > 1:
        opened = fm.open_map(sys.argv[1], outside_currents="evaluate")
        reduced = opened.info.reduced_model
        assert reduced is not None
        of, place, level = modelled(opened), np.mean(opened.bounds, axis=0), reduced.domain.middle
    for sway in SWAYS:
        print(f"currents that sway by {100 * sway:g} %")
        measure(of, place, level, sway, 4000 if of.model is not None else 40000)


def measure(of: FieldOfCurrents, place: np.ndarray, level: np.ndarray, sway: float, steps: int) -> None:
    """Time steps with a held magnet. Commanded currents oscillate about a level (n,) by a share of it."""
    n, inductance = len(level), np.diag(of.inductance())
    ohms, amplifier = inductance / LASTING, Amplifier(1.0)
    common = {"resistance": ohms, "supply": (-1e3, 1e3)}
    drives = {
        "ideal": CoilDrive(amplifier, n, inductance=inductance, time_constant=1e-3, **common),
        "voltage": CoilDrive(amplifier, n, mode="voltage", **common),
        "current_controller": CoilDrive(
            amplifier, n, mode="current_controller", controller=CurrentController(bandwidth=100.0), **common
        ),
    }
    body = RigidBody(0.01, [1e-6] * 3, MagneticBody.dipole([0, 0, 0.5]), gravity=0.0, upright=True)
    direct = MatrixAllocation(np.eye(n), np.zeros(n))
    spent: dict[str, list[float]] = {name: [] for name in drives}
    for _ in range(TURNS):
        for name, drive in drives.items():
            core = Machine(of, body, drive, Sensors(), direct).core(STEP)
            state, currents, load = state_of(place), level.copy(), np.zeros(6)
            core.follow(currents)
            begin = time.process_time()
            for k in range(steps // PER_PERIOD):
                asked = level * (1.0 + sway * np.sin(0.3 * k + np.arange(n)))
                state[:] = state_of(place)
                core.advance(
                    STEP, PER_PERIOD, ohms * asked if name == "voltage" else asked, state, currents, load
                )
            spent[name].append(1e6 * (time.process_time() - begin) / steps)
    for name, times in spent.items():
        ratio = np.median(np.array(times) / np.array(spent["ideal"]))
        print(f"{name:20s} {np.median(times):8.2f} us a step, {ratio:.2f} of ideal")


if __name__ == "__main__":
    main()
