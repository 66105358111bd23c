"""Tetrahedra of the iron: the mesher, equal-volume rounding, layers towards sharp edges, faces."""
