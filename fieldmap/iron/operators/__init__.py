"""Operators that depend on the mesh alone: charged surface, mutual potentials, air, sparse systems of the interior."""
