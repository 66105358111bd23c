"""Where the mesh of the iron must be finer for the field in the workspace: dipoles there, indicators, element sizes."""
