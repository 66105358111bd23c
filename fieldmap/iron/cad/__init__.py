"""From bodies and coils of a device to solids of the CAD kernel, and what is checked on them before meshing."""
