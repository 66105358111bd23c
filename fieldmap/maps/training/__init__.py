"""Training of the reduced model of a map of saturating iron: states to solve, modes, sample points, errors."""
