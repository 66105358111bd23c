"""Functions that work with the core alone, and messages for a missing extra, in subprocesses."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.only_these import PROJECT, distributions, name_of

ROOT = Path(__file__).parents[1]
CORE = {"numpy", "h5py", "pydantic", "threadpoolctl"}

ASK = """
import fieldmap as fm

m = fm.open_map("sample")
currents = m.currents_for([0, 0, -0.1], [0.0, 0.0, 0.1], [0.0, 0.0, 1.0])
answer = {
    "field": m.field([0, 0, -0.1], 1.0).tolist(),
    "wrench": m.wrench([0, 0, -0.1], [0.0, 0.0, 1.0], currents).tolist(),
}
"""

USE = """
import fieldmap as fm
from fieldmap.lookup import magnetic_body

m = fm.open_map("sample")
device = fm.read_device("disk_six_cores", changes={"driver.current_limit_A": 15.0})
e = fm.find_equilibrium(m, 9.0, device.payload)
wrench = m.wrench(e.position, magnetic_body(device.payload), 9.0)
run = fm.simulate("hold", {"duration_s": 0.1, "start.depth_mm": 95, "field.scale": 2.15}, field_map=m, device=device)
answer = {
    "wrench": wrench.tolist(),
    "weight": device.payload.mass * 9.80665,
    "event": run.event,
    "depth": [float(run.rows[0, 2]), float(run.rows[-1, 2])],
}
"""

ENTRIES = """
from pathlib import Path
import fieldmap as fm
from fieldmap.device.payload import SoftEllipsoid
from fieldmap.errors import MissingExtraError
from fieldmap.lookup import magnetic_body

def checked():
    from fieldmap.iron import check_geometry
    check_geometry(fm.read_device("loop_and_sphere"))

def tabled():
    import numpy as np
    from fieldmap.currents import LiftAndDirections
    from fieldmap.lookup.current_table import spline_table
    nodes = np.linspace(0.0, 1.0, 5)
    spline_table([nodes] * 3, LiftAndDirections(1.25), np.zeros((5, 5, 5, 1)), np.zeros((5, 5, 5, 6, 1)))

def drawn():
    import fieldmap.plot

def figure():
    import fieldmap.plot.runs

def figures():
    from fieldmap.thesis.report import figure_page
    figure_page()

def vtk():
    from fieldmap.device.mesh_files import read_mesh
    Path("body.vtu").touch()
    read_mesh(Path("body.vtu"), 1.0)

ENTRIES = {
    "solve": ("make", lambda: fm.solve(fm.read_device("loop_and_sphere"), 1.0)),
    "solve_linear": ("make", lambda: fm.solve_linear(fm.read_device("loop_and_sphere"))),
    "solve_to_tolerance": ("make", lambda: fm.solve_to_tolerance(fm.read_device("loop_and_sphere"), 0.1)),
    "generate": ("make", lambda: fm.generate("quick", "map.h5")),
    "check_geometry": ("make", checked),
    "as_magpylib": ("make", lambda: fm.open_map("sample").as_magpylib(1.0)),
    "find_equilibrium": ("levitation", lambda: fm.find_equilibrium(fm.open_map("sample"), 9.0, None)),
    "simulate": ("levitation", lambda: fm.simulate("hold")),
    "open_machine": ("levitation", lambda: fm.open_machine("hold")),
    "PID": ("levitation", lambda: fm.control.PID),
    "a table of currents": ("levitation", tabled),
    "a soft ellipsoid": ("levitation", lambda: magnetic_body(SoftEllipsoid((1e-3, 1e-3, 2e-3), mu_r=100.0))),
    "optimise": ("make", lambda: fm.optimise),
    "fieldmap.plot": ("plot", drawn),
    "fieldmap.plot.runs": ("plot", figure),
    "a .vtu file": ("plot", vtk),
    "pages of the thesis": ("cli", figures),
}
answer = {}
for name, (extra, call) in ENTRIES.items():
    try:
        call()
        answer[name] = "worked"
    except MissingExtraError as error:
        (problem,) = error.problems
        found = f'pip install "fieldmap[{extra}]"' in problem.remedy and " must be installed" in problem.must_hold
        answer[name] = "told" if found else str(error)
    except BaseException as error:
        answer[name] = repr(error)
