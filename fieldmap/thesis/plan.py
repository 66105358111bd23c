"""What a run over parts needs and how long it takes: which are finished, which maps are missing, in what order; and the
run itself, with progress that moves while a part is at work."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from fieldmap.records import Record, count_of
from fieldmap.thesis import detail
from fieldmap.thesis.computation import PartResult, attempt_rows, expected_seconds
from fieldmap.thesis.kept import is_finished
from fieldmap.thesis.printed import read_part, row_of
from fieldmap.thesis.report import minutes
from fieldmap.typing import Progress

MAP_SECONDS = {"division": 200.0, "division_quick": 30.0}
"""Seconds for a map on two processors, about."""
COMPILATION = 240.0
"""Seconds in which the kernels are compiled that maps and parts need, on two processors, about."""
_FINISHED = 0.05
"""Seconds in which a finished part is read."""
MOVED_EVERY = 1.0
"""Seconds after which progress moves while a part is at work."""
TOLD_EVERY = 10.0
"""Seconds after which the time that a part has taken is told anew."""


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
    finished = 0
    # Of parts without a map, and of those that need one.
    expected: tuple[dict[str, float], dict[str, float]] = ({}, {})
    left_out: dict[Path, int] = {}
    making: dict[str, Path] = {}
    for part in parts:
        recipe, seconds = read_part(part).map, expected_seconds(part)
        target = detail.file_of(recipe, maps)
        if report is not None and is_finished(report, part, maps):
            seconds, finished = _FINISHED, finished + 1
        elif recipe and not target.is_file() and make_maps:
            making[detail.current().map_name(recipe)] = target
        elif recipe and not target.is_file():
            seconds, left_out[target] = _FINISHED, left_out.get(target, 0) + 1
        expected[bool(recipe)][part] = seconds
    made = (Stage(recipe=recipe, target=path) for recipe, path in making.items())
    stages = (Stage(expected[False]), *made, Stage(expected[True]))
    asked = tuple(stage for stage in stages if stage.recipe or stage.expected)
    return Plan(asked, finished, left_out, compiles)


def about(seconds: float) -> str:
    """A time to one or two digits.

    >>> about(8.0), about(100.0), about(1851.0)
    ('10 s', '2 min', '31 min')
    """
    return f"{max(round(seconds, -1), 10):.0f} s" if seconds < 55.0 else f"{round(seconds / 60.0):.0f} min"


def computed(plan: Plan, attempt: Callable[[str], PartResult], progress: Progress) -> Iterator[PartResult]:
    """The parts of a plan, one by one; the maps that it asks for are made before the first part that needs one."""
    begun = 0.0
    for stage in plan.stages:

        def share(message: str, fraction: float, stage: Stage = stage, begun: float = begun) -> None:
            what = f"map {stage.recipe}: " if stage.recipe else ""
            progress(what + message, (begun + fraction * stage.seconds) / plan.whole)

        if stage.recipe:
            # Rows without a map need no kernels.
            from fieldmap.maps import generate

            generate(stage.recipe, stage.target, progress=share)
        else:
            with moving(share, stage.expected) as moved:
                yield from attempt_rows(stage.expected, moved, attempt)
        begun += stage.seconds


@contextmanager
def moving(progress: Progress, expected: Mapping[str, float]) -> Iterator[Progress]:
    """Progress for `attempt_rows` that moves while a part is at work, by the seconds that are expected of it.

    A part that takes longer moves on ever more slowly and never passes its end.
    """
    whole, stopped = sum(expected.values()), threading.Event()
    at_work: list[tuple[str, float, float]] = []

    def begins(part: str, share: float) -> None:
        at_work[:] = [(part, share, time.monotonic())]
        progress(part, share)

    def ticks() -> None:
        while not stopped.wait(MOVED_EVERY):
            for part, share, since in tuple(at_work):
                took, usual = time.monotonic() - since, expected[part]
                inside = usual * (1.0 - math.exp(-took / usual)) / whole
                if took > TOLD_EVERY:
                    told = TOLD_EVERY * (took // TOLD_EVERY)
                    progress(f"{part}, {minutes(told)} of about {minutes(usual)}", share + inside)

    clock = threading.Thread(target=ticks, daemon=True)
    clock.start()
    try:
        yield begins
    finally:
        stopped.set()
        clock.join()
