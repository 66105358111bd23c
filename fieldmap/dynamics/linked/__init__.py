"""Controllers that know the linked machine: regulators on physical states, feed-forward, feedback linearisation."""

from fieldmap.dynamics.linked.feedforward import Trajectory, feedforward, outputs_for, trajectory
from fieldmap.dynamics.linked.forces import force_controller
from fieldmap.dynamics.linked.gaussian import GaussianWeights, gaussian_block
from fieldmap.dynamics.linked.scheduled import ForceController, ScheduledController

__all__ = [
    "ForceController",
    "GaussianWeights",
    "ScheduledController",
    "Trajectory",
    "feedforward",
    "force_controller",
    "gaussian_block",
    "outputs_for",
    "trajectory",
]
