"""Plan of a run over parts: finished parts, missing maps, order and expected time; and the run itself, with progress
that moves while a part is computed."""

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
"""Approximate time to make a map on two processors, s."""
COMPILATION = 240.0
"""Approximate time to compile the kernels of maps and parts on two processors, s."""
_FINISHED = 0.05
"""Approximate time to read a finished part, s."""
MOVED_EVERY = 1.0
"""Period of progress updates while a part is computed, s."""
TOLD_EVERY = 10.0
"""Resolution of the shown time that a part has taken, s."""


@dataclass(frozen=True, repr=False)
class Stage(Record):
    """One step of a run: parts with the seconds expected of each, or a recipe whose map is made at `target`."""

    expected: Mapping[str, float] = field(default_factory=dict)
    recipe: str = ""
    target: Path = Path()

    @property
    def seconds(self) -> float:
        """Expected time of the whole stage, s."""
        return MAP_SECONDS.get(self.recipe, 60.0) if self.recipe else sum(self.expected.values())


@dataclass(frozen=True, repr=False)
class Plan(Record):
    """stages: parts without a map first, then maps, then the parts that need them. finished: number of cached parts.

    left_out: missing maps that will not be made -> number of parts that need each. compiles: whether the run compiles
    kernels.
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
        """Expected time of all stages without compilation, s."""
        return sum(stage.seconds for stage in self.stages) or 1.0

    @property
    def seconds(self) -> float:
        """Expected time of the run, s."""
        return self.whole + (COMPILATION if self.compiles else 0.0)

    @property
    def text(self) -> str:
        """One line with the number of parts, the missing maps and the expected time."""
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
    """The plan of these parts. report: folder with the cache of finished parts. compiles: as in `Plan`."""
    finished = 0
    # Expected seconds of parts that need no map, and of parts that need one.
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
    """Compute the parts of a plan, one by one. Missing maps are made before the first part that needs one."""
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
    """Progress for `attempt_rows` that moves while a part is computed, at the rate of its expected time.

    The progress of a part slows down exponentially and never passes the end of the part.
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
