"""Maps are opened and asked without numba: only who calls them in functions that it compiles needs it."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from fieldmap.store import Grid, MapData, write_map

TEXT = """
import sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name in ("numba", "llvmlite"):
            raise ImportError(f"{name} is asked for")
sys.meta_path.insert(0, Refused())

import numpy as np
from fieldmap import dynamics, instruments, interop, levitation
from fieldmap.device.payload import MagnetSphere, Payload, SoftSphere
from fieldmap.lookup import compiled_wrench, interpolate, magnetic_body
from fieldmap.store import Grid, MapData

grid = Grid([-0.01] * 3, [0.005] * 3, (5, 5, 5))
slope = np.array([np.diag([2.0, 0.0, -2.0]), np.diag([0.0, 1.0, -1.0])])
flux = np.einsum("cij,pj->cpi", slope, grid.points()) + [0.0, 0.0, 0.01]
gradient = np.broadcast_to(slope[:, None, None, None], (2, 5, 5, 5, 3, 3))
data = MapData(grid, ("a", "b"), [1.0, 1.0], flux_density=flux.reshape(2, 5, 5, 5, 3), gradient=gradient)
place, nan = np.array([0.001, 0.0, 0.002]), np.nan
body = magnetic_body(Payload(mass=1e-3, pieces=[MagnetSphere(2e-3, 1.2), SoftSphere(3e-3, mu_r=1e3)]))
for kind in ("harmonic", "hermite", "global"):
    m = interpolate(data, kind)
    assert abs(m.field(place, [3.0, 0.0])[0] - 0.006) < 1e-9
    assert np.isfinite(m.wrench(place, body, [3.0, 1.0])).all()
    assert np.isfinite(m.actuation(place, [3.0, 1.0], body).matrix).all()
    found = m.currents_for(place, [nan, nan, 0.11], [0.0, 0.0, 0.8])
    assert abs(m.wrench(place, [0.0, 0.0, 0.8], found)[2] - 0.11) < 1e-9
asked = 0
for call in (m.compiled, m.at(1.0).compiled, lambda: compiled_wrench(m, body)):
    try:
        call()
    except ImportError:
        asked += 1
print(asked, "numba" in sys.modules)
"""


def test_nothing_of_a_lookup_asks_for_numba():
    command = [sys.executable, "-c", TEXT]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False)
    assert done.stdout == "3 False\n", done.stderr


def test_opening_a_map_loads_neither_scipy_nor_the_schemas_of_files(tmp_path):
    """They take longer to load than a first lookup."""
    path = tmp_path / "m.h5"
    grid = Grid([-0.01] * 3, [0.005] * 3, (5, 5, 5))
    slope = np.diag([2.0, 0.0, -2.0])
    data = MapData(
        grid,
        ("a",),
        [1.0],
        flux_density=(grid.points() @ slope).reshape(1, 5, 5, 5, 3),
        gradient=np.broadcast_to(slope, (1, 5, 5, 5, 3, 3)),
    )
    write_map(path, data)
    text = f"""
import sys
import fieldmap as fm
print(fm.open_map({str(path)!r}).field([0.001, 0.0, 0.0], [3.0])[0])
print(sorted({{"scipy.linalg", "scipy.optimize", "scipy.sparse", "pydantic", "numba"}} & set(sys.modules)))
"""
    command = [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False)
    field, loaded = done.stdout.splitlines()
    assert abs(float(field) - 0.006) < 1e-9
    assert loaded == "[]", done.stderr
