"""The figures of the thesis: what each shows, and which part of a row draws it or why none does."""

import tomllib
from dataclasses import dataclass
from functools import cache
from itertools import groupby

from fieldmap.extras import needs
from fieldmap.records import Record
from fieldmap.thesis.printed import PRINTED_NUMBERS, read_part
from fieldmap.thesis.rows import part_names


@dataclass(frozen=True, repr=False)
class ThesisFigure(Record):
    """One figure. number: "2-4"; shows: what it shows; drawn_by: the parts that draw it; not_drawn: why none does."""

    number: str
    shows: str
    drawn_by: tuple[str, ...]
    not_drawn: str = ""

    @property
    def chapter(self) -> str:
        """Number of its chapter."""
        return self.number.partition("-")[0]


@cache
def thesis_figures() -> dict[str, ThesisFigure]:
    """Number -> figure, in the order of the thesis.

    >>> thesis_figures()["2-4"].drawn_by
    ('S4_levitation',)
    """
    path = PRINTED_NUMBERS / "figures.toml"
    drawn = drawn_by()
    return {
        number: ThesisFigure(number, drawn_by=tuple(drawn.get(number, ())), **entry)
        for number, entry in tomllib.loads(path.read_text(encoding="utf-8")).items()
    }


def drawn_by() -> dict[str, list[str]]:
    """Number of a figure -> the parts whose row file says that they draw it."""
    parts: dict[str, list[str]] = {}
    for part in part_names():
        for number in read_part(part).figures:
            parts.setdefault(number, []).append(part)
    return parts


def figure_page() -> str:
    """docs/thesis_figures.md: a table for each chapter."""
    with needs("cli", "the pages of the thesis"):
        from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("fieldmap.thesis"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters["code"] = "`{}`".format
    chapters = groupby(thesis_figures().values(), key=lambda figure: figure.chapter)
    found = [{"number": number, "figures": list(figures)} for number, figures in chapters]
    return environment.get_template("figures.md.j2").render(chapters=found)
