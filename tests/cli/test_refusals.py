"""Refused command lines: exit code 2, problem and remedy, before a solve or a file."""

import json
import shlex
import tomllib
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
REFUSED = tomllib.loads((Path(__file__).parent / "files" / "refused.toml").read_text())
OF_ANY_DEVICE = REFUSED.pop("any_device")
for name in ("check", "solve", "show"):
    REFUSED[name] |= OF_ANY_DEVICE
LINES = [(f"{name} {words}", said) for name, lines in REFUSED.items() for words, said in lines.items()]


@pytest.fixture
def folder(machine, six_coils, written, tmp_path, monkeypatch):
    """A working folder with wrong files, and the names used in `REFUSED`."""
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
