"""kill -9 in the middle of making a map; the next run goes on and gives the same bytes."""

import signal
import subprocess
import sys

import pytest

from fieldmap.store import checkpoint_path
from tests.store.conftest import numbers_in

# Every run is a process of its own with the kernels from the cache. Code compiled in the same session may be inlined,
# and then rounds differently from the cached code of the next session.
RUN = """
import os, signal, sys
from fieldmap.maps import generate
from fieldmap.maps import generation
from fieldmap.store import map_format

# Parts of one plane of nodes each.
map_format.NODES_PER_CHUNK = 63
recipe, target, moment, solves = sys.argv[1:]
if solves == "no":
    generation.solve_linear = None

def tell(text, share):
    print(text)
    if moment and moment in text:
        os.kill(os.getpid(), signal.SIGKILL)

generate(recipe, target, progress=tell)
"""


def run(recipe, target, moment="", solves="yes"):
    command = [sys.executable, "-c", RUN, str(recipe), str(target), moment, solves]
    return subprocess.run(command, capture_output=True, text=True, check=False)


RECIPE = """
format = 1
title = "Thirteen parts"
device = "loop_and_sphere"
spacing_mm = [1.4, 2.0, 2.0]
"""


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """A recipe whose map is made in 13 parts."""
    path = tmp_path_factory.mktemp("recipe") / "sphere.toml"
    path.write_text(RECIPE)
    return path


@pytest.fixture(scope="module")
def whole(recipe):
    """The map of that recipe, made without a break."""
    run(recipe, recipe.with_name("compiles.h5"))
    done = run(recipe, recipe.with_name("whole.h5"))
    assert done.returncode == 0, done.stderr
    return recipe.with_name("whole.h5")


@pytest.mark.parametrize(
    ("moment", "parts"),
    [("part 1 of", 0), ("part 4 of", 3), ("certifying", 13)],
    ids=["first", "middle", "last"],
)
def test_resumed_after_a_kill(recipe, whole, tmp_path, moment, parts):
    target = tmp_path / "map.h5"
    killed = run(recipe, target, moment)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not target.exists()
    assert checkpoint_path(target).exists()
    # The kept solution is used, and nothing is solved again.
    resumed = run(recipe, target, solves="no")
    assert resumed.returncode == 0, resumed.stderr
    if parts:
        assert f"resumed with {parts} of 13 parts" in resumed.stdout.splitlines()
    assert numbers_in(target) == numbers_in(whole)
    assert not checkpoint_path(target).exists()
