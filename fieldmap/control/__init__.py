"""Controllers: as their samples run, and as the transfer functions and matrices they are designed with.

Depends on: errors, kernels, scipy. Identification of plants from measurements belongs here as well.
"""

__all__: list[str] = []
