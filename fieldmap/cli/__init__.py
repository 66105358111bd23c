"""The command line: `fieldmap COMMAND`, or `python -m fieldmap COMMAND`.

Depends on: typer, rich, and (inside each command, so that `--help` is quick) every other package.
"""

import sys
import time

from fieldmap.cli.arguments import join_lists
from fieldmap.cli.messages import LOG, begin_log, close_log, print_as_json, print_problems
from fieldmap.errors import FieldmapError
from fieldmap.extras import require

INTERRUPTED = 130
_ANYWHERE = ("--quiet", "-q", "--verbose", "-v")


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 failed, 2 bad input, 130 interrupted.

    argv: the arguments after the program's name; those of the process unless given. A FieldmapError is printed, never a
    traceback.

    >>> from fieldmap.cli import main
    >>> main(["--version"])
    fieldmap 0.2.0
    0
    """
    given = sys.argv[1:] if argv is None else argv
    words = common_first(join_lists(given))
    begin = time.monotonic()
    begin_log(given)
    try:
        code = _run(words)
        LOG.info("exit code %d after %.1f s", code, time.monotonic() - begin)
    except BaseException:
        LOG.exception("unexpected error")
        raise
    finally:
        close_log()
    return code


def common_first(words: list[str]) -> list[str]:
    """Move the options that every command knows in front of its name, where the program looks for them.

    >>> common_first(["map", "quick", "-q", "--log", "map.log"])
    ['-q', '--log', 'map.log', 'map', 'quick']
    """
    first: list[str] = []
    rest: list[str] = []
    words = list(words)
    while words:
        word = words.pop(0)
        if word in _ANYWHERE or word.startswith("--log="):
            first.append(word)
        elif word == "--log" and words:
            first += [word, words.pop(0)]
        else:
            rest.append(word)
    return first + rest


def _run(words: list[str]) -> int:
    code = 0
    try:
        for library in ("typer", "rich"):
            require(library, "cli", "the command fieldmap", "call the functions of the package from Python")
        from fieldmap.cli.application import application

        application().main(args=words, prog_name="fieldmap")
    except SystemExit as done:
        code = done.code if isinstance(done.code, int) else int(done.code is not None)
    except FieldmapError as error:
        print_problems(error)
        code = error.exit_code
        if "--json" in words:
            print_as_json(error)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except OSError as error:
        LOG.error("%s", error)
        print(f"error: {error}", file=sys.stderr)
        code = 1
    if code == INTERRUPTED:
        print("interrupted", file=sys.stderr)
    return code
