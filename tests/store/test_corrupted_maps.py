"""A thousand corrupted maps: refused, or read as they were; never other numbers, never another error, never a crash."""

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "scripts" / "validation" / "corrupted_maps.py"


def test_a_thousand_corrupted_maps():
    done = subprocess.run([sys.executable, SCRIPT, "1000", "0"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]  # a crash: the last line names the case
    found = json.loads(done.stdout)
    assert not [*found["wrong"], *found["traceback"], *found["hung"]]
    assert found["refused"] + found["identical"] == 1000
    # Bytes that HDF5 does not use, and attributes that nobody reads, may be corrupted; but not most of them.
    assert 100 < found["identical"] < 250
