"""Coils as sources: flux density and its gradient per ampere, from a device's data.

Depends on: errors, kernels, device. The only door to magpylib is `fieldmap.sources.magpylib_coils`.
"""

from fieldmap.sources.coils import unit_flux_densities, unit_flux_density, unit_flux_density_and_gradient

__all__ = ["unit_flux_densities", "unit_flux_density", "unit_flux_density_and_gradient"]
