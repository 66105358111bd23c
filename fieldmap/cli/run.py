"""The application: its commands, and what becomes of errors."""

import sys

from fieldmap.cli.numbers import join_lists
from fieldmap.cli.problems import print_problems
from fieldmap.errors import FieldmapError

INTERRUPTED = 130


def run(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code. A FieldmapError is printed, never a traceback."""
    import typer.main

    from fieldmap.cli.application import application

    words = join_lists(sys.argv[1:] if argv is None else argv)
    command = typer.main.get_command(application())
    code = 0
    try:
        command.main(args=words, prog_name="fieldmap")
    except SystemExit as done:
        code = done.code if isinstance(done.code, int) else int(done.code is not None)
    except FieldmapError as error:
        print_problems(error)
        code = error.exit_code
    except KeyboardInterrupt:
        code = INTERRUPTED
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 1
    if code == INTERRUPTED:
        print("interrupted", file=sys.stderr)
    return code
