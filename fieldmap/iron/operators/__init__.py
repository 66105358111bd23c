"""What the mesh alone decides: the charged surface, its mutual potentials, the air, the sparse interior."""
