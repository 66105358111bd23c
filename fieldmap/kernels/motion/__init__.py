"""Motion of a rigid magnet in a mapped field, compiled: one file per physical effect, plain arrays throughout.

State (13,): position of the centre of mass (3) and velocity (3) in the frame of the map, unit quaternion body -> map
(w, x, y, z), angular velocity (3) in the frame of the body, whose axes are principal axes of inertia.
docs/theory/dynamics.md numbers the equations.
"""
