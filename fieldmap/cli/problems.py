"""Errors as a reader wants them: each problem with where, what must hold, what was received, and the
remedy."""

import sys
import textwrap

from fieldmap.errors import FieldmapError, Problem

_INDENT = 10


def print_problems(error: FieldmapError) -> None:
    """Print every problem of an error on stderr, and how many there are."""
    for problem in error.problems:
        print(_problem_text(problem), file=sys.stderr)
    count = len(error.problems)
    if count:
        print(f"{count} problem{'s' if count > 1 else ''} found.", file=sys.stderr)
    else:
        print(f"error: {error}", file=sys.stderr)


def _problem_text(problem: Problem) -> str:
    return "\n".join(
        (
            _entry("error", problem.where, bold=True),
            _entry("", problem.must_hold),
            _entry("received", problem.received),
            _entry("remedy", problem.remedy),
            "",
        )
    )


def _entry(label: str, text: str, bold: bool = False) -> str:
    head = f"{label:<{_INDENT}}"
    # A program that reads stderr gets each entry on one line and no colour; people get long lines folded.
    if not sys.stderr.isatty():
        return head + str(text)
    folded = textwrap.fill(str(text), width=88, subsequent_indent=" " * _INDENT, break_long_words=False)
    return f"\x1b[1;31m{head}\x1b[0m\x1b[1m{folded}\x1b[0m" if bold else f"\x1b[2m{head}\x1b[0m{folded}"
