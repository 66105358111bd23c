"""The lift current in an opened map, whether its field is proportional to the currents or not."""

from typing import Any

import numpy as np

from fieldmap.device.model import Payload
from fieldmap.levitation import LiftCurrent, lift_current


def lift_in_map(opened: Any, payload: Payload, point: Any) -> LiftCurrent:
    """Common current that carries the payload with its magnet at `point` (3,).

    In a map of saturating iron the search begins at its reference currents. Raises Infeasible where the field
    does not lift, OutsideMapError where the current would lie beyond those the map was made for.
    """
    return lift_current(opened, payload, point, first=float(np.mean(opened.info.reference_current)))
