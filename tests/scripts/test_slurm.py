"""The script for a SLURM cluster: the submitted jobs, and a map made by jobs on this machine."""

import os
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


SLURM = """#!/bin/sh
# In the place of sbatch: runs the tasks of a script one after the other.
echo "$@" >> asked.txt
cat > job.sh
tasks=$(sed -n 's/^#SBATCH --array=1-//p' job.sh)
for SLURM_ARRAY_TASK_ID in $(seq ${tasks:-1}); do
    export SLURM_ARRAY_TASK_ID
    sh job.sh >> log.txt 2>&1 || exit 1
    ls -d loops/*.h5 loops.nc 2>/dev/null | wc -l >> there.txt
done
echo "77;cluster"
"""

LOOPS = """
format = 1
title = "Loops"
recipe = "recipe.toml"

[[vary]]
name = "turns"
key = "coil.*.turns"
values = [100, 200, 300, 400, 500]
"""


def test_many_maps_by_an_array_job(tmp_path, monkeypatch):
    for name, text in (
        ("loop.toml", DEVICE),
        ("recipe.toml", RECIPE),
        ("loops.toml", LOOPS),
        ("sbatch", SLURM),
    ):
        (tmp_path / name).write_text(text)
    (tmp_path / "sbatch").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(SCRIPT.parents[1]))
    asked = ["--array", "2", "--cores", "3", "--queue", "batch"]
    command = ["map", "recipe.toml", "--over", "loops.toml", "-o", "loops.nc"]
    lines = run(*asked, "--print", *command)
    for directive in ("--array=1-2", "--cpus-per-task=3", "--partition=batch", "--mem=16G", "--ntasks=1"):
        assert f"#SBATCH {directive}" in lines
    assert run(*asked, *command, folder=tmp_path) == ["77", "77"]
    assert (tmp_path / "asked.txt").read_text().splitlines() == [
        "--parsable",
        "--parsable --dependency=afterany:77",
    ]
    # Two maps after the first task, three more after the second, and then the index.
    assert (tmp_path / "there.txt").read_text().split() == ["2", "5", "6"]


def test_a_map_made_by_jobs(tmp_path):
    (tmp_path / "loop.toml").write_text(DEVICE)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    jobs = ["--jobs", "2", "--cores", "1", "--memory", "2GB", "--try"]
    run(*jobs, "map", "recipe.toml", "-o", "jobs.h5", folder=tmp_path)
    ours = read_map(tmp_path / "jobs.h5")
    assert ours.provenance.solver_report["workers"] == "workers of a dask scheduler"
    alone = read_map(generate(tmp_path / "recipe.toml", tmp_path / "alone.h5"))
    # Equal bits are tested in tests/maps, where all kernels come from the cache.
    for one, other in ((ours.flux_density, alone.flux_density), (ours.gradient, alone.gradient)):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


@pytest.fixture(autouse=True)
def _no_configuration(monkeypatch, tmp_path):
    """The tests ignore the user's dask configuration for a cluster."""
    monkeypatch.setenv("DASK_CONFIG", str(tmp_path / "none"))
