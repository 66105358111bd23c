"""Results of an optimisation: the best design, the path to it, and the check on a finer mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fieldmap.device.model import Device
from fieldmap.errors import Infeasible, Problem
from fieldmap.plain import Plain, plain_items
from fieldmap.provenance import library_versions
from fieldmap.records import Record
from fieldmap.studies.design import Variable, settings_at
from fieldmap.studies.run import csv_table, require_xarray
from fieldmap.studies.study import setting_words

Kind = Literal["exact", "differences", "none"]
Role = Literal["step", "difference", "check", "sample"]


# Fields that `to_dict` takes over under their own names.
_AS_THEY_ARE = (
    *("maximise", "limits", "derivatives", "refused", "verified", "solves"),
    *("kept", "ended", "method", "path", "assumptions"),
)


@dataclass(frozen=True, repr=False)
class LimitAtOptimum(Record):
    """A limit at the best design: value of the number on the mesh of the search and on the finer one (None without a
    check), bounds, SI units. active: whether it is at a bound; holds: whether the limit holds on the finest mesh."""

    number: str
    value: float
    finer: float | None
    lower: float
    upper: float
    active: bool
    holds: bool


@dataclass(frozen=True, repr=False)
class Check(Record):
    """The best design on a finer mesh: its refinement, the ratio to the refinement of the search, the objective there,
    and whether every limit holds. failure: why it could not be solved, or ""."""

    refinement: float
    times_finer: float
    objective: float
    holds: bool
    failure: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Step(Record):
    """A design that was solved, in the order in which it was asked for.

    role: a step of the search, a design for a difference, a check on a finer mesh, or a random sample. kept: whether an
    earlier run had solved it. values: by key; numbers: by label, empty if it failed; feasible: whether the limits hold;
    failure: why it was not solved, or "".
    """

    role: Role
    kept: bool
    refinement: float
    values: Mapping[str, float]
    numbers: Mapping[str, float]
    feasible: bool
    failure: str


@dataclass(frozen=True, eq=False, repr=False)
class Optimum(Record):
    """The best design that was found.

    values: of the variables, by key, in their units; objective: label of the number, with its value here and its
    start_value, SI units; limits at the best design; variables with their bounds.

    derivatives: "exact" (adjoint) or "differences", by label of the number and key; "none" for a method without
    derivatives; refused: keys without an exact derivative, and why. verified: the check on a finer mesh.

    path: every design that was solved; solves: number of designs that this run solved; kept: number from an earlier
    run. ended: why the search ended. device: the best design; start_device: the first. maximise: whether the objective
    was maximised. written: files.
    """

    title: str
    values: Mapping[str, float]
    objective: str
    value: float
    start_value: float
    limits: tuple[LimitAtOptimum, ...]
    variables: tuple[Variable, ...]
    derivatives: Mapping[str, Mapping[str, Kind]]
    refused: Mapping[str, str]
    verified: Check | None
    path: tuple[Step, ...]
    solves: int
    kept: int
    ended: str
    method: str
    device: Device
    start_device: Device
    maximise: bool
    assumptions: tuple[str, ...]
    written: tuple[Path, ...] = ()

    @property
    def settings(self) -> dict[str, float]:
        """Every key of the device file that the best design sets, with linked keys, in their units; for
        `read_device(device, settings)` and `--set`."""
        return dict(settings_at(self.variables, self.values))

    @property
    def failed(self) -> dict[str, str]:
        """Designs that could not be solved, in words, and why."""
        return {setting_words(step.values): step.failure for step in self.path if step.failure}

    @property
    def data(self) -> Any:
        """The path as an xarray.Dataset over `design`: variables by key, numbers by label, role, feasible, failure.

        Raises FieldmapError if xarray is not installed.
        """
        xarray = require_xarray()
        columns = {name: ("design", np.array(values)) for name, values in self._columns().items()}
        attributes = {name: getattr(self, name) for name in ("title", "objective", "method", "ended")}
        versions = library_versions("xarray", "h5netcdf")
        attributes["source"] = ", ".join(f"{name} {version}" for name, version in versions.items())
        attributes["assumptions"] = "\n".join(self.assumptions)
        return xarray.Dataset(columns, coords={"design": np.arange(len(self.path))}, attrs=attributes)

    def csv_text(self) -> str:
        """The path as a table, one line for each design."""
        columns = self._columns()
        rows = enumerate(zip(*columns.values(), strict=True))
        return csv_table([["design", *columns], *([number, *row] for number, row in rows)])

    def _columns(self) -> dict[str, list[Any]]:
        labels = dict.fromkeys([self.objective, *(one.number for one in self.limits)])
        rows: list[dict[str, Any]] = []
        for step in self.path:
            numbers = {label: step.numbers.get(label, np.nan) for label in labels}
            end = {name: getattr(step, name) for name in ("refinement", "feasible", "failure")}
            rows.append({"role": step.role, **step.values, **numbers, **end})
        return {name: [row[name] for row in rows] for name in rows[0]}

    def to_dict(self) -> dict[str, Plain]:
        """The result as plain Python: variables in their units, all else in SI units."""
        return plain_items(
            title=self.title,
            values=self.values,
            objective={"number": self.objective, "value": self.value, "at_start": self.start_value},
            **{name: getattr(self, name) for name in _AS_THEY_ARE},
        )


class NoFeasibleDesign(Infeasible):
    """No design within the bounds meets all limits. problems: one for each violated limit at the nearest design;
    nearest: the values of this design by key; path: all solved designs."""

    def __init__(
        self, *problems: Problem, nearest: Mapping[str, float] | None = None, path: tuple[Step, ...] = ()
    ) -> None:
        super().__init__(*problems)
        self.nearest, self.path = dict(nearest or {}), path
