"""Cores and angles of eight coils for the strongest isotropic force on a bead of soft iron: docs/optimise.md.

    python scripts/studies/eight_coil_optimum.py [--kept FOLDER]

The machine is `eight_coils` with three free numbers: the radius of the cores, with windings of the same wire that fill
the space up to a fixed outer radius, and the elevations of both rings of four. Currents I exert the force
F = c grad(B^2)/2 on a bead in the middle, which is quadratic in I. At a given power P = R I^2 of all coils together the
largest force along u is P/R times the largest eigenvalue of the matrix of u . F. The smallest of these forces over all
directions is the isotropic force. It is the radius of the largest ball of forces that constant or alternating currents
can make on average. Iron is linear, and the bead far from saturation. Designs are kept in FOLDER.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import fieldmap as fm
from fieldmap.device.model import Device
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solution import LinearState
from fieldmap.studies import Limit, Number, Optimum, Variable

# Diameter of the bead, m, and power, W.
BEAD, POWER = 4e-3, 100.0
MU0, COPPER = 4e-7 * np.pi, 1.72e-8
# Cross section of the wire, m^2: 6.5 A/mm^2 at 10 A, as in eight_coils.
WIRE = 10 / 6.5e6
# Least angle between the axes of neighbours, degrees, at which 1 mm is between windings of radius 34.5 mm at 75 mm.
CLEAR = 50.7
DIRECTIONS = 2000
# Refinement of the search, and the factor by which the check is finer.
COARSE, FINER = 0.5, 2.0

PARAMETERS = """[parameters]
radius = 21.0   # of the cores, mm
level = 0.0     # degrees below the horizontal plane, of the first four
tilt = 45.0     # of the others

[material.steel]
"""
# Radius and both elevations: the shipped machine, and thin cores.
STARTS = ((21.0, 0.0, 45.0), (16.0, -5.0, 50.0))
# Text of the shipped file -> its replacement.
EXPRESSIONS = {
    "[material.steel]\n": PARAMETERS,
    "radius_mm = 21.0": 'radius_mm = "= radius"',
    "inner_radius_mm = 22.5": 'inner_radius_mm = "= radius + 1.5"',
    "turns = 900": 'turns = "= 900 * (33 - radius) / 12"',
    "position_mm = [65.0, 0.0, 0.0]": 'position_mm = ["= 65*cosd(level)", 0.0, "= -65*sind(level)"]',
    "rotation_deg = [0.0, 90.0, 0.0]": 'rotation_deg = [0.0, "= 90 + level", 0.0]',
    "position_mm = [32.5, 32.5, -45.96194]": (
        'position_mm = ["= 65*cosd(tilt)*cosd(45)", "= 65*cosd(tilt)*cosd(45)", "= -65*sind(tilt)"]'
    ),
    "rotation_deg = [0.0, 135.0, 45.0]": 'rotation_deg = [0.0, "= 90 + tilt", 45.0]',
    "position_mm = [170.0, 0.0, 0.0]": 'position_mm = ["= 170*cosd(level)", 0.0, "= -170*sind(level)"]',
    "position_mm = [85.0, 85.0, -120.20815]": (
        'position_mm = ["= 170*cosd(tilt)*cosd(45)", "= 170*cosd(tilt)*cosd(45)", "= -170*sind(tilt)"]'
    ),
}
VARIABLES = {"radius": (14.0, 26.0), "level": (-50.0, 30.0), "tilt": (30.0, 65.0)}


def machine() -> str:
    """Text of the shipped device with free numbers."""
    source = fm.read_device("eight_coils").source
    assert source is not None
    text = source.read_text(encoding="utf-8")
    for old, new in EXPRESSIONS.items():
        assert old in text, old
        text = text.replace(old, new)
    material = (source.parent / "materials").resolve().as_posix()
    return text.replace('file = "materials', f'file = "{material}')


def directions(count: int = DIRECTIONS) -> np.ndarray:
    """Unit vectors (n, 3) evenly over the sphere."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])


def forces_of_currents(device: Device, state: LinearState) -> np.ndarray:
    """Matrices (3, c, c), N, of the force on the bead in the middle, for unit vectors of currents scaled to the
    power."""
    field, gradient = state.solution.unit_fields(np.zeros((1, 3)))
    # F_j = pi d^3/(2 mu0) B . dB/dx_j on a ball of diameter d that is much more permeable than air.
    by_pair = 0.5 * np.pi * BEAD**3 / MU0 * np.einsum("ai,bij->jab", field[:, 0], gradient[:, 0])
    forces = 0.5 * (by_pair + by_pair.swapaxes(1, 2))
    return forces * POWER / resistance_of(device)


def resistance_of(device: Device) -> float:
    """Resistance of each winding, ohm."""
    coil = device.coils[0]
    return COPPER * np.pi * (coil.inner_radius + coil.outer_radius) * coil.turns / WIRE


