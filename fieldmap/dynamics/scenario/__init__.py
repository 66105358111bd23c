"""Scenarios: an experiment in a TOML file, its simulation, and the metrics of its runs."""

from fieldmap.dynamics.scenario.batches import Batch, Simulation, simulate_batches, write_simulation
from fieldmap.dynamics.scenario.experiment import Experiment, ScenarioRun, open_machine, prepare, simulate
from fieldmap.dynamics.scenario.linear_points import Linearisation, LinearPoint, linear_points
from fieldmap.dynamics.scenario.measured_log import LaidLog, lay_over, read_measured_log
from fieldmap.dynamics.scenario.metrics import reading_mm, run_metrics
from fieldmap.dynamics.scenario.schema import read_scenario
from fieldmap.dynamics.scenario.tuning import Tuning, tune_axes

__all__ = [
    "Batch",
    "Experiment",
    "LaidLog",
    "LinearPoint",
    "Linearisation",
    "ScenarioRun",
    "Simulation",
    "Tuning",
    "lay_over",
    "linear_points",
    "open_machine",
    "prepare",
    "read_measured_log",
    "read_scenario",
    "reading_mm",
    "run_metrics",
    "simulate",
    "simulate_batches",
    "tune_axes",
    "write_simulation",
]
