"""Controllers, identification and instruments need numba only for compiled user functions."""

import subprocess
import sys
from pathlib import Path

TEXT = """
import sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name in ("numba", "llvmlite"):
            raise ImportError(f"{name} is asked for")
sys.meta_path.insert(0, Refused())
import numpy as np
from fieldmap import control, instruments
from fieldmap.control import identification

plant, pid = ([-0.03, 0.0298], [1, -1.915, 0.91405]), control.PID(0.334, 0.007, 0.001, 2e-3, acts_on_minus_error=True)
run = control.simulate_loop(plant, pid, np.ones(1500))
assert abs(run.y[0, -1] - 1) < 1e-3 and control.RunningPID(pid).step(0.0, 0.0) == 0.0
orders = identification.Orders(2, 1)
random = np.random.default_rng(1).normal(size=(2, 300))
identification.least_squares(*random, orders, 2e-3), identification.recursive_least_squares(*random, orders)
instruments.watch(instruments.Micrometer(0.0, 1.0, scan_rate=100.0), [0.0, 1.0], [0.0, 1.0], 0.1)
law = control.FunctionController(lambda time, measured, reference, state: 1.0)
assert law.form == "python" and law.bound(["lift"]).address and "numba" not in sys.modules
try:
    control.C_SIGNATURE
except ImportError:
    print("done")
"""


def test_nothing_else_asks_for_numba():
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", TEXT],
        capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False,
    )  # fmt: skip
    assert (ran.stdout, ran.stderr) == ("done\n", "")
