"""How help looks: flags without a type, paragraphs that fill the line, what to begin with."""

import inspect
from collections.abc import Callable
from typing import Any

from typer.core import TyperCommand, TyperGroup

FIRST_STEPS = """[bold]First steps[/bold]
  fieldmap check drive_unit                 a machine: iron, coils, magnet
  fieldmap solve loop_and_sphere            the solver beside a closed form
  fieldmap map quick -o quick.h5 --summary  a map of field and gradient
  fieldmap probe quick.h5 --at 0 0 -0.1 --currents 1
  fieldmap show drive_unit --save unit.png  a picture
In any command: --quiet, --verbose, --log FILE. The program ends with 0 (done), 1 (failed) or 2 (bad input)."""


def paragraphs(function: Callable[..., Any]) -> str:
    """The docstring of a function with one line per paragraph.

    >>> def f(): "One\\n    two.\\n\\n    Three."
    >>> paragraphs(f)
    'One two.\\n\\nThree.'
    """
    text = inspect.getdoc(function) or ""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def _plain(parameters: list[Any]) -> list[Any]:
    """The parameters, flags without a word for a value."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters


class Command(TyperCommand):
    """A command whose help is laid out as said above."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, --help among them."""
        return _plain(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words of the usage line, without the braces of a choice where there is none."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]


class Group(TyperGroup):
    """The program itself, likewise."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, --help among them."""
        return _plain(super().get_params(ctx))
