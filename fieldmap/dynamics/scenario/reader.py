"""Read a scenario file and check all of it."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldmap.dynamics.scenario.schema import SCENARIO, ScenarioFile
from fieldmap.errors import Problem, ScenarioError
from fieldmap.inputs.document import Document


@dataclass(frozen=True, eq=False)
class Scenario:
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

    def error(self, key: str, must_hold: str, received: str, remedy: str) -> ScenarioError:
        """An error at a key of the file."""
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
    for key, value in (changes or {}).items():
        _change(data, path, key, value)
    contents = SCENARIO.contents(Document(path, document.text, data))
    return Scenario(path, document.text, contents, dict(changes or {}))


def find_scenario(path_or_name: str | Path) -> Path:
    """The file at a path, or the shipped one of that name; ScenarioError if there is neither."""
    if Path(path_or_name).suffix.lower() in (".h5", ".hdf5"):
        remedy = f"a scenario says what happens in it: fieldmap simulate hold --map {path_or_name}"
        raise ScenarioError(
            Problem(str(path_or_name), "must be a scenario file", "the name of a map", remedy)
        )
    return SCENARIO.find(path_or_name)


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
