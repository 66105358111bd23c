"""The timing of controllers runs on stable loops; their speed is not tested."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).parents[2] / "scripts"


def test_section_prints_every_way():
    arguments = [sys.executable, str(SCRIPTS / "benchmark.py"), "--only", "controllers", "--quick", "--json"]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    rows = json.loads(done.stdout)["controllers"]["rows"]
    assert len(rows) == 5
    assert all(row["steps_per_second"] > 0 for row in rows)


def test_what_is_timed_is_levitation(monkeypatch):
    """Steps of 0.1 mm arrive with both controllers, within the sensor noise."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    section = importlib.import_module("benchmarks.controllers")
    for name, _, work in section.ways(3, 2000):
        if "plant" in name:
            y = work().y
            assert np.abs(y[:, 1500:].mean(axis=1) - 1e-4).max() < 1e-5, name
