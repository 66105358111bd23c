"""Command lines that are refused: exit code 2, what is wrong and its remedy, before anything is solved or written."""

import json
import shlex
from pathlib import Path

import pytest

from fieldmap.cli import main
from tests.conftest import DEVICES

TEXTS = {
    "bad.toml": "format = 1\nname = 3\ncoil = 7\n[payload]\nmass_g = -1\n",
    "syntax.toml": "format = = 1\n",
    "text.h5": "not a map",
    "ball.toml": (DEVICES / "saturating_ball_in_loop.toml").read_text(),
    "table.toml": (DEVICES / "ball_and_slabs.toml").read_text(),
    "scenario.toml": 'format = 1\ntitle = "Held"\nmap = "a.h5"\nduration_s = 1.0\n',
    "study.toml": 'format = 1\ntitle = "Varied"\ndevice = "drive_unit"\n[[vary]]\nkey = "a"\nvalues = [1]\n',
    "readings.csv": "x_mm,y_mm,z_mm,I_a_A,Bx_mT,By_mT\n1,2,3,4,5,6\n",
}
AT = "--at 0 0 -0.09"

# By command: the other words, and what the message says. {map}, {device} and {recipe} are those of the thin loop,
# {six} is a map of six coils, {step} is a scenario on it.
REFUSED = {
    "check": {
        "no_such_device": "no_such_device",
        ".": "directory",
        "bad.toml": "coil",
        "syntax.toml": "syntax.toml",
        "{recipe}": "must be a device file; a recipe file; `fieldmap map`",
        "{six} --set coil.1.turns=3": "--set",
    },
    "solve": {
        "{device} --currents 1 2": "--currents",
        "{device} --mu-r -5": "--mu-r",
        "{device} --at 0 0": "three numbers",
        "{device} --nonlinear --currents 1": "no bodies",
        "study.toml": "must be a device file; a study file; `fieldmap study`",
        "ball.toml --nonlinear": "must come with --currents",
        "ball.toml --nonlinear --currents 1 --mu-r 100": "must not come with --mu-r",
        "ball.toml --nonlinear --currents 1 --form flux": "the potential form",
        "ball.toml --form cubic": "must be one of auto, potential, flux",
        "ball.toml --refinement 0": "must be a positive number",
        "ball.toml --nonlinear --mu-r -1 --refinement 0 --form flux": "--mu-r; --refinement; --nonlinear",
        "table.toml --force bal": "must be a body or coil of the device: ball, lid, slab, loop",
        "table.toml --force ,": "must be a body or coil",
        "table.toml --section middle": "must be a section of the device file: equator, joint",
        "table.toml --tolerance 0": "must lie between 0 and 1",
        "table.toml --tolerance 1e-3 --nonlinear --currents 1": "must stand alone",
        "table.toml --tolerance 1e-3 --refinement 2": "--refinement 2",
        "table.toml --tolerance 1e-3 --form flux": "--form flux",
        "loop_and_sphere --section middle": "[[section]]",
        "loop_and_sphere --thermal-resistance 3": "--thermal-resistance; --design",
    },
    "map": {
        "syntax.toml": "syntax.toml",
        "no_such_recipe": "no_such_recipe",
        ".": "directory",
        "{device}": "must be a recipe file; a device file; `fieldmap check`",
        "scenario.toml": "must be a recipe file; a scenario file; `fieldmap simulate`",
        "{map}": "HDF5",
    },
    "info": {
        "no_such_map.h5": "no such file",
        "text.h5": "text.h5",
        "half.h5": "half.h5",
        "{device}": "HDF5",
        ".": "directory",
    },
    "probe": {
        "{map} --at 0 0 0.5 --currents 1": "--at-mm",
        "{map} --at 0 0 -80 --currents 1": "--at-mm",
        f"{{map}} {AT} --currents 1 2 3": "--currents",
        f"{{map}} {AT} --currents one": "--currents",
        f"{{map}} {AT} --currents lop=2": "lop",
        "{map} --at 0 0 nan --currents 1": "finite",
        "{map} --currents 1": "--at",
        f"{{map}} {AT} --currents 1 --mu-r 1000": "--mu-r",
        f"{{map}} {AT} --currents 1 --nonlinear": "must go with a device",
        f"{{map}} {AT} --currents 1 --payload-of drive_unit --moment 0 0 1": "--payload-of",
        f"{{map}} {AT} --currents 1 --payload-of eight_coils": "--payload-of",
        "{six} --at 0 0 -0.1 --currents 1 --set coil.1.turns=3": "--set",
        "loop_and_sphere --at 0 0 -0.014 --currents 1 --payload": "[payload]",
        f"{{device}} --nonlinear --currents 1 {AT}": "no bodies",
    },
    "currents": {
        f"{{device}} {AT}": "must have --lift",
        "{device} --lift": "must give one point",
        f"{{device}} {AT} {AT} --lift": "2 points",
        f"{{device}} {AT} --lift --force 0 0 1": "--lift",
        f"{{device}} {AT} --lift --moment 0 0 1": "--lift",
        f"{{device}} {AT} --lift --limit -1": "--limit",
        f"{{device}} {AT} --lift --payload-of eight_coils": "--payload-of",
        f"{{device}} {AT} --force 0 0": "three numbers",
        f"{{map}} {AT} --force nan nan nan --moment 0 0 1": "--force; one component or more",
        f"{{map}} {AT} --force 0 0 inf": "--force; finite; 'inf'",
        f"{{device}} {AT} --moment 0 0 1 --payload-of drive_unit --force 0 0 1": "--payload-of",
    },
    "equilibrium": {
        "{map}": "exactly one",
        "{map} --currents 1 --height-mm -90": "2 of them",
        "{map} --height-mm 90": "box",
        "{map} --currents 1 --orientation loose": "fixed or aligned",
        "{map} --currents 1 --start 0 0 7": "--start",
        "{map} --form flux --currents 1": "must go with a device",
        "{six} --currents 1 --set coil.1.turns=3": "--set",
        "loop_and_sphere --currents 1": "payload",
        "ball.toml --nonlinear --height-mm -90": "must lie in the box",
        "ball.toml --nonlinear --currents 1 --orientation up": "fixed or aligned",
    },
    "show": {
        "loop_and_sphere --save picture.bmp": ".png",
        "loop_and_sphere --what all --save a.png": "all",
        "nothing_here --save a.png": "nothing_here",
        "{map} --what reachable --at-mm 0 0 -90 --at-mm 0 0 -80 --save a.png": "one point",
        "{six} --what reachable --save a.png": "payload",
        "{six} --save a.png --set coil.1.turns=3": "--set",
    },
    "app": {"drive_unit --save a.png": "drive_unit", "some.h5 --save a.html": ".png"},
    "simulate": {
        "{step} --runs 0": "--runs",
        "{step} -o run.txt": ".h5 or .csv",
        "{step} -o run.csv --runs 2": "one run",
        "{step} --save run.bmp": ".png",
        "{step} --set control.z.Kc": "KEY=VALUE",
        "{step} --set control.z.Ti=1": "Ti_s",
        "{step} --vary control.z.Kc=": "KEY=A,B",
        "{step} --log readings.csv": "--measured",
        "{device}": "must be a scenario file; a device file; `fieldmap check`",
        "{map}": "--map {map}",
    },
    "linearise": {
        "{recipe}": "must be a scenario file; a recipe file; `fieldmap map`",
        "{step} --depths a -o x.csv": "--depths; .npz",
    },
    "study": {
        "no_such_study": "no_such_study",
        ".": "directory",
        "pole_disk -o turns.csv": ".nc",
        "study.toml --workers 0": "--workers",
        "{recipe}": "must be a study file; a recipe file; `fieldmap map`",
    },
    "optimise": {"no_such_study": "no_such_study", ".": "directory", "pole_piece -o best.csv": ".nc"},
    "fit": {"no_such_fit": "no_such_fit", ".": "directory", "loop_and_sphere -o fitted.h5": ".toml"},
    "import": {
        "none.csv -o m.h5": "none.csv",
        "readings.csv -o m.txt": "--output",
        "readings.csv -o nowhere/m.h5": "--output",
        "readings.csv -o m.h5": "Bz",
    },
    "export": {
        "{device} --to c -o loop.out": "map",
        "{device} --to mag-manip -o loop.out": "map",
        "{device} --to csv -o loop.out": "--spacing-mm",
        "{six} --to csv -o a.csv --set coil.1.turns=3": "--set",
        "{map} --to matlab -o a.out": "--to",
        "{map} --to csv -o a.out --kind global": "--kind",
        "{map} --to vti -o a.out --outside clamp": "--outside",
        "{map} --to vti -o a.out": ".vti",
        "{map} --to mag-manip -o a.out --kind global": "--kind",
        "{map} --to c -o a.out --spacing-mm 2": "--spacing-mm",
        "{map} --to csv -o a.out --spacing-mm -2": "spacing",
        "{map} --to csv -o a.out --nonlinear": "--nonlinear",
        "{map} --to c -o a.out --kind hermite": "hermite",
        "{map} --to c -o a.out --outside zero": "zero",
        "{map} --to c -o a.out --currents 1,2": "--currents",
    },
    "schema": {"nothing": "planar-device", "--log none/run.log": "--log"},
}
for name in ("check", "solve", "show"):
    REFUSED[name] |= {
        "drive_unit --set parameters.gpa=3": "parameters.gpa",
        "drive_unit --set coil=3": "coil",
        "drive_unit --set gap": "--set",
        "drive_unit --set body.disk.radius_mm=-1": "body.disk.radius_mm",
        "drive_unit --set parameters.gap=1e308": "gap",
    }
