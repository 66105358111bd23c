"""Read a scenario file and check all of it."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fieldmap.dynamics.scenario.schema import SCENARIO, ScenarioFile
from fieldmap.errors import Problem, ScenarioError
from fieldmap.inputs.document import Document, schema_findings
from fieldmap.inputs.toml_lines import line_numbers
from fieldmap.records import Record

# A table that had another name, by which scenarios of earlier versions are read.
_OLDER_TABLE, _TABLE = ("control", "linked"), ("control", "coupled")


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Record):
    """A scenario as written: path and text of the file, its contents, and what was changed of them by the caller."""

    path: Path
    text: str
    contents: ScenarioFile
    changes: Mapping[str, Any]

    @property
    def start_depth_mm(self) -> float:
        """Reading of the vertical sensor at the start; of a prepared scenario, which has chosen one."""
        depth = self.contents.start.depth_mm
        return math.nan if depth is None else depth

    @property
    def zero_depth_mm(self) -> float:
        """Depth below the map's origin at which the vertical sensor reads 0."""
        return self.contents.sensors.zero_depth_mm

    def error(self, key: str, must_hold: str, received: str, remedy: str) -> ScenarioError:
        """An error at a key of the file."""
        if _OLDER_TABLE in line_numbers(self.text):
            key = ".".join(_exchanged(tuple(key.split(".")), _TABLE, _OLDER_TABLE))
        return ScenarioError(Document(self.path, self.text, {}).problem(key, must_hold, received, remedy))


def read_scenario(path_or_name: str | Path, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Read and check a scenario file: its path, or the name of a shipped one ("vertical_step").

    changes: values by dotted key, such as {"control.z.Kc": 0.2}, in the place of those of the file. The format is
    described in docs/dynamics.md. Raises ScenarioError with one Problem for every error of the file: file, line and
    key path; what must hold; what was received; the remedy.
    """
    path = find_scenario(path_or_name)
    document = SCENARIO.load(path)
    data = tomllib.loads(document.text)
    older = _rename(data, _OLDER_TABLE, _TABLE)
    for key, value in (changes or {}).items():
        _change(data, path, ".".join(_exchanged(tuple(key.split(".")), _OLDER_TABLE, _TABLE)), value)
    findings = schema_findings(ScenarioFile, data)
    if findings:
        if older:
            _rename(data, _TABLE, _OLDER_TABLE)
            findings = [
                replace(finding, location=_exchanged(finding.location, _TABLE, _OLDER_TABLE))
                for finding in findings
            ]
        raise ScenarioError(*Document(path, document.text, data).problems(findings))
    contents = ScenarioFile.model_validate(data)
    return Scenario(path, document.text, contents, dict(changes or {}))


def find_scenario(path_or_name: str | Path) -> Path:
    """The file at a path, or the shipped one of that name; ScenarioError if there is neither."""
    if Path(path_or_name).suffix.lower() in (".h5", ".hdf5"):
        remedy = f"a scenario says what happens in it: fieldmap simulate hold --map {path_or_name}"
        raise ScenarioError(
            Problem(str(path_or_name), "must be a scenario file", "the name of a map", remedy)
        )
    return SCENARIO.find(path_or_name)


def _exchanged(steps: tuple[Any, ...], old: tuple[str, str], new: tuple[str, str]) -> tuple[Any, ...]:
    """The steps of a key with the beginning `old` replaced by `new`."""
    return (*new, *steps[2:]) if steps[:2] == old else steps


def _rename(data: dict[str, Any], old: tuple[str, str], new: tuple[str, str]) -> bool:
    """Rename a table of data; whether there was one, and none of the new name."""
    table = data.get(old[0])
    if not isinstance(table, dict) or old[1] not in table or new[1] in table:
        return False
    table[new[1]] = table.pop(old[1])
    return True


def _change(data: dict[str, Any], path: Path, key: str, value: Any) -> None:
    """Set a value by its dotted key; steps that are numbers count in a list."""
    *steps, last = key.split(".")
    here: Any = data
    for step in steps:
        if isinstance(here, list) and step.isdigit() and int(step) < len(here):
            here = here[int(step)]
        elif isinstance(here, dict):
            here = here.setdefault(step, {})
        else:
            here = None
    if isinstance(here, list) and last.isdigit() and int(last) < len(here):
        here[int(last)] = value
    elif isinstance(here, dict):
        here[last] = value
    else:
        problem = Problem(
            f"{path}: {key}", "must be a key of the scenario", "a step that is no table", "write table.key"
        )
        raise ScenarioError(problem)
