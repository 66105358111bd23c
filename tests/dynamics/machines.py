"""Machines as closed loops advance them, for tests of single parts of a loop."""

import numpy as np

from fieldmap.dynamics import CoilDrive, Drag, Machine, MatrixAllocation, RigidBody, Sensors, superposed
from fieldmap.instruments import Amplifier
from fieldmap.lookup import MagneticBody

ANY_BODY = RigidBody(0.01, [1e-6] * 3, MagneticBody(np.zeros((1, 3)), np.zeros((1, 3))), gravity=0.0)


MASS, MOMENT, PERIOD, GAIN = 0.01, 0.8, 2e-3, 0.4
# Slope and curvature of the coil's field: 2 A carry the body at the origin; the field falls with depth.
SLOPE, CURVE = MASS * 9.80665 / MOMENT / 2.0, 1.2
# Scenario changes: a body that turns freely, no noise, no quantisation, at rest in the middle of `vertical_step`.
QUIET = {
    "body.turning": "free",
    "noise.off": True,
    "coils.output_bits": None,
    "control.z.lower": None,
    "control.z.upper": None,
    "sensors.angle_deg": 0.0,
    "reference.0.by_mm": 0.0,
    "drag.turning_N_m_s": [1e-6, 1e-6, 1e-6],
}


def one_coil(axial, drive=None, sensors=None, names=(), linkage=None, **body):
    """A machine of that coil, whose sensors see a point 5 mm above the magnet; `body`: further keys of `RigidBody`."""
    of = {"magnet": axial.dipole(MOMENT), "seen_at": [0, 0, 5e-3], **body}
    carried = RigidBody(MASS, [6e-7, 6e-7, 2e-7], **of)
    field = superposed(axial.map((0.02, SLOPE, CURVE), kind="harmonic", linkage=linkage))
    one, drag = MatrixAllocation(np.eye(1), np.zeros(1), names), Drag((0.05,) * 3, turning=(1e-5,) * 3)
    drive = drive or CoilDrive(Amplifier(GAIN, -10.0, 10.0), 1)
    return Machine(field, carried, drive, sensors or Sensors(), one, drag)


def machine_in(of, coils, body=ANY_BODY):
    """The core's machine of a body in the field of the given number of coils, with direct currents."""
    direct = MatrixAllocation(np.eye(coils), np.zeros(coils))
    return Machine(of, body, CoilDrive(Amplifier(1.0), coils), Sensors(), direct).core(1.0)
