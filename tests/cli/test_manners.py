"""Properties of all commands: exit codes, help, examples, lists of numbers, option order, logs, completion."""

import inspect
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fieldmap.cli import common_first
from fieldmap.cli.application import COMMANDS, FIRST_STEPS, application, described
from fieldmap.cli.arguments import join_lists, parse_currents
from fieldmap.cli.messages import LOG
from fieldmap.cli.options import SHARED_HELP, helps
from fieldmap.errors import InputError
from fieldmap.plot.rendering import can_render

REPOSITORY = Path(__file__).parents[2]


def test_no_balance_ends_with_1(command, machine):
    code, _, err = command("equilibrium --currents 0.001", machine.map)
    assert (code, err.count("\nremedy ")) == (1, 1)


def test_every_parameter_has_a_help_and_every_help_a_parameter():
    used = set()
    for name, command in application().commands.items():
        assert all(parameter.help for parameter in command.params), name
        parameters = {parameter.name for parameter in command.params}
        assert helps(inspect.getdoc(COMMANDS[name].call)).keys() <= parameters, name
        used |= parameters
    assert SHARED_HELP.keys() <= used


@pytest.mark.parametrize("columns", ["80", "100"])
def test_no_word_of_a_help_is_lost(capsys, monkeypatch, columns):
    """Words of docstrings in square brackets must not be taken for markup."""
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setitem(COMMANDS, "check", COMMANDS["check"]._replace(call=with_brackets))
    program = application.__wrapped__()
    for name, command in program.commands.items():
        with pytest.raises(SystemExit):
            program.main([name, "--help"])
        shown = "".join(re.sub(r"[│╭╮╰╯─\s]", "", capsys.readouterr().out))
        docstring = inspect.getdoc(COMMANDS[name].call)
        texts = [*described(COMMANDS[name].call), *helps(docstring).values()]
        texts += [one.help.replace("\\[", "[") for one in command.params]
        lost = [word for text in texts for word in text.split() if word not in shown]
        assert not lost, name


def with_brackets(toml: bool = False) -> None:
    """Read the tables [optimise] and [[vary]].

    Example: fieldmap check [bold]

    Parameters
    ----------
    toml
        Print [red] too.
    """


EXAMPLES = [described(entry.call)[1].removeprefix("Example: ") for entry in COMMANDS.values()]
for page in ("commands.md", "pictures.md"):
    EXAMPLES += re.findall(r"^    (fieldmap .*)$", (REPOSITORY / "docs" / page).read_text(), re.MULTILINE)


@pytest.mark.parametrize("example", EXAMPLES)
def test_every_example_is_understood(example):
    """The examples in the help and on two pages parse with the declarations of the commands."""
    words = join_lists(shlex.split(example.split(">")[0])[1:])
    # A separate program, because a command keeps the help options of the context in which it was first parsed.
    inner = application.__wrapped__().commands[words[0]]
    inner.make_context(words[0], words[1:]).close()


def test_help_is_quick():
    """Slow imports are not loaded; times are not tested, because the machine may be busy."""
    program = "import sys\nfrom fieldmap.cli import main\ncode = main(['--help'])\nprint(*sys.modules)\nsys.exit(code)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0
    *printed, modules = done.stdout.splitlines()
    assert "equilibrium" in " ".join(printed)
    loaded = modules.split()
    assert "fieldmap.cli.application" in loaded
    heavy = {"numba", "h5py", "netgen", "magpylib", "pyvista", "pydantic", "scipy"}
    assert heavy.isdisjoint(loaded)


def test_lists_of_numbers_after_an_option():
    words = ["probe", "unit", "--currents", "1", "-2,", ".5", "--at", "0", "0", "-1e-1", "--json"]
    assert join_lists(words) == ["probe", "unit", "--currents=1,-2,.5", "--at=0,0,-1e-1", "--json"]
    assert join_lists(["equilibrium", "--start", "aligned"]) == ["equilibrium", "--start", "aligned"]
    assert join_lists(["probe", "--currents"]) == ["probe", "--currents"]
    named = ["probe", "--currents", "1=5", "in front=-5,", "unit", "--set", "a=1"]
    assert join_lists(named) == ["probe", "--currents=1=5,in front=-5", "unit", "--set", "a=1"]


NAMES = ("1", "left", "in front")


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["2"], [2, 2, 2]),
        (["1,2 3"], [1, 2, 3]),
        (["left=-2.5,1=1e-1"], [0.1, -2.5, 0]),
        (["in front = 3"], [0, 0, 3]),
        (["1=1", "left=2"], [1, 2, 0]),
    ],
)
def test_currents_by_number_and_by_name(texts, expected):
    assert parse_currents(texts, NAMES).tolist() == expected


@pytest.mark.parametrize(
    ("text", "told"),
    [("1=1,2", "1=1,2"), ("right=1", "'right'"), ("1=1,1=2", "1 twice"), ("left=", "''"), ("1=x", "'x'")],
)
def test_currents_by_name_that_cannot_be(text, told):
    with pytest.raises(InputError) as caught:
        parse_currents([text], NAMES)
    assert caught.value.problems[0].where == "--currents"
    assert caught.value.problems[0].received == told


