"""Coils as sources: flux density and its gradient per ampere, from a device's data; coils alone as a field.

Windings and magnetised tetrahedra as objects of magpylib: `fieldmap.sources.magpylib_objects`.
"""

from fieldmap.extras import needs

# As in fieldmap.iron: without scipy, this import raises one error for all modules.
with needs("make", "fieldmap.sources"):
    import scipy

    del scipy

from fieldmap.sources.coil_set import CoilSet
from fieldmap.sources.coils import unit_flux_densities, unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.inductance import bare_inductance

__all__ = [
    "CoilSet",
    "bare_inductance",
    "unit_flux_densities",
    "unit_flux_density",
    "unit_flux_density_and_gradient",
]
