"""Program for the environment of mag_manip: evaluates a file with mag_manip itself. Not imported by anything.

    python mag_manip_reader.py MAP.yaml GIVEN.npz READ.npz

GIVEN: points (n, 3), m, and currents (n_coils,), A. READ: unit_field (n, 3, n_coils), T/A, gradient (n, 3, 3), T/m, and
currents (n, n_coils), A, of the backward model for the field of the given currents.
"""

import sys

import numpy as np
from mag_manip import mag_manip


def main() -> None:
    """Read the file with the forward and the backward model for vector fields, with default options."""
    source, given_path, target = sys.argv[1:]
    given = np.load(given_path)
    forward, backward = mag_manip.ForwardModelLinearVField(), mag_manip.BackwardModelLinearVFieldL2()
    forward.setCalibrationFile(source)
    backward.setCalibrationFile(source)
    unit_field, gradient, currents = [], [], []
    for point in given["points"]:
        unit_field.append(np.array(forward.getFieldActuationMatrix(point)))
        gradient.append(np.array(forward.computeGradientMatFromCurrents(point, given["currents"])))
        field = np.array(forward.computeFieldFromCurrents(point, given["currents"])).ravel()
        currents.append(np.array(backward.computeCurrentsFromField(point, field)).ravel())
    np.savez(target, unit_field=unit_field, gradient=gradient, currents=currents)


main()
