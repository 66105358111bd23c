"""The pieces of a winding's middle line, by name: rows of the arrays that `fieldmap.kernels.coils.path` takes."""

from typing import NamedTuple


class Arc(NamedTuple):
    """A row of `arcs` (n, 8): centre, m; unit vector from there to the arc's middle; half of the angle that it turns
    by, pi/4 at most; inner and outer radius of the winding, m; sense of the current, 1 counter-clockwise or -1."""

    x: float
    y: float
    middle_x: float
    middle_y: float
    half_angle: float
    inner: float
    outer: float
    sense: float


class Bar(NamedTuple):
    """A row of `bars` (n, 5): middle, m; unit vector of the current; half length, m."""

    x: float
    y: float
    along_x: float
    along_y: float
    half_length: float
