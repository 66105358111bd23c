"""Opening maps and looking up fields, forces and currents needs no scipy, and gives the same numbers without it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fieldmap.store import Grid, MapData, write_map
from tests.dynamics.conftest import saturating_data

# The modules named in the second argument cannot be imported.
REFUSE = """
import json, sys
folder, refused = sys.argv[1], sys.argv[2].split(",")
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in refused:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refused())
"""

USES = """
import contextlib, io
import numpy as np
import fieldmap as fm
from fieldmap import instruments, interop
from fieldmap.cli import main
from fieldmap.device.payload import MagnetSphere, Payload, SoftSphere
from fieldmap.errors import Infeasible
from fieldmap.lookup import compiled_wrench, magnetic_body, soft_sphere_force

answer = {}

def note(name, *values):
    answer[name] = [np.asarray(value, dtype=float).ravel().tolist() for value in values]

nan = np.nan
points = np.random.default_rng(5).uniform(-0.015, 0.015, (40, 3))
place, turned = points[0], np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
body = magnetic_body(Payload(mass=1e-3, pieces=[MagnetSphere(2e-3, 1.2), SoftSphere(3e-3, mu_r=1e3)]))
iron = magnetic_body(SoftSphere(2e-3, material=fm.material("steel_a3")))
maps = {"linear": [1.0, 0.4], "background": [1.0], "division": [1.6, 1.5, 1.6] * 2, "free": [1.0, -2.0, 0.5] * 2}
for file, currents in maps.items():
    for kind in ("harmonic", "hermite", "global"):
        m, name = fm.open_map(f"{folder}/{file}.h5", kind, outside_currents="evaluate"), f"{file} {kind}"
        at, moment = m.at(currents), [0.0, 0.2, 0.8]
        note(f"{name} field", *(of(points, currents) for of in (m.field, m.gradient, m.second_gradient)))
        note(f"{name} potential", m.potential(points, currents) if m.kind != "hermite" else 0.0)
        note(f"{name} at", at.field(place), at.gradient(place), at.wrench(place, moment))
        note(f"{name} batch", m.field(points, np.outer(np.linspace(0.9, 1.0, 40), currents)))
        note(f"{name} wrench", *(m.wrench(points, one, currents, turned) for one in (body, iron)))
        note(f"{name} actuation", m.actuation(place, currents, moment).matrix)
        note(f"{name} sphere", soft_sphere_force(m, points, currents, 2e-3, 500.0))
        if file != "division":
            wanted = [nan, nan, 1.01 * at.wrench(place, moment)[2]]
            note(f"{name} currents", m.currents_for(place, wanted, moment, start=None if m.affine else currents))
m = fm.open_map("sample")
try:
    m.currents_for([0.0, 0.0, -0.1], [0.0, 0.0, 10.0], [0.0, 0.0, 1.0], 3.0)
except Infeasible as error:
    note("too much", error.share, error.reachable)
interop.write_c_map(m, f"{folder}/map.fmap")
interop.write_c_iron_map(fm.open_map(f"{folder}/division.h5"), f"{folder}/iron.fmap")
assert "coils" in m._repr_html_() and "coils" in fm.read_device("disk_six_cores")._repr_html_()
with contextlib.redirect_stdout(io.StringIO()) as printed:
    codes = [main(words.split()) for words in (
        "probe sample --at 0 0 -0.1 --currents 9 --payload --json",
        "currents sample --at 0 0 -0.1 --lift --limit 20 --json",
        f"export {folder}/linear.h5 --to c -o {folder}/a.fmap",
        f"export {folder}/linear.h5 --to csv --currents 1,2 -o {folder}/a.csv --json",
        f"export {folder}/linear.h5 --to fmu -o {folder}/a.fmu --sources",
        f"export {folder}/division.h5 --to c -o {folder}/b.fmap",
    )]
