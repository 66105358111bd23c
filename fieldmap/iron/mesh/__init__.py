"""Tetrahedral meshes of the iron: graded, rounded, and symmetric where the iron is."""