LINES = [(f"{name} {words}", said) for name, lines in REFUSED.items() for words, said in lines.items()]


@pytest.fixture
def folder(machine, six_coils, written, tmp_path, monkeypatch):
    """A folder with files that are wrong, in which the command runs, and the names in `REFUSED`."""
    for name, text in TEXTS.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "half.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    names = {"step": str(written()), "six": str(six_coils), **vars(machine)}
    monkeypatch.chdir(tmp_path)
    return names


@pytest.fixture
def nothing_solved(monkeypatch):
    def never(*args, **kwargs):
        raise AssertionError("solved")

    for name in ("solve_linear", "solve_to_tolerance", "NonlinearSolver"):
        monkeypatch.setattr(f"fieldmap.iron.{name}", never)


@pytest.mark.usefixtures("nothing_solved")
@pytest.mark.parametrize(("line", "said"), LINES, ids=[line for line, _ in LINES])
def test_bad_input_ends_with_2_and_a_readable_message(folder, capsys, line, said):
    words = [word.format(**folder) for word in shlex.split(line)]
    before = sorted(Path().iterdir())
    assert main(words) == 2
    caught = capsys.readouterr()
    assert caught.out == ""
    assert "Traceback" not in caught.err
    message = " ".join(caught.err.split())
    assert all(part.format(**folder) in message for part in said.split("; ")), caught.err
    assert sorted(Path().iterdir()) == before
    if "Usage" in message:
        return
    lines = caught.err.splitlines()
    for start in ("error ", "received ", "remedy "):
        assert any(text.startswith(start) and len(text) > 10 for text in lines), caught.err
    count = caught.err.count("\nremedy ")
    assert lines[-1] == f"{count} problem{'s' if count > 1 else ''} found."


@pytest.mark.parametrize("line", [line for line, _ in LINES if line.startswith("currents")])
def test_programs_get_every_problem(folder, command, line):
    code, out, err = command("", *(word.format(**folder) for word in shlex.split(line)), "--json")
    found = json.loads(out)
    assert code == found["exit_code"] == 2
    assert len(found["problems"]) == err.count("\nremedy ")


@pytest.mark.parametrize("line", ["frobnicate", "probe", "probe x --nonsense"])
def test_wrong_usage_ends_with_2(command, line):
    code, _, err = command(line)
    assert (code, "Usage" in err) == (2, True)


def test_every_problem_of_a_file_is_printed(folder, command):
    code, _, err = command("check bad.toml")
    assert (code, err.count("\nremedy ") >= 3) == (2, True)
