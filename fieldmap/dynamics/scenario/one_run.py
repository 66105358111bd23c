"""The shortest way: a scenario file in, a run with its metrics out."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from fieldmap.dynamics.outcome import LoopRun
from fieldmap.dynamics.scenario.build import prepare
from fieldmap.dynamics.scenario.metrics import RunMetrics, run_metrics
from fieldmap.dynamics.scenario.reader import Scenario, read_scenario
from fieldmap.lookup import FieldMap


@dataclass(frozen=True, eq=False)
class ScenarioRun(LoopRun):
    """A run (`LoopRun`) with its scenario and its metrics."""

    scenario: Scenario
    metrics: RunMetrics


def simulate(
    path_or_name: str | Path,
    changes: Mapping[str, Any] | None = None,
    *,
    field_map: FieldMap | None = None,
    seed: int | None = None,
) -> ScenarioRun:
    """Run a scenario: its file, or the name of a shipped one.

    changes: values by dotted key in the place of the file's, such as {"control.z.Kc": 0.2}. field_map: an opened map in
    the place of the scenario's. seed: in the place of its own. Raises ScenarioError with every error of the file,
    MapFileError, NoEquilibrium where the machine has no rest at the start. A run that fails does not raise: `event`
    says what happened.

    >>> run = simulate("vertical_step")                                               # doctest: +SKIP
    >>> run.metrics.axes[2].step.overshoot                                            # doctest: +SKIP
    0.387
    """
    experiment = prepare(read_scenario(path_or_name, changes), field_map)
    run, scenario = experiment.run(seed), experiment.scenario
    known = {field.name: getattr(run, field.name) for field in fields(LoopRun)}
    return ScenarioRun(**known, scenario=scenario, metrics=run_metrics(scenario, run))
