"""What a run over parts needs and how long it takes: which are finished, which maps are missing, in what order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fieldmap.records import Record, count_of
from fieldmap.thesis import detail
from fieldmap.thesis.computation import expected_seconds
from fieldmap.thesis.detail import file_of
from fieldmap.thesis.kept import is_finished
from fieldmap.thesis.printed import read_part, row_of

MAP_SECONDS = {"division": 200.0, "division_quick": 30.0}
"""Seconds for a map on two processors, about."""
COMPILATION = 240.0
"""Seconds in which the kernels are compiled that maps and parts need, on two processors, about."""
_FINISHED = 0.05
"""Seconds in which a finished part is read."""


@dataclass(frozen=True, repr=False)
class Stage(Record):
    """One step of a run: parts with the seconds expected of each, or a recipe whose map is made at `target`."""

    expected: Mapping[str, float] = field(default_factory=dict)
    recipe: str = ""
    target: Path = Path()

    @property
    def seconds(self) -> float:
        """Expected of the whole step."""
        return MAP_SECONDS.get(self.recipe, 60.0) if self.recipe else sum(self.expected.values())


@dataclass(frozen=True, repr=False)
class Plan(Record):
    """stages: parts without a map first, then maps, then the parts that need them. finished: parts that are kept.

    left_out: maps that are missing and not asked for, with how many parts need each. compiles: whether kernels are
    compiled on the way.
    """

    stages: tuple[Stage, ...]
    finished: int
    left_out: Mapping[Path, int]
    compiles: bool

    @property
    def parts(self) -> tuple[str, ...]:
        """All parts in the order in which they are computed."""
        return tuple(part for stage in self.stages for part in stage.expected)

    @property
    def whole(self) -> float:
        """Seconds of all stages, without compilation."""
        return sum(stage.seconds for stage in self.stages) or 1.0

    @property
    def seconds(self) -> float:
        """Seconds that the run takes, about."""
        return self.whole + (COMPILATION if self.compiles else 0.0)

    @property
    def text(self) -> str:
        """One line: how much, how long, what is missing."""
        rows = len({row_of(part) for part in self.parts})
        how = ", quick: coarse meshes" if detail.current().is_quick else ""
        said = [f"{count_of(len(self.parts), 'part', 'parts')} of {count_of(rows, 'row', 'rows')}{how}"]
        if self.finished:
            said.append(f"{self.finished} finished before")
        said += [f"makes {stage.target} first" for stage in self.stages if stage.recipe]
        for path, count in self.left_out.items():
            said.append(f"{count} left out: they need {path} (--make-maps makes it)")
        last = f"about {about(self.seconds)} on two processors"
        return "; ".join([*said, last + (", with the kernels to compile" if self.compiles else "")])


def planned(
    parts: Sequence[str], maps: Path, make_maps: bool, report: Path | None = None, compiles: bool = False
) -> Plan:
    """The plan of these parts. report: folder that keeps finished ones. compiles: whether nothing is compiled yet."""
    expected, finished = {}, 0
    left_out: dict[Path, int] = {}
    making: dict[str, Path] = {}
    for part in parts:
        recipe = read_part(part).map
        target = file_of(recipe, maps) if recipe else None
        missing = target is not None and not target.is_file()
        expected[part] = expected_seconds(part)
        if report is not None and is_finished(report, part, maps):
            expected[part], finished = _FINISHED, finished + 1
        elif missing and target is not None and make_maps:
            making[detail.current().map_name(recipe)] = target
        elif missing and target is not None:
            expected[part] = _FINISHED
            left_out[target] = left_out.get(target, 0) + 1
    first = {part: seconds for part, seconds in expected.items() if not read_part(part).map}
    rest = {part: seconds for part, seconds in expected.items() if read_part(part).map}
    stages = [
        Stage(first),
        *(Stage(recipe=recipe, target=path) for recipe, path in making.items()),
        Stage(rest),
    ]
    return Plan(
        tuple(stage for stage in stages if stage.recipe or stage.expected), finished, left_out, compiles
    )


def about(seconds: float) -> str:
    """A time to one or two digits.

    >>> about(8.0), about(100.0), about(1851.0)
    ('10 s', '2 min', '31 min')
    """
    return f"{max(round(seconds, -1), 10):.0f} s" if seconds < 55.0 else f"{round(seconds / 60.0):.0f} min"