assert codes == [0] * 6, codes
note("printed", np.array(json.JSONDecoder().raw_decode(printed.getvalue())[0]["force"]))
note("scipy", "scipy" in sys.modules)
asked = 0
for call in (m.compiled, m.at(1.0).compiled, lambda: compiled_wrench(m, body)):
    try:
        call()
    except ImportError:
        asked += 1
note("numba", asked)
print(json.dumps(answer))
"""

COMPILED = """
import numpy as np
import fieldmap as fm
from fieldmap.device.payload import MagnetSphere
from fieldmap.lookup import compiled_wrench, magnetic_body
m = fm.open_map(f"{folder}/division.h5")
evaluate, data = m.at([1.6] * 6).compiled()
flux, slope = evaluate(data, 0.001, 0.002, 0.003)
assert np.allclose(flux, m.field([0.001, 0.002, 0.003], [1.6] * 6), rtol=1e-12)
function, data = compiled_wrench(m, magnetic_body(MagnetSphere(2e-3, 1.2)))
wrench, slopes = np.empty(6), np.empty((6, 6))
assert function(data, np.full(6, 1.6), np.array([0.001, 0.002, 0.003]), np.eye(3), wrench, slopes)
print(json.dumps([wrench.tolist(), "scipy" in sys.modules]))
"""

ASKED = """
import contextlib, io
from fieldmap.cli import main

words = ["equilibrium sample --currents 9"] + [f"{name} hold --map sample" for name in ("simulate", "linearise")]
words += ["info sample --json"]
with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.redirect_stderr(io.StringIO()) as told:
    codes = [main(one.split()) for one in words]
print(json.dumps([codes, printed.getvalue(), told.getvalue()]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Small maps of every kind: linear iron, a field that no current drives, and iron that saturates."""
    made = tmp_path_factory.mktemp("maps")
    for free in (False, True):
        write_map(made / f"{'free' if free else 'division'}.h5", saturating_data(free))
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    slope = np.array([np.diag([2.0, 0.0, -2.0]), np.diag([0.0, 1.0, -1.0])])
    flux = np.einsum("cij,pj->cpi", slope, grid.points()) + [0.0, 0.0, 0.01]
    fields = {
        "flux_density": flux.reshape(2, 5, 5, 5, 3),
        "gradient": np.broadcast_to(slope[:, None, None, None], (2, 5, 5, 5, 3, 3)),
    }
    write_map(made / "linear.h5", MapData(grid, ("a", "b"), [1.0, 1.0], **fields))
    beside = {"constant_field": True, "fixed_sources": ("magnet",)}
    write_map(made / "background.h5", MapData(grid, ("a",), [1.0], **beside, **fields))
    return made


def told(program, folder, refused):
    """The JSON output of a program in which these modules cannot be imported."""
    command = [sys.executable, "-c", REFUSE + program, str(folder), refused]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_what_users_of_maps_do_needs_neither_scipy_nor_numba(folder):
    without, whole = (told(USES, folder, refused) for refused in ("scipy,numba,llvmlite", "none"))
    assert without.keys() == whole.keys()
    assert (without["scipy"], without["numba"], whole["numba"]) == ([[0.0]], [[3.0]], [[0.0]])
    for name in without.keys() - {"scipy", "numba"}:
        for one, other in zip(without[name], whole[name], strict=True):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-12), name


def test_compiled_lookups_need_no_scipy(folder):
    wrench, loaded = told(COMPILED, folder, "scipy")
    assert np.abs(wrench).max() > 0
    assert not loaded


def test_commands_that_need_scipy_name_its_extra(folder):
    codes, printed, errors = told(ASKED, folder, "scipy")
    assert codes == [1, 1, 1, 0]
    assert errors.count('pip install "fieldmap[levitation]"') == 3
    assert "Traceback" not in errors
    # A map's contents are printed, except the currents that lift the payload.
    summary = json.loads(printed)
    assert summary["lift"] == []
    assert 'pip install "fieldmap[levitation]"' in summary["lift_missing"]
