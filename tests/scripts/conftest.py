"""Programs of scripts/ as modules, and sections of the benchmark."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture(scope="session")
def program():
    """program(name, folder): a module of scripts/, or of a folder in it."""

    def module(name, folder=""):
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(SCRIPTS / folder))
            return importlib.import_module(name)

    return module


@pytest.fixture(scope="session")
def benchmark():
    """benchmark(section): the JSON of the quick benchmark of a section."""

    def section(name):
        command = [sys.executable, str(SCRIPTS / "benchmark.py"), "--only", name, "--quick", "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return json.loads(done.stdout)[name]

    return section
