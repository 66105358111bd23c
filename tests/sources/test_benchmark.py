"""The benchmark runs and its figures are those of agreeing kernels; how fast they are is not tested here."""

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark.py"


def test_benchmark_prints_a_row_per_kernel():
    arguments = [sys.executable, str(SCRIPT), "--points", "300", "--repetitions", "1", "--json"]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    rows = json.loads(done.stdout)["rows"]
    assert [row["kernel"].split(" (")[0] for row in rows] == [
        "circular loop",
        "cylindrical sheet",
        "charged triangle",
        "circular coil",
        "rounded square coil",
    ]
    for row in rows:
        assert row["difference"] < 1e-6
        assert row["field_ns"] > 0
        assert row["ratio"] > 0
