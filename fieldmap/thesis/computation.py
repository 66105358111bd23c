"""Parts of rows computed one by one, so that one that cannot be computed loses nothing of the others."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fieldmap.curves import Curves
from fieldmap.errors import FieldmapError
from fieldmap.thesis.comparison import Comparison, compared
from fieldmap.thesis.maps_at_hand import FOLDER, MapMissing, opened
from fieldmap.thesis.printed import PrintedPart, figure_numbers, read_part
from fieldmap.thesis.registry import Answers, function_of, parts_of, row_of

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class PartResult:
    """What became of one part of a row.

    explanations: name of a printed number, or "" for the part -> why ours differs. seconds: of processor time.
    problem: why there are no numbers, or "". remedy: the command that helps, or "".
    """

    part: str
    title: str
    comparisons: tuple[Comparison, ...] = ()
    curves: tuple[Curves, ...] = ()
    explanations: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    problem: str = ""
    remedy: str = ""
    map: str = ""

    @property
    def row(self) -> str:
        """The row it belongs to."""
        return row_of(self.part)

    @property
    def state(self) -> str:
        """ "done", "no map", or "failed"."""
        if not self.problem:
            return "done"
        return "no map" if self.remedy else "failed"


def compare(rows: Iterable[str] = (), maps: Path = FOLDER) -> list[Comparison]:
    """Every number that the thesis prints for these rows beside ours.

    rows: names such as "S7"; if none is given, all that need no map or whose map has been made. maps: the folder of
    the maps. Raises InputError for a row that is not there and MapMissing where a row was named whose map is missing.

    >>> [number] = [c for c in compare(["S7"]) if c.name == "global_deviation[0]"]
    >>> print(number.thesis, round(number.ours, 7), number.unit, number.agrees)
    0.00706 0.0070569 mm True
    """
    wanted = list(rows)
    comparisons: list[Comparison] = []
    for part in parts_of(wanted):
        try:
            comparisons += compute_part(part, maps).comparisons
        except MapMissing:
            if wanted:
                raise
    return comparisons


def compute_part(part: str, maps: Path = FOLDER) -> PartResult:
    """The numbers, figures and explanations of one part. Raises MapMissing, and what the part itself raises."""
    printed = read_part(part)
    inputs = printed.inputs | ({"map": opened(printed.map, maps)} if printed.map else {})
    started = time.process_time()
    answers = function_of(part)(inputs)
    seconds = time.process_time() - started
    if not isinstance(answers, Answers):
        answers = Answers(answers)
    _check_figures(part, printed, answers.curves)
    return PartResult(
        part,
        printed.title,
        compared(part, printed, answers.numbers),
        answers.curves,
        _joined(part, printed, answers),
        seconds,
        map=printed.map,
    )


def attempt_part(part: str, maps: Path = FOLDER) -> PartResult:
    """`compute_part`, but whatever goes wrong becomes `problem`: the other parts do not depend on this one."""
    printed = read_part(part)
    try:
        return compute_part(part, maps)
    except MapMissing as missing:
        problem, remedy = str(missing), missing.command
    except FieldmapError as error:
        problem, remedy = str(error), ""
    except Exception as error:
        problem, remedy = f"{type(error).__name__}: {error}", ""
    return PartResult(part, printed.title, problem=problem, remedy=remedy, map=printed.map)


def attempt_rows(
    rows: Iterable[str] = (),
    progress: Progress | None = None,
    attempt: Callable[[str], PartResult] = attempt_part,
) -> Iterator[PartResult]:
    """The parts of these rows (of all if none is given), one by one; progress(part, share of the work done)."""
    parts = parts_of(rows)
    costs = [read_part(part).seconds for part in parts]
    done = 0.0
    for part, cost in zip(parts, costs, strict=True):
        if progress is not None:
            progress(part, done / sum(costs))
        yield attempt(part)
        done += cost


def _check_figures(part: str, printed: PrintedPart, curves: Iterable[Curves]) -> None:
    """The list of figures in the documentation is made from the data files, so that no row need be computed for it."""
    drawn = {number for one in curves for number in figure_numbers(one.title)}
    if drawn != set(printed.figures):
        odd = ", ".join(sorted(drawn ^ set(printed.figures)))
        raise LookupError(f"{part}: figures of its data file and those that it draws differ in {odd}")


def _joined(part: str, printed: PrintedPart, answers: Answers) -> dict[str, str]:
    """What the data file and the function say of the same number, one after the other."""
    unknown = set(answers.explanations) - {"", *printed.numbers}
    if unknown:
        raise LookupError(f"{part}: explained, but not printed: {', '.join(sorted(unknown))}")
    names = dict.fromkeys([*printed.explanations, *answers.explanations])
    both = (printed.explanations, answers.explanations)
    return {name: " ".join(texts[name].strip() for texts in both if name in texts) for name in names}
