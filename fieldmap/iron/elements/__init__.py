"""Finite elements inside the iron, and the material laws that they evaluate."""
