"""Identification of models from records of a rig, in open and closed loop.

Equation numbers in docstrings are those of docs/theory/identification.md. Depends on: errors, arguments, linear models
of `fieldmap.control`, scipy.
"""

from fieldmap.control.identification.estimators import (
    RecursiveRun,
    armax,
    generalised_least_squares,
    identify_direct,
    identify_indirect,
    identify_two_stage,
    least_squares,
    modified_least_squares,
    modified_least_squares_runs,
    recursive_least_squares,
)
from fieldmap.control.identification.excitation import pseudo_random_binary
from fieldmap.control.identification.identify_log import METHODS, ROLES, IdentifiedLog, identify_log
from fieldmap.control.identification.log import Log, make_log, read_log, write_log
from fieldmap.control.identification.regression import Estimate, EstimatedRuns, Orders
from fieldmap.control.linear_models import RootLocus, root_locus
from fieldmap.control.step_responses import StepFit, fit_first_order, fit_second_order, noisy_step_metrics
from fieldmap.inputs.columns import Column

__all__ = [
    "METHODS",
    "ROLES",
    "Column",
    "Estimate",
    "EstimatedRuns",
    "IdentifiedLog",
    "Log",
    "Orders",
    "RecursiveRun",
    "RootLocus",
    "StepFit",
    "armax",
    "fit_first_order",
    "fit_second_order",
    "generalised_least_squares",
    "identify_direct",
    "identify_indirect",
    "identify_log",
    "identify_two_stage",
    "least_squares",
    "make_log",
    "modified_least_squares",
    "modified_least_squares_runs",
    "noisy_step_metrics",
    "pseudo_random_binary",
    "read_log",
    "recursive_least_squares",
    "root_locus",
    "write_log",
]
