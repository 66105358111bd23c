"""Where things lie in the two flat arrays of a moving body: its state, and everything that does not change with it.

One array each, because a compiled function that takes tuples of arrays apart pays for every array in them.
"""

from typing import Any, NamedTuple

POSITION, VELOCITY, TURN, ANGULAR_VELOCITY = 0, 3, 6, 10
STATE = 13

# The body and its surroundings: mass, three principal moments of inertia, acceleration of gravity (3), force (3) and
# torque (3) that disturb it, both in the frame of the map.
MASS, INERTIA, GRAVITY, FORCE, TORQUE = 0, 1, 4, 7, 10
# Drag (5, 3): linear (N s/m) along the axes of the map; linear and quadratic (N s^2/m^2) along those of the body;
# linear (N m s) and quadratic (N m s^2) of its turning. LOSSY: 1 if any of it is not zero.
DRAG, LOSSY = 13, 28
# A conducting plate: conductivity (0: none), thickness, a point of its face (3), the face's normal (3), which points to
# the side of the magnet; and what it sees of the magnet: moment (3) and place (3) in the frame of the body.
PLATE, DIPOLE = 29, 37
CONDUCTIVITY, THICKNESS, FACE, NORMAL = 0, 1, 2, 5
# Walls: stiffness (N/m) and damping (N s/m) of the penalty, friction coefficient, slip speed below which friction is
# viscous (m/s), height of floor and ceiling (m; infinite: none), radius of the tube (m; infinite: none), its axis (2).
CONTACT = 43
STIFFNESS, DAMPING, FRICTION, SLIP, FLOOR, CEILING, RADIUS, AXIS = 43, 44, 45, 46, 47, 48, 49, 50
# How many dipoles the magnet has, how many points the surface, and how many pieces are of soft iron; then six numbers a
# dipole, its point and its moment, three a point of the surface, and the array of fieldmap.kernels.map.induced_moment;
# all in the frame of the body, about its centre of mass.
MAGNETS, SKIN, SOFT, FIRST = 52, 53, 54, 55


class Plant(NamedTuple):
    """What a controller moves and what drives it.

    block: coefficients of the map's fields; body: the flat array above; seen_at (3,): the sensed point in the body;
    superposition: `fieldmap.kernels.motion.currents.Superposition`; coils (n, 4): as there; drives (n, 7): as in
    fieldmap.kernels.control.instruments.
    """

    block: Any
    body: Any
    seen_at: Any
    superposition: Any
    coils: Any
    drives: Any
