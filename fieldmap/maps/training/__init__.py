"""The model of the currents of a map of saturating iron: states to solve, modes, sample points, errors."""