def test_a_command_takes_currents_by_name(answer, machine):
    line = "probe --at 0 0 -0.09 --currents"
    assert answer(line, "loop=2", machine.map) == answer(line, "2", machine.map)


def test_an_interrupted_map_says_how_to_go_on(command, machine, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("fieldmap.maps.generate", interrupted)
    code, _, err = command("map", machine.recipe)
    assert (code, "--fresh" in err, err.endswith("interrupted\n")) == (130, True, True)


def test_the_summary_of_a_map_is_what_info_prints(command, answer, machine):
    made = ("map -o", machine.map, machine.recipe)
    code, out, err = command(*made, "--summary", "--no-pictures")
    assert code == 0
    assert "complete already" in err
    assert command("info", machine.map)[1] == out
    # Without --pictures, --json and maps without summary draw nothing.
    assert answer(*made)["title"] == "Field of a thin loop"
    assert command(*made)[0] == 0
    assert not list(Path(machine.map).parent.glob("*.png"))


@pytest.mark.usefixtures("unsmoothed")
@pytest.mark.parametrize("asked", [["--summary"], ["--json", "--pictures"]])
def test_the_pictures_of_a_map_lie_beside_it(command, machine, tmp_path, asked):
    path = tmp_path / "loop.h5"
    path.write_bytes(Path(machine.map).read_bytes())
    code, printed, _ = command("map -o", path, machine.recipe, *asked)
    assert code == 0
    written = [path.with_name("loop.png"), *([path.with_name("loop_3d.png")] if can_render() else [])]
    assert sorted(tmp_path.glob("*.png")) == sorted(written)
    for one in written:
        assert one.read_bytes().startswith(b"\x89PNG")
        assert str(one) in "".join(printed.split())
    if "--json" in asked:
        shown = json.loads(printed)["pictures"]
        assert [one["path"] for one in shown][: len(written)] == [str(one) for one in written]


@pytest.mark.parametrize("word", ["-q", "--quiet"])
def test_quiet_may_stand_anywhere(command, machine, word):
    code, _, err = command("map -o", machine.map, machine.recipe, word)
    assert (code, err) == (0, "")


def test_words_of_options_stay_with_them():
    words = ["map", "quick", "--log", "-q", "--log=a", "-o", "x"]
    assert common_first(words) == ["--log", "-q", "--log=a", "map", "quick", "-o", "x"]
    assert common_first(["map", "--log"]) == ["map", "--log"]


def test_a_log_holds_command_steps_and_end_with_their_time(command, tmp_path, machine):
    log = tmp_path / "run.log"
    assert command("map -o", machine.map, machine.recipe, "--log", log)[0] == 0
    assert command("check no_such_device --log", log)[0] == 2
    lines = log.read_text().splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} (INFO|ERROR) ", line) for line in lines)
    assert f"fieldmap map -o {machine.map}" in lines[0]
    assert any("map: 100 %" in line for line in lines)
    ends = [line.split(" after ")[0][-11:] for line in lines if "exit code" in line]
    assert ends == ["exit code 0", "exit code 2"]
    assert any(" ERROR " in line and "no_such_device" in line for line in lines)
    assert len(LOG.handlers) == 1


def test_verbose_tells_every_step_on_stderr(command, machine):
    code, out, err = command("map -o", machine.map, machine.recipe, "--verbose")
    assert code == 0
    assert "complete already" in err
    assert re.search(r"^\d{4}-.* INFO .* 0 after \d", err, re.MULTILINE)
    assert "INFO" not in out


def test_the_module_is_the_program():
    done = subprocess.run([sys.executable, "-m", "fieldmap"], capture_output=True, text=True)
    steps = re.findall(r"^  fieldmap (\w+)", FIRST_STEPS, re.MULTILINE)
    assert len(steps) >= 4
    assert set(steps) <= set(COMMANDS)
    assert "First steps" in done.stdout + done.stderr


def completed(line):
    """Completions that the shell gets for a line whose last word is unfinished."""
    words = {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)}
    run = [sys.executable, "-c", "import sys; from fieldmap.cli import main; sys.exit(main([]))"]
    env = os.environ | words | {"_FIELDMAP_COMPLETE": "complete_bash"}
    return subprocess.run(run, env=env, capture_output=True, text=True, timeout=60).stdout.split()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("fieldmap ma", ["map"]),
        ("fieldmap check loop", ["loop_and_sphere"]),
        ("fieldmap map qui", ["quick"]),
        ("fieldmap simulate vertical_r", ["vertical_ramp"]),
        ("fieldmap thesis S2", ["S20"]),
        ("fieldmap map no_such", []),
    ],
)
def test_commands_and_shipped_names_are_completed(line, offered):
    assert completed(line) == offered


def test_quiet_leaves_the_result_alone(command):
    line = "solve loop_and_sphere --refinement 0.4"
    _, loud, told = command(line)
    code, quiet, nothing = command(f"--quiet {line}")
    assert (code, nothing) == (0, "")
    assert "solving" in told
    # The time in seconds differs between runs.
    assert quiet.splitlines()[-3:] == loud.splitlines()[-3:]
    code, _, err = command("--quiet check no_such_device")
    assert (code, "no_such_device" in err) == (2, True)
