"""The fuzz target of the core's map files: valid seeds are accepted and evaluated, and planted faults are found."""

import shutil
import subprocess

import pytest

from tests.interop.conftest import STRICT

# Without this check a position from a file is used unchecked.
CHECK = "if (!fieldmap_iron_positions(map->law, map->p, 1, 0, map->n_laws - 1)) return FIELDMAP_DAMAGED;"


@pytest.fixture(scope="module")
def script(program):
    return program("fuzz_core", "dev")


@pytest.fixture(scope="module")
def seeds(script, tmp_path_factory):
    return script.seeds(tmp_path_factory.mktemp("fuzz") / "seeds")


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
def test_seeds_are_accepted_and_asked(script, seeds, tmp_path):
    program = tmp_path / "open_map"
    command = ["gcc", *STRICT, "-DOPEN_MAP_MAIN", "-I", script.CORE, script.TARGET, "-lm", "-o", program]
    subprocess.run(command, check=True, capture_output=True, text=True)
    for path in seeds.iterdir():
        done = subprocess.run([program, path], cwd=tmp_path, capture_output=True, text=True, check=True)
        accepted, solved = (int(word) for word in done.stderr.split()[1::2])
        # From its file and in memory; for saturating iron also its fields in memory.
        iron = path.name.startswith("iron")
        assert accepted == (0 if path.name == "hermite" else 3 if iron else 2), path.name
        assert (solved > 10) == iron
    assert not list(tmp_path.glob("open_map.*"))


@pytest.mark.skipif(shutil.which("clang") is None, reason="no clang on this machine")
def test_a_missing_check_is_found(script, seeds, tmp_path):
    core = tmp_path / "core"
    core.mkdir()
    for path in script.CORE.glob("*.h"):
        text = path.read_text()
        (core / path.name).write_text(text.replace(CHECK, ""))
    assert CHECK in (script.CORE / "iron.h").read_text()
    found = script.fuzzed(
        script.built(tmp_path / "open_map", core), seeds, tmp_path / "corpus", tmp_path / "findings", 60
    )
    assert len(found.findings) == 1
