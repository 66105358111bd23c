"""Many independent currents: a disk with a core in each coil, all of one saturating iron.

The mesh may be coarse, because the model of the currents is compared with the solver on the same mesh.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Body, Box, CircularCoil, Cylinder, Device, Froehlich, WorkspaceBox, placed
from fieldmap.parallel import same_arithmetic
from fieldmap.store import MapData, read_map
from validation.row import Array, Row, timed
from validation.saturating.trial import STATED_BOUND, Difference, extreme_shares, stated_errors

COILS, ACCURACY, STATES = 64, 2e-2, 12
LOWER_A, UPPER_A = -2.0, 4.0
SPACING = 2.5e-3
_PITCH, _CORE, _HEIGHT, _MESH = 22e-3, 8e-3, 20e-3, 30e-3
_SEED = 47


def disk_with_cores(count: int) -> Device:
    """A disk on square cores, each in a coil. The cores are on a square grid, each moved by up to 1 mm, so that no
    state is the mirror image of another."""
    side = int(np.ceil(np.sqrt(count)))
    axis = _PITCH * (np.arange(side) - 0.5 * (side - 1))
    places = np.array([(x, y) for x in axis for y in axis])[:count]
    places = places + np.random.default_rng(_SEED).uniform(-1e-3, 1e-3, places.shape)
    radius = float(np.linalg.norm(places, axis=1).max()) + _CORE
    disk = Body("disk", "steel", Cylinder(radius, 8e-3), _MESH).moved([0.0, 0.0, _HEIGHT])
    core = Box((_CORE, _CORE, _HEIGHT))
    cores = [Body(f"core {k}", "steel", core, _MESH).moved([*at, 0.0]) for k, at in enumerate(places, 1)]
    coils = [
        CircularCoil(f"{k}", 6e-3, 8.5e-3, 14e-3, 1000.0, placement=placed([*at, 0.5 * _HEIGHT]))
        for k, at in enumerate(places, 1)
    ]
    half = 0.3 * _PITCH * side
    box = WorkspaceBox(np.array([-half, -half, -20e-3]), np.array([half, half, -10e-3]))
    steel = {"steel": Froehlich("steel", mu_r=2000.0, saturation=2.0)}
    return Device(
        "disk", f"{count} cores", coils=coils, bodies=[disk, *cores], materials=steel, workspace=box
    )


def made(device: Device, target: Path, **currents: Any) -> MapData:
    """Make the map of a device with independent currents in all coils."""
    asked = {"lower_A": LOWER_A, "upper_A": UPPER_A, "accuracy": ACCURACY} | currents
    path = fm.generate(device, target, spacing=SPACING, currents=asked, iron={"reaction": False})
    return read_map(path)


def true_errors(device: Device, data: MapData, count: int, seed: int = _SEED) -> dict[str, Array]:
    """Largest errors (2,) of flux density and gradient against the solver at `count` random states and at `count`
    extremes, relative to the largest value of the same state."""
    domain, difference = data.reduced_model.domain, Difference(device, 1.0, data)
    drawn = {
        "random states": np.random.default_rng(seed).random((count, len(domain.lower))),
        "extremes": np.random.default_rng(seed).permutation(extreme_shares(domain))[:count],
    }
    with same_arithmetic():
        return {
            name: np.max([difference(domain.at(one)) for one in shares], axis=0)
            for name, shares in drawn.items()
        }


def many_coils() -> Iterator[Row]:
    """64 coils, at random states and at extremes outside the training."""
    device = disk_with_cores(COILS)
    with tempfile.TemporaryDirectory() as folder:
        data, wall, cpu = timed(lambda: made(device, Path(folder) / "map.h5"))
        report = data.provenance.solver_report
        errors = true_errors(device, data, STATES)
    found = (
        f"{report['states_solved']} states solved, {report['states_trained_on_solved']} of them to train on; "
        f"{report['modes']} modes, {report['sample_points']} points; "
        f"{report['generation_peak_memory_bytes'] / 1e9:.2g} GB"
    )
    cost = (report["surface_faces"], 0, wall, cpu, found)
    case, by = f"{COILS} independent coils", "solved states"
    names = ("B", "gradient")
    for name, both in errors.items():
        for what, true, stated, asked in zip(names, both, stated_errors(data), (2.0, 4.0), strict=True):
            yield Row(case, f"error of {what}, {STATES} {name}", true, asked * ACCURACY, by, *cost)
            yield Row(case, f"true by stated error of {what}, {name}", true / stated, STATED_BOUND, by, *cost)
