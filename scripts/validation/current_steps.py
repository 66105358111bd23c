"""Coils of a saturating map, coupled by its flux linkages in the C core: a current step of one coil at its supply
voltage, compared with scipy's integration of the full solver's inductances; and the energy with a swinging magnet.

    python scripts/validate.py --only current_steps
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import fieldmap as fm
from fieldmap.dynamics import CoilDrive, Machine, MatrixAllocation, RigidBody, Sensors, modelled, state_of
from fieldmap.instruments import Amplifier
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import FieldMap, MagneticBody
from validation.coil_energy import balance
from validation.row import Row, timed

STEP, SUPPLY, LEVEL, OHMS, TIME, STEPPED = 1e-4, 40.0, 1.558, 10.0, 0.03, 1
REFINEMENT = 0.4


def current_steps() -> Iterator[Row]:
    """The drive unit on a coarse mesh, from 1.558 A in all coils: 40 V at one coil, constant voltages at the others."""
    device = fm.read_device("drive_unit")
    currents = {"lower_A": 1.0906, "upper_A": 2.0254, "states": 64, "accuracy": 2e-3, "modes": 60}
    currents |= {"points": 600, "held_out": 4, "inductance": True}
    iron = {"model": "saturating", "tolerance": 1e-3, "refinement": REFINEMENT}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "unit.h5")
        opened = fm.open_map(
            fm.generate(device, path, spacing=8e-3, currents=currents, iron=iron), outside_currents="evaluate"
        )
        begin = np.full(len(device.coils), LEVEL)
        volts = OHMS * begin
        volts[STEPPED] = SUPPLY
        found = driven(opened, begin, volts)
        energy = balance(opened, OHMS, LEVEL)
        solver = NonlinearSolver(device, refinement=REFINEMENT)
        wanted, wall, cpu = timed(lambda: solved(solver, begin, volts))
    errors = np.abs(found - wanted).max(axis=0)
    moved = np.abs(wanted - begin).max(axis=0)
    others = np.arange(len(begin)) != STEPPED
    case, source = "40 V at one coil of the drive unit, 30 ms", "states of the solver, inductances by scipy"
    note = f"its current moves by {moved[STEPPED]:.3f} A, the others by up to {moved[others].max():.3f} A"
    yield Row(
        case,
        "current, largest error over its change",
        errors[STEPPED] / moved[STEPPED],
        1e-2,
        source,
        seconds=wall,
        cpu_seconds=cpu,
        note=note,
    )
    yield Row(
        case, "currents of the others, likewise", errors[others].max() / moved[others].max(), 1e-2, source
    )
    note = (
        f"of {energy.given:.0f} J; field energy swings by {energy.field:.2g} J, is off by {energy.miss:.1g} J"
    )
    case, source = "coils of the drive unit, magnet that swings, 10 s", "reduced model in numpy"
    for over, size, bound in (
        ("what is put in", energy.given, 1e-6),
        ("the swing of the field energy", energy.field, None),
    ):
        quantity = f"put in less heat, field energy and work, over {over}"
        yield Row(case, quantity, energy.miss / size, bound, source, note=note)


def driven(opened: FieldMap, begin: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Currents (steps, n) by the C core, without a magnetic payload."""
    n = len(begin)
    body = RigidBody(1.0, [1.0] * 3, MagneticBody(np.zeros((1, 3)), np.zeros((1, 3))), gravity=0.0)
    amplifier = Amplifier(1.0, current_lower=-1e9, current_upper=1e9)
    drive = CoilDrive(amplifier, n, resistance=OHMS, mode="voltage", supply=(-SUPPLY, SUPPLY))
    direct = MatrixAllocation(np.eye(n), np.zeros(n))
    core = Machine(modelled(opened), body, drive, Sensors(), direct).core(STEP)
    state, currents, load = state_of(np.mean(opened.bounds, axis=0)), begin.copy(), np.zeros(6)
    rows = []
    for _ in range(round(TIME / STEP)):
        core.advance(STEP, 1, volts, state, currents, load)
        rows.append(currents.copy())
    return np.array(rows)


def solved(solver: NonlinearSolver, begin: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Currents (steps, n) by integration of di/dt = L(i)^-1 (V - R i)."""

    def rates(_: float, currents: np.ndarray) -> np.ndarray:
        state = solver.solve(currents, 1e-4)
        return np.linalg.solve(solver.differential_inductance(state), volts - OHMS * currents)

    times = STEP * np.arange(1, round(TIME / STEP) + 1)
    return solve_ivp(rates, (0, times[-1]), begin, t_eval=times, rtol=1e-4, atol=1e-5).y.T
