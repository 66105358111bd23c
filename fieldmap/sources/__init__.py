"""Coils as sources: flux density and its gradient per ampere, from a device's data.

Depends on: errors, kernels, device. The only doors to magpylib are `magpylib_coils` and `magpylib_magnets` here.
"""

from fieldmap.sources.coils import unit_flux_densities, unit_flux_density, unit_flux_density_and_gradient

__all__ = ["unit_flux_densities", "unit_flux_density", "unit_flux_density_and_gradient"]
