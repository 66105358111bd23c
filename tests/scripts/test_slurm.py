"""The script for a SLURM cluster: what it would submit, and a map made by jobs on this machine."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fieldmap.maps import generate
from fieldmap.store import read_map

SCRIPT = Path(__file__).parents[2] / "scripts" / "slurm.py"

DEVICES = Path(__file__).parents[1] / "devices"
DEVICE = (DEVICES / "one_coil.toml").read_text()

RECIPE = """
format = 1
title = "Above a coil"
device = "loop.toml"
spacing_mm = [0.25, 2.0, 2.0]
"""


def run(*arguments, folder=None):
    command = [sys.executable, "-W", "error", SCRIPT, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_what_slurm_is_asked_for():
    options = "--cores 4 --memory 16GB --walltime 02:30:00 --queue batch --account lab --print"
    lines = run(*options.split())
    wanted = ("-J fieldmap", "-p batch", "-A lab", "-n 1", "--cpus-per-task=4", "--mem=15G", "-t 02:30:00")
    for directive in wanted:
        assert f"#SBATCH {directive}" in lines
    worker = next(line for line in lines if "dask_worker" in line)
    for option in ("--nthreads 1", "--nworkers 4", "--nanny", "--lifetime 145m"):
        assert option in worker


def test_a_map_made_by_jobs(tmp_path):
    (tmp_path / "loop.toml").write_text(DEVICE)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    jobs = ["--jobs", "2", "--cores", "1", "--memory", "2GB", "--try"]
    run(*jobs, "map", "recipe.toml", "-o", "jobs.h5", folder=tmp_path)
    ours = read_map(tmp_path / "jobs.h5")
    assert ours.provenance.solver_report["workers"] == "workers of a dask scheduler"
    alone = read_map(generate(tmp_path / "recipe.toml", tmp_path / "alone.h5"))
    # Bits are compared in tests/maps, where every kernel comes from the cache.
    for one, other in ((ours.flux_density, alone.flux_density), (ours.gradient, alone.gradient)):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


@pytest.fixture(autouse=True)
def _no_configuration(monkeypatch, tmp_path):
    """Whoever runs this may have settings of dask for a cluster of their own."""
    monkeypatch.setenv("DASK_CONFIG", str(tmp_path / "none"))
