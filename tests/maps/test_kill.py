"""kill -9 in the middle of making a map; the next run goes on and gives the same bytes."""

import signal
import subprocess
import sys

import h5py
import pytest

from fieldmap.maps import generate, generation
from fieldmap.store import partial_path

KILLED_RUN = """
import os, signal, sys
from fieldmap.maps import generate

def die(text, share):
    if sys.argv[3] in text:
        os.kill(os.getpid(), signal.SIGKILL)

generate(sys.argv[1], sys.argv[2], progress=die)
"""


RECIPE = """
format = 1
title = "Thirteen parts"
device = "loop_and_sphere"
spacing_mm = [1.4, 0.7, 0.5]
"""


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """A recipe whose map is made in 13 parts."""
    path = tmp_path_factory.mktemp("recipe") / "sphere.toml"
    path.write_text(RECIPE)
    return path


@pytest.fixture(scope="module")
def whole(recipe):
    """Its map, made without a break."""
    return generate(recipe, recipe.with_name("whole.h5"))


def all_numbers(path):
    with h5py.File(path) as file:
        records = file["/data/0/meshes"].values()
        return {data.name: data[()].tobytes() for record in records for data in record.values()}


@pytest.mark.parametrize(
    ("moment", "parts"),
    [("part 1 of", 0), ("part 4 of", 3), ("measuring", 13)],
    ids=["first", "middle", "last"],
)
def test_resumed_after_a_kill(recipe, whole, tmp_path, monkeypatch, moment, parts):
    target = tmp_path / "map.h5"
    command = [sys.executable, "-c", KILLED_RUN, str(recipe), str(target), moment]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert not target.exists()
    assert partial_path(target).exists()
    told = []
    with monkeypatch.context() as patch:
        patch.setattr(generation, "solve_linear", None)  # the kept solution is used, nothing is solved again
        generate(recipe, target, progress=lambda text, share: told.append(text))
    if parts:
        assert f"resumed with {parts} of 13 parts" in told
    assert all_numbers(target) == all_numbers(whole)
    assert not partial_path(target).exists()