"""

COMMANDS = """
from fieldmap.cli import main

answer = [main(words.split()) for words in sys.argv[1:]]
"""


def result_with(extras, program, folder, *arguments):
    """`answer` after the program, in a subprocess with only these extras; and all printed text."""
    whole = (
        "import json, sys\nfrom only_these import only\n"
        f"only(*{extras!r})\n{program}\nprint(); print(json.dumps(answer))"
    )
    done = subprocess.run(
        [sys.executable, "-c", whole, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        # Not `tests.only_these`, because some installed packages bring their own `tests`.
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stdout + done.stderr


def test_the_core_is_three_libraries_and_what_pins_their_threads():
    assert {name_of(one) for one in PROJECT["dependencies"]} == CORE
    brought = distributions()
    heavy = {
        "scipy",
        "numba",
        "llvmlite",
        "vtk",
        "pyvista",
        "matplotlib",
        "netgen-mesher",
        "pymetis",
        "magpylib",
        "typer",
        "rich",
        "psutil",
        "pandas",
    }
    assert len(brought) < 15
    assert not brought & heavy
    pytest.importorskip("xarray", reason="the extra all is not installed")
    assert heavy <= distributions("all")


@pytest.fixture(scope="module")
def core_alone(tmp_path_factory):
    """The map's results, the messages of the entry points, exit codes, and printed text: in one subprocess, because
    loading the package takes most of the time."""
    program = f"{ASK}\nused = answer\n{ENTRIES}\ntold = answer\n{COMMANDS}\nanswer = used, told, answer"
    (used, told, codes), printed = result_with(
        (), program, tmp_path_factory.mktemp("core"), "check drive_unit"
    )
    return SimpleNamespace(used=used, told=told, codes=codes, printed=printed)


def test_maps_are_asked_with_the_core_alone(core_alone):
    found = core_alone.used
    assert found["field"][2] > 0
    assert found["wrench"][:3] == pytest.approx([0.0, 0.0, 0.1], abs=1e-9)


def test_a_magnet_floats_with_the_extra_for_levitation(tmp_path):
    found, _ = result_with(("levitation",), USE, tmp_path)
    # At the equilibrium the map's force is the weight.
    assert found["wrench"][2] == pytest.approx(found["weight"], rel=1e-6)
    assert np.abs(found["wrench"][:2]).max() < 1e-6 * found["weight"]
    assert found["event"] is None
    assert found["depth"][1] == pytest.approx(found["depth"][0], abs=1e-3)


def test_entries_without_their_extra_name_its_command(core_alone):
    found = core_alone.told
    assert len(found) == 17
    assert set(found.values()) == {"told"}, found


def test_the_program_without_typer_names_its_extra(core_alone):
    assert core_alone.codes == [1]
    assert 'pip install "fieldmap[cli]"' in core_alone.printed
    assert "Traceback" not in core_alone.printed


def test_commands_that_use_maps_need_no_mesher_and_no_pictures(tmp_path):
    words = ("info sample", "probe sample --at 0 0 -0.1 --currents 9 --payload", "check loop_and_sphere")
    codes, printed = result_with(("cli",), COMMANDS, tmp_path, *words, "show loop_and_sphere --save a.png")
    assert codes == [0, 0, 1, 1]
    assert [f"fieldmap[{extra}]" in printed for extra in ("make", "plot")] == [True, True]
    assert "Traceback" not in printed


def test_pictures_of_runs_need_no_mesher(tmp_path):
    program = USE + "from fieldmap.plot.runs import save_run_figure\n"
    program += "save_run_figure('run.png', 'A run', [run])\n"
    result_with(("plot",), program, tmp_path)
    assert (tmp_path / "run.png").stat().st_size > 10_000
