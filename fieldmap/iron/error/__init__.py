"""How far a solution is from the truth, and meshes refined until it is near enough."""
