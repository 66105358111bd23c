"""What every command shares: options anywhere, a log, the list of commands, messages that show the line."""

import re
import subprocess
import sys

import pytest

from fieldmap.cli import main
from fieldmap.cli.application import COMMANDS, FIRST_STEPS
from fieldmap.cli.messages import LOG
from fieldmap.cli.run import common_first


def test_the_first_steps_of_the_help_are_commands_that_exist():
    steps = re.findall(r"^  fieldmap (\w+)", FIRST_STEPS, re.MULTILINE)
    assert len(steps) >= 4
    assert set(steps) <= set(COMMANDS)


@pytest.mark.parametrize("words", [["-q"], ["--quiet"]])
def test_quiet_may_stand_anywhere(capsys, machine, words):
    assert main(["map", machine.recipe, "-o", machine.map, *words]) == 0
    assert capsys.readouterr().err == ""


def test_words_of_options_stay_with_them():
    words = ["map", "quick", "--log", "-q", "--log=a", "-o", "x"]
    assert common_first(words) == ["--log", "-q", "--log=a", "map", "quick", "-o", "x"]
    assert common_first(["map", "--log"]) == ["map", "--log"]


def test_a_log_holds_command_steps_and_end_with_their_time(tmp_path, machine):
    log = tmp_path / "run.log"
    assert main(["map", machine.recipe, "-o", machine.map, "--log", str(log)]) == 0
    assert main(["check", "no_such_device", "--log", str(log)]) == 2
    lines = log.read_text().splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} (INFO|ERROR) ", line) for line in lines)
    assert f"fieldmap map {machine.recipe}" in lines[0]
    assert any("map: 100 %" in line for line in lines)
    assert [line.split(" after ")[0][-11:] for line in lines if "exit code" in line] == [
        "exit code 0",
        "exit code 2",
    ]
    assert any(" ERROR " in line and "no_such_device" in line for line in lines)
    assert len(LOG.handlers) == 1


def test_verbose_tells_every_step_on_stderr(capsys, machine):
    assert main(["map", machine.recipe, "-o", machine.map, "--verbose"]) == 0
    caught = capsys.readouterr()
    assert "complete already" in caught.err
    assert re.search(r"^\d{4}-.* INFO .* 0 after \d", caught.err, re.MULTILINE)
    assert "INFO" not in caught.out


def test_the_module_is_the_program():
    done = subprocess.run([sys.executable, "-m", "fieldmap"], capture_output=True, text=True)
    assert "First steps" in done.stdout + done.stderr
