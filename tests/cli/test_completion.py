"""What the shell completes, and commands that say nothing on the way."""

import os
import subprocess
import sys

import pytest

from fieldmap.cli import main


def completed(line):
    """What the shell would be offered for a line of words, the last of them unfinished."""
    words = {
        "_FIELDMAP_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
    }
    run = [sys.executable, "-c", "import sys; from fieldmap.cli import main; sys.exit(main([]))"]
    return subprocess.run(
        run, env=os.environ | words, capture_output=True, text=True, timeout=60
    ).stdout.split()


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


def test_quiet_leaves_the_result_alone(capsys):
    words = ["solve", "loop_and_sphere", "--refinement", "0.4"]
    assert main(words) == 0
    loud = capsys.readouterr()
    assert main(["--quiet", *words]) == 0
    quiet = capsys.readouterr()
    assert "solving" in loud.err
    assert quiet.err == ""
    # The cost in seconds differs from run to run.
    assert quiet.out.splitlines()[-3:] == loud.out.splitlines()[-3:]
    assert main(["--quiet", "check", "no_such_device"]) == 2
    assert "no_such_device" in capsys.readouterr().err
