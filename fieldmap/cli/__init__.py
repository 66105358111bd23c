"""The command line: `fieldmap COMMAND`, or `python -m fieldmap COMMAND`.

Depends on: typer, rich, and (inside each command, so that `--help` is quick) every other package.
"""


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 failed, 2 bad input, 130 interrupted.

    argv: the arguments after the program's name; those of the process unless given.

    >>> from fieldmap.cli import main
    >>> main(["--version"])
    fieldmap 0.2.0
    0
    """
    from fieldmap.cli.run import run

    return run(argv)
