"""Read mutations of one kind, one after the other. A separate program, because it may crash.

    python program.py KIND FIRST COUNT SEED

Prints lines of JSON for each mutation: its number and description before reading, then the result, processor seconds
and megabytes. `fuzzing.table` starts this program, and starts it again after a mutation that ended it.
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
# HDF5 fails on file systems without file locks.
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
    """ "read", "refused", or the name of a failure; and the reason."""
    try:
        with warnings.catch_warnings():
            # numpy's warnings of overflow and invalid numbers count as failures.
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
    """Fault of a refusal without all four parts of a message, with a text that is too long, or another exit code."""
    if error.exit_code != 2 or not error.problems:
        return f"exit code {error.exit_code}, {len(error.problems)} problems"
    for problem in error.problems:
        if not all((problem.where, problem.must_hold, problem.received, problem.remedy)):
            return f"a message without one of its four parts: {problem}"[:300]
        if len(str(problem)) > LONGEST_MESSAGE:
            return f"a message of {len(str(problem))} letters"
    return ""


def _fault_of_command(words: tuple[str, ...], refused: bool) -> str:
    """Fault of the command line: it must end with 2 if the library refused the input, and with 0 or 2 otherwise."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = command(list(words))
    if "Traceback" in err.getvalue() or (refused and (code != 2 or not err.getvalue())):
        return f"{' '.join(words)}: exit code {code}: {err.getvalue()[-200:]}"
    return (
        "" if refused or code in (0, 2) else f"{' '.join(words)}: exit code {code}: {err.getvalue()[-200:]}"
    )


def _where(error: BaseException) -> str:
    """The error and the last line of fieldmap in its traceback."""
    ours = [f for f in traceback.extract_tb(error.__traceback__) if "fieldmap" in Path(f.filename).parts]
    place = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
    return f"{type(error).__name__}: {str(error)[:150]}{place}"


def run(kind: Kind, first: int, count: int, seed: int) -> None:
    """Run the cases from `first` to `count`."""

    def late(*_: Any) -> None:
        raise Late

    def say(**what: Any) -> None:
        print(json.dumps(what), file=to, flush=True)

    # Libraries in C print to the standard output of the process, which is redirected; results use a copy of it.
    to = os.fdopen(os.dup(1), "w")
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    signal.signal(signal.SIGALRM, late)
    # A crash prints its traceback, and so does a process that `fuzzing.table` ends because it hangs.
    faulthandler.enable()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        tempfile.tempdir = place
        # Relative names of other files are then found in the same folder.
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
            # The cost of the command line includes its imports and does not count for the reader.
            cost = (0.0, 0.0) if by_command else (seconds, asked)
            say(number=number, result=result, why=why, seconds=cost[0], megabytes=cost[1])


def _named(name: str) -> Kind:
    """A kind of the list, or the object MODULE:NAME."""
    module, sign, attribute = name.partition(":")
    return getattr(import_module(module), attribute) if sign else KINDS[name]


if __name__ == "__main__":
    run(_named(sys.argv[1]), *map(int, sys.argv[2:]))
