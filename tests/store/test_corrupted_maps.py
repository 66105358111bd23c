"""Corrupted maps: refused, or read as they were; never other numbers, never another error, never a crash. A thousand of
them are a row of the validation."""

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
    assert done.returncode == 0, done.stderr[-2000:]  # a crash: the last line names the case
    found = json.loads(done.stdout)
    assert not [*found["wrong"], *found["traceback"], *found["hung"]]
    assert found["refused"] + found["identical"] == COUNT
    # Bytes that HDF5 does not use, and attributes that nobody reads, may be corrupted; but not most of them.
    assert COUNT / 10 < found["identical"] < COUNT / 4