def largest_forces(device: Device, state: LinearState) -> np.ndarray:
    """Largest force (n,), N, along each of the directions at the power, for any force across the direction."""
    along = np.einsum("nj,jab->nab", directions(), forces_of_currents(device, state))
    return np.linalg.eigvalsh(along)[:, -1]


def steady_force(device: Device, state: LinearState, starts: int = 20) -> float:
    """Largest force, N, of constant currents along the worst of the 26 directions to faces, edges and corners of a
    cube, without a force across it: the best result of local searches."""
    forces, random = forces_of_currents(device, state), np.random.default_rng(0)
    found = []
    for u in np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0:
        axes = np.linalg.svd(u[None])[2] * np.sign(np.linalg.svd(u[None])[0])
        along, *across = np.einsum("nj,jab->nab", axes, forces)
        zero = [{"type": "eq", "fun": lambda x, q=q: 1e4 * x @ q @ x} for q in across]
        limit = {"type": "ineq", "fun": lambda x: 1 - x @ x}
        tries = (
            minimize(lambda x, q=along: -1e4 * x @ q @ x, x, constraints=[*zero, limit])
            for x in 0.3 * random.normal(size=(starts, len(along)))
        )
        found.append(max(-1e-4 * one.fun for one in tries if one.success))
    return min(found)


def isotropic_force(device: Device, state: LinearState) -> float:
    """The smallest of `largest_forces`, N."""
    return float(largest_forces(device, state).min())


def left_by_saturation(device: Device, state: LinearState) -> float:
    """Share of the isotropic force that remains with saturating steel, at the same currents."""
    along = np.einsum("nj,jab->nab", directions(), forces_of_currents(device, state))
    values, vectors = np.linalg.eigh(along)
    worst = int(values[:, -1].argmin())
    amperes = vectors[worst, :, -1] * np.sqrt(POWER / resistance_of(device))
    solved = NonlinearSolver(device, COARSE * FINER).solve(amperes)
    middle = np.zeros((1, 3))
    force = 0.5 * np.pi * BEAD**3 / MU0 * solved.field(middle)[0] @ solved.gradient(middle)[0]
    return float(force @ directions()[worst] / values[worst, -1])


def smallest_angle(device: Device, state: LinearState) -> float:
    """Angle between the axes of the two closest windings, degrees."""
    axes = np.array([coil.placement.rotation[:, 2] for coil in device.coils])
    cosine = axes @ axes.T - 2 * np.eye(len(axes))
    return float(np.degrees(np.arccos(cosine.max())))


def optimised(start: dict[str, float], kept: Path) -> Optimum:
    """The best machine from a start."""
    variables = [Variable(f"parameters.{name}", *VARIABLES[name], start[name]) for name in VARIABLES]
    return fm.optimise(
        machine(),
        variables,
        Number("isotropic force", of=isotropic_force),
        [Limit(Number("smallest angle", of=smallest_angle), lower=CLEAR)],
        maximise=True,
        saturating=False,
        refinement=COARSE,
        check_refinement=FINER,
        method="COBYQA",
        solves=60,
        tolerance=2e-3,
        output=kept,
    )


def row(name: str, found: Optimum) -> str:
    """One line of the table."""
    values = ", ".join(f"{value:.1f}" for value in found.values.values())
    finer = found.verified.objective if found.verified else float("nan")
    (limit,) = found.limits
    force = f"{1e3 * found.value:.3f} | {1e3 * finer:.3f}"
    return f"| {name} | {values} | {force} | {limit.value:.1f} | {len(found.path)} |"


def report(name: str, device: Device) -> None:
    """Forces of a machine on the finer mesh."""
    solved = fm.solve_linear(device, refinement=COARSE * FINER).at(0.0)
    forces = 1e3 * largest_forces(device, solved)
    steady, left = 1e3 * steady_force(device, solved), left_by_saturation(device, solved)
    turns, ohms = device.coils[0].turns, resistance_of(device)
    print(f"{name}: {forces.min():.3f} mN in the worst direction, {forces.max():.3f} in the best", end=", ")
    print(f"{steady:.3f} by steady currents; {100 * left:.0f} % left by saturation; ", end="")
    print(f"{turns:.0f} turns, {ohms:.2f} ohms", flush=True)


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    folder = Path("maps/out/eight_coils_best")
    arguments.add_argument("--kept", type=Path, default=folder, help="folder of the designs")
    folder = arguments.parse_args().kept
    report("as shipped", fm.read_device(machine()))
    for number, values in enumerate(STARTS):
        found = optimised(dict(zip(VARIABLES, values, strict=True)), folder / f"start_{number}.nc")
        begun = ", ".join(f"{value:g}" for value in values)
        print(
            "| start | radius, mm, elevations, deg | force, mN | on the finer mesh | angle, deg | designs |"
        )
        print(f"|{'---|' * 6}")
        print(row(begun, found))
        report("  best", found.device)


if __name__ == "__main__":
    main()
