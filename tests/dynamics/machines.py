"""Machines as loops advance them, for tests of what these take from a field."""

import numpy as np

from fieldmap.dynamics import CoilDrive, Machine, MatrixAllocation, RigidBody, Sensors
from fieldmap.instruments import Amplifier
from fieldmap.lookup import MagneticBody

ANY_BODY = RigidBody(0.01, [1e-6] * 3, MagneticBody(np.zeros((1, 3)), np.zeros((1, 3))), gravity=0.0)


def machine_in(of, coils, body=ANY_BODY):
    """The core's machine of a body in a field of currents of so many coils."""
    direct = MatrixAllocation(np.eye(coils), np.zeros(coils))
    return Machine(of, body, CoilDrive(Amplifier(1.0), coils), Sensors(), direct).core(1.0)
