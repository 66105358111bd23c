"""Bodies and windings as solids of the CAD kernel, and whether they fit together."""
