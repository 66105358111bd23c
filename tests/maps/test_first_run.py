"""The run that compiles kernels, the first after an installation, gives the bits of later ones."""

import os
import subprocess
import sys

import numpy as np
import pytest

from tests.store.conftest import numbers_in

LOOKUPS = """
import sys
import numpy as np
import fieldmap as fm
from fieldmap.cli import main

main(["map", "division_quick", "-o", sys.argv[1], "--fresh", "--quiet"])
found = {}
for kind in ("harmonic", "hermite", "global"):
    m = fm.open_map(sys.argv[1], kind=kind)
    points = np.random.default_rng(1).uniform(m.lower, m.upper, (200, 3))
    currents = m.parametrisation.currents([1.7, 0.1, -0.2])
    found[f"{kind}, all"] = m.field(points, currents)
    found[f"{kind}, one by one"] = [m.gradient(point, currents) for point in points]
np.savez(sys.argv[2], **found)
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folders of a run that compiles, and of one that finds what the first left."""
    folder = tmp_path_factory.mktemp("first_run")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "kernels")}
    for name in ("first", "second"):
        out = folder / name
        out.mkdir()
        command = [sys.executable, "-c", LOOKUPS, str(out / "map.h5"), str(out / "lookups.npz")]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    return folder / "first", folder / "second"


def test_of_a_saturating_map(runs):
    first, second = (numbers_in(folder / "map.h5") for folder in runs)
    assert len(first) > 100
    assert first == second


def test_of_lookups(runs):
    first, second = (np.load(folder / "lookups.npz") for folder in runs)
    assert [name for name in first if not np.array_equal(first[name], second[name])] == []
    assert len(first.files) == 6
