"""Where things lie in the arrays of a moving body."""

POSITION, VELOCITY, TURN, SPIN = 0, 3, 6, 10
STATE = 13

# Numbers of a body (BODY,): mass, three principal moments of inertia, acceleration of gravity (3), force (3) and
# torque (3) that disturb it, both in the frame of the map.
MASS, INERTIA, GRAVITY, FORCE, TORQUE = 0, 1, 4, 7, 10
BODY = 13
