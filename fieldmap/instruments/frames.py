"""The frame of two crossed position sensors, and the frame of the machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_not_negative, check_numbers, check_signal
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class SensorFrame(Record):
    """Two sensors in a plane, turned against the machine's axes, that see the near edge of a round body.

    angle: of the sensors' axes against the machine's, rad. offset: reading of each sensor on the machine's axis, m.
    radius: of the body, from the edge that is seen to its centre, m. bias: what is added to the machine's x and y
    for the tolerances of the mounting, m.

    Local positions are (..., 3): the two readings and, unchanged by the transform, the third coordinate.

    >>> frame = SensorFrame(np.pi / 4, offset=0.026, radius=0.0059)
    >>> frame.to_global([0.0201, 0.0201, 0.010]).round(6).tolist()
    [0.0, 0.0, 0.01]
    """

    angle: float
    offset: float
    radius: float = 0.0
    bias: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_numbers("SensorFrame", angle=self.angle, offset=self.offset, x=self.bias[0], y=self.bias[1])
        check_not_negative("SensorFrame", radius=self.radius)

    @property
    def matrix(self) -> Array:
        """Homogeneous transform (4, 4) from local to global, without bias."""
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        shift = self.radius - self.offset
        turn = np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        move = np.eye(4)
        move[:2, 3] = shift
        return turn @ move

    def to_global(self, local: ArrayLike) -> Array:
        """Positions (..., 3) in the machine's frame, m, of local positions (..., 3).

        Raises InputError for numbers that are not finite, or another shape.
        """
        points = check_signal("SensorFrame.to_global(local)", local, columns=3)
        matrix = self.matrix
        return points @ matrix[:3, :3].T + matrix[:3, 3] + [*self.bias, 0.0]

    def to_local(self, position: ArrayLike) -> Array:
        """What the sensors read, (..., 3), m, at positions (..., 3) of the machine's frame; inverse of `to_global`.

        Raises InputError for numbers that are not finite, or another shape.
        """
        points = check_signal("SensorFrame.to_local(position)", position, columns=3)
        matrix = self.matrix
        return (points - [*self.bias, 0.0] - matrix[:3, 3]) @ matrix[:3, :3]

    def global_deviation(self, local_x: float, local_y: float) -> tuple[float, float]:
        """Standard deviations of the machine's x and y, m, from those of two independent readings, m.

        docs/theory/control.md (11): the diagonal of R diag(local_x^2, local_y^2) R^T. At 45 degrees both are the root
        mean square of the two.

        >>> sx, sy = SensorFrame(np.pi / 4, offset=0.026).global_deviation(5.42e-6, 8.38e-6)
        >>> print(f"{1e3 * sx:.5f} {1e3 * sy:.5f} mm")
        0.00706 0.00706 mm
        """
        check_not_negative("SensorFrame.global_deviation", local_x=local_x, local_y=local_y)
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        return float(np.hypot(cosine * local_x, sine * local_y)), float(
            np.hypot(sine * local_x, cosine * local_y)
        )
