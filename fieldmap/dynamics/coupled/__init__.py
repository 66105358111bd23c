"""Controllers of all axes at once: regulators on physical states, feed-forward, feedback linearisation."""

from fieldmap.dynamics.coupled.feedback_linearisation import ForceController, force_controller
from fieldmap.dynamics.coupled.feedforward import Trajectory, feedforward, outputs_for, trajectory
from fieldmap.dynamics.coupled.lqg import LqgWeights, lqg_block
from fieldmap.dynamics.coupled.scheduled import ScheduledController

__all__ = [
    "ForceController",
    "LqgWeights",
    "ScheduledController",
    "Trajectory",
    "feedforward",
    "force_controller",
    "lqg_block",
    "outputs_for",
    "trajectory",
]
