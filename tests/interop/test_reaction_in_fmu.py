"""The iron's reaction to the magnet in units for other simulators, read by FMPy."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from fieldmap.interop import write_fmu
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData, StoredReaction
from tests.interop.test_c_map import wave, wrench_by_hand

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


def test_the_wrench_has_the_reaction_by_hand(fmpy, tmp_path):
    """One coil, and two fields of a reaction, of which one counts negatively."""
    grid = Grid([-0.01, -0.01, -0.02], [0.004, 0.005, 0.0025], (6, 5, 5))
    x, y, z = np.moveaxis(grid.points().reshape(6, 5, 5, 3), -1, 0)
    coil, *parts = (wave(x, y, z, k, phase) for k, phase in ((60.0, 0.3), (50.0, 0.2), (70.0, 0.9)))
    flux, slope = (np.stack(values) for values in zip(*parts, strict=True))
    data = MapData(grid, ("1",), [1.0], flux_density=coil[0][None], gradient=coil[1][None])
    stored = StoredReaction(flux, slope, repelled=1)
    m, fields = interpolate(replace(data, reaction=stored)), interpolate(stored.on(grid))
    moment, point, currents = np.array([0.1, 0.0, 0.5]), np.array([0.001, -0.002, -0.015]), [[0.0], [1.5]]
    unit = write_fmu(m, tmp_path / "lift.fmu", magnet=moment)
    poses = np.tile([*point, 1.0, 0.0, 0.0, 0.0], (2, 1))
    found = fmpy(tmp_path, kind="ask", path=str(unit), poses=poses, currents=np.array(currents))["outputs"]
    b, g = fields.unit_field(point), fields.unit_gradient(point)
    weights = np.array([1.0, -1.0]) * (b @ moment)
    for ours, amperes in zip(found, currents, strict=True):
        there = m.field_and_gradient(point, amperes)
        whole = [there[0] + weights @ b, there[1] + np.tensordot(weights, g, 1)]
        exact = np.concatenate(wrench_by_hand([part[None] for part in whole], moment[None]), axis=1)[0]
        assert ours[12:] == pytest.approx(exact, rel=1e-12, abs=1e-13)
        assert np.abs(exact).max() > 1e-6
