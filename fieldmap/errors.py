"""One exception family. Every message says where, what must hold, what was received, and the remedy."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    where: file and key path, or the function and argument; must_hold: the condition that was broken;
    received: what was given instead; remedy: what the user can do.
    """

    where: str
    must_hold: str
    received: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.where}: {self.must_hold}; received {self.received}; {self.remedy}"


class FieldmapError(Exception):
    """Base of all errors raised on purpose. `problems` holds one entry per thing that is wrong."""

    exit_code = 1

    def __init__(self, *problems: Problem) -> None:
        self.problems = problems
        super().__init__("\n".join(str(problem) for problem in problems))

    @classmethod
    def of(cls, where: str, must_hold: str, received: str, remedy: str) -> Self:
        """The error of one problem: see `Problem`.

        Parameters
        ----------
        where
            Place of the problem.
        must_hold
            What must hold there.
        received
            What was received.
        remedy
            What to do.

        Returns
        -------
        Self
            The error, to be raised.
        """
        return cls(Problem(where, must_hold, received, remedy))

    def __reduce__(self) -> tuple[Any, ...]:
        # Processes exchange errors by pickle; the default would call the constructor with the text.
        return type(self), self.problems, self.__dict__


class InputError(FieldmapError, ValueError):
    """Something the user gave (a file, an argument) cannot be used."""

    exit_code = 2


class MissingExtraError(FieldmapError, ImportError):
    """A library that only some functions need is not installed; the remedy is the command that installs it."""


class DeviceFileError(InputError):
    """A device file is wrong; `problems` lists every error of the file."""


class RecipeError(InputError):
    """A map recipe is wrong; `problems` lists every error of the file."""


class StudyError(InputError):
    """A study file is wrong; `problems` lists every error of the file."""


class FitError(InputError):
    """A fit file is wrong; `problems` lists every error of the file."""


class ScenarioError(InputError):
    """A scenario file is wrong; `problems` lists every error of the file."""


class GeometryError(InputError):
    """Bodies, coils and workspace cannot be built, overlap, or touch where they must not."""


class MapFileError(InputError):
    """A file is not a complete, valid map."""


class ControllerError(InputError):
    """A user's own controller failed in a run. time: of the sample, s; run: the record until then."""

    def __init__(self, *problems: Problem, time: float = 0.0, run: Any = None) -> None:
        super().__init__(*problems)
        self.time = time
        self.run = run


class OutsideMapError(InputError):
    """A point lies outside the box in which the map holds."""


class NotConverged(FieldmapError):  # noqa: N818 - a name fixed by the public interface
    """A solver stopped before its tolerance; `residuals` is its history."""

    def __init__(self, *problems: Problem, residuals: tuple[float, ...] = ()) -> None:
        super().__init__(*problems)
        self.residuals = residuals


class ToleranceNotReached(NotConverged):
    """The estimated error is still larger than the tolerance after the refinement of the mesh.

    report: how the run went, which part of which body would have to be refined, and what that would cost
    (`fieldmap.iron.error.ToleranceReport`); solution: the best so far. Both None if no mesh has an estimate.
    """

    def __init__(
        self, *problems: Problem, residuals: tuple[float, ...] = (), report: Any = None, solution: Any = None
    ) -> None:
        super().__init__(*problems, residuals=residuals)
        self.report = report
        self.solution = solution


class MapErrorTooLarge(NotConverged):
    """The error of a map is more than twice the error that its recipe allows; the map is not written under its name.

    reached: the errors and the recipe's limits (`fieldmap.store.MissedAccuracy`); part: the part of the current model
    that falls short, "states", "modes", "points", "fields" or "condensation", or "" if unknown.
    """

    def __init__(
        self, *problems: Problem, residuals: tuple[float, ...] = (), reached: Any = None, part: str = ""
    ) -> None:
        super().__init__(*problems, residuals=residuals)
        self.reached = reached
        self.part = part


class MapAccuracyWarning(UserWarning):
    """The error of an opened map is more than twice the error that its recipe allows."""


class UnusualValueWarning(UserWarning):
    """A length, mass, flux density or current is larger than usual for a bench machine, as if its unit were wrong.

    `warnings.simplefilter("ignore", fieldmap.errors.UnusualValueWarning)` turns the warning off.
    """


class NoEquilibrium(FieldmapError):  # noqa: N818 - reads as the outcome it is
    """No point with balanced forces was found; `problems` describes the search."""


class Infeasible(FieldmapError):  # noqa: N818 - a name fixed by the public interface
    """No currents within the limits meet the demand.

    Attributes, None or empty if unknown: reachable, the nearest possible result, in the order of the demand; share, the
    share of the demand that can be met; binding, the coils whose limits exclude the demand, with these limits, A;
    actuation, for several forces, their derivatives by the currents at the end (`fieldmap.lookup.Actuation`).
    """

    def __init__(
        self,
        *problems: Problem,
        reachable: Any = None,
        share: float | None = None,
        binding: Mapping[str, float] | None = None,
        actuation: Any = None,
    ) -> None:
        super().__init__(*problems)
        self.actuation = actuation
        self.reachable = reachable
        self.share = share
        self.binding = dict(binding or {})
