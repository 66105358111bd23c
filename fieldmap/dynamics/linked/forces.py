"""Feedback linearisation: a regulator of a free mass whose forces the inverse map makes: theory/dynamics.md (44)."""

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.dynamics.closed_loop import Machine
from fieldmap.dynamics.linear import LinearMachine
from fieldmap.dynamics.linked.gaussian import GaussianWeights, gaussian_block
from fieldmap.dynamics.linked.scheduled import ForceController
from fieldmap.dynamics.trim import Trim


def force_controller(
    machine: Machine,
    rest: Trim,
    weights: GaussianWeights,
    period: float,
    lower: ArrayLike,
    upper: ArrayLike,
    delay: float = 0.0,
    rounds: int = 2,
) -> ForceController:
    """A regulator that is the same at every place: what it asks for is a force, and the inverse map of the machine's
    own field turns it into outputs within limits (3,) each.

    weights.output: forces, N, that count as much as the deviations. The body is taken for a free mass: neither the
    field's stiffness nor eddy currents and drag are known to it but as forces that it does not know.
    """
    mass = machine.body.mass
    A, push = np.zeros((6, 6)), np.vstack([np.zeros((3, 3)), np.eye(3) / mass])
    A[:3, 3:] = np.eye(3)
    weight = np.array([0.0, 0.0, mass * machine.body.gravity])
    free = LinearMachine(
        A,
        push,
        np.eye(3, 6),
        np.zeros((3, 3)),
        np.hstack([push, np.zeros((6, 3))]),
        ("x", "y", "z", "vx", "vy", "vz"),
        ("Fx", "Fy", "Fz"),
        ("x", "y", "z"),
        Trim(rest.state, rest.currents, weight, rest.sensed, rest.residual),
        (),
    )
    block = gaussian_block(free, weights, period, delay)
    return ForceController(
        block, np.asarray(lower, float), np.asarray(upper, float), rest.outputs.copy(), rounds
    )
