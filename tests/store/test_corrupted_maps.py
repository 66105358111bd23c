"""Corrupted maps are refused, or read unchanged; never with other numbers, another error, or a crash. `make validate`
has a thousand of them."""

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "scripts" / "validation" / "corrupted_maps.py"


COUNT = 250


def test_corrupted_maps():
    done = subprocess.run(
        [sys.executable, SCRIPT, str(COUNT), "0"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]  # after a crash the last line names the case
    found = json.loads(done.stdout)
    assert not [*found["wrong"], *found["traceback"], *found["hung"]]
    assert found["refused"] + found["identical"] == COUNT
    # Corruption of bytes that HDF5 does not use, and of attributes that nobody reads, is harmless, but is not the rule.
    assert COUNT / 10 < found["identical"] < COUNT / 4
