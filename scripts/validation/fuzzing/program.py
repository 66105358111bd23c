"""Read mutations of one kind, one after the other: a program of its own, because it may crash.

    python program.py KIND FIRST COUNT SEED

Prints a line of JSON for each mutation: its number and what was done, before it is read; then the result, processor
seconds and megabytes. `fuzzing.table` starts it, and starts it again behind a mutation that ended it.
"""

import contextlib
import faulthandler
import io
import json
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))
# Files of other people's HDF5 lie on any file system; threads would count as processor time.
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")

import numpy as np

from fieldmap.cli import main as command
from fieldmap.errors import InputError
from validation.fuzzing.case import Case, Kind
from validation.fuzzing.kinds import KINDS
from validation.fuzzing.mutations import decoys
from validation.fuzzing.watch import Watch

LONGEST_MESSAGE = 20_000
ALARM_S = 60


class Late(BaseException):
    """No answer within `ALARM_S`."""


def outcome(case: Case, kind: Kind, by_command: bool) -> tuple[str, str]:
    """read, refused, or what must not be; and why."""
    try:
        with warnings.catch_warnings():
            # A number that overflowed on the way is no number to go on with; who reads a file expects no such line.
            warnings.simplefilter("error", RuntimeWarning)
            warnings.simplefilter("ignore", FutureWarning)
            answer = case.read()
            wrong = case.fault(answer)
    except InputError as error:
        told = faults_of_messages(error)
        if not told and by_command and case.command:
            told = _fault_of_command(case.command, refused=True)
        return ("traceback", told) if told else ("refused", str(error)[:200])
    if not wrong and by_command and case.command:
        wrong = _fault_of_command(case.command, refused=False)
    return ("wrong", wrong) if wrong else ("read", "")


def faults_of_messages(error: InputError) -> str:
    """What a refusal lacks: all four things, in a length that a person reads, and the exit code of bad input."""
    if error.exit_code != 2 or not error.problems:
        return f"exit code {error.exit_code}, {len(error.problems)} problems"
    for problem in error.problems:
        if not all((problem.where, problem.must_hold, problem.received, problem.remedy)):
            return f"a message without one of its four parts: {problem}"[:300]
        if len(str(problem)) > LONGEST_MESSAGE:
            return f"a message of {len(str(problem))} letters"
    return ""


def _fault_of_command(words: tuple[str, ...], refused: bool) -> str:
    """The command line says the same: exit code 2 where the library refused, 0 or the code of a failure elsewhere."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = command(list(words))
    if "Traceback" in err.getvalue() or (refused and (code != 2 or not err.getvalue())):
        return f"{' '.join(words)}: exit code {code}: {err.getvalue()[-200:]}"
    return (
        "" if refused or code in (0, 2) else f"{' '.join(words)}: exit code {code}: {err.getvalue()[-200:]}"
    )


def _where(error: BaseException) -> str:
    """The error and the last line of ours in its traceback."""
    ours = [f for f in traceback.extract_tb(error.__traceback__) if "fieldmap" in Path(f.filename).parts]
    place = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
    return f"{type(error).__name__}: {str(error)[:150]}{place}"


def run(kind: Kind, first: int, count: int, seed: int) -> None:
    """The cases from `first` to `count`."""

    def late(*_: Any) -> None:
        raise Late

    def say(**what: Any) -> None:
        print(json.dumps(what), file=to, flush=True)

    # Libraries in C print to the standard output of the process.
    to = os.fdopen(os.dup(1), "w")
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    signal.signal(signal.SIGALRM, late)
    # A crash says where it was, and so does a process that `fuzzing.table` ends because it says nothing.
    faulthandler.enable()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        tempfile.tempdir = place
        # What a file leads to is looked for beside it, too.
        os.chdir(folder)
        sys.stdin = open(os.devnull)  # noqa: SIM115 - as long as the process
        make = kind.prepare(folder)
        watch = Watch(folder, decoys(folder))
        for number in range(first, count):
            case = make(np.random.default_rng([seed, number]), number)
            say(number=number, change=case.change[:300])
            by_command = bool(kind.through_command) and number % kind.through_command == 0
            begin = time.process_time()
            watch.begin()
            signal.alarm(ALARM_S)
            try:
                result, why = outcome(case, kind, by_command)
            except Late:
                result, why = "slow", f"no answer in {ALARM_S} s"
            except MemoryError as error:
                result, why = "memory", _where(error)
            except (Exception, SystemExit) as error:
                result, why = "traceback", _where(error)
            finally:
                signal.alarm(0)
            seconds = time.process_time() - begin
            did, asked = watch.end()
            allowed = (kind.names_files and did.startswith("read")) or (
                kind.starts_processes and did.startswith("subprocess")
            )
            if did and not allowed:
                result, why = "reached out", did
            elif seconds > kind.seconds and result in ("read", "refused") and not by_command:
                result, why = "slow", f"{seconds:.1f} s, bound {kind.seconds:g}"
            elif asked > kind.megabytes and result in ("read", "refused") and not by_command:
                result, why = "memory", f"{asked:.0f} MB, bound {kind.megabytes:g}"
            # What the program itself takes, with all that it imports first, is not the reader's.
            cost = (0.0, 0.0) if by_command else (seconds, asked)
            say(number=number, result=result, why=why, seconds=cost[0], megabytes=cost[1])


def _named(name: str) -> Kind:
    """A kind of the list, or MODULE:NAME."""
    module, sign, attribute = name.partition(":")
    return getattr(import_module(module), attribute) if sign else KINDS[name]


if __name__ == "__main__":
    run(_named(sys.argv[1]), *map(int, sys.argv[2:]))
