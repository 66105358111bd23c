"""Compiled parts of the iron solver: charged triangles, element loops, material laws, far blocks."""
