"""From field and gradient at the nodes of a grid to the coefficients of an interpolant.

A new interpolant is a module with an `INTERPOLANT` and one line in the list below, or a module of another package that
is its entry point of the group "fieldmap.interpolants". Maps are certified and looked up with interpolants.
"""

from fieldmap.extensions import installed_modules
from fieldmap.interpolants import global_polynomial, harmonic_cells, hermite
from fieldmap.interpolants.form import OUTSIDE_RULES, Form, Interpolant, Jump, contract, set_size
from fieldmap.interpolants.global_polynomial import global_form
from fieldmap.interpolants.harmonic_cells import cell_form, jump_between_cells
from fieldmap.interpolants.hermite import hermite_form

INTERPOLANTS: dict[str, Interpolant] = {
    module.INTERPOLANT.name: module.INTERPOLANT for module in (harmonic_cells, hermite, global_polynomial)
}
"""By name, in the order in which they are offered; the first is the default of `open_map`."""


def known_interpolants(wanted: object) -> list[str]:
    """Names of all interpolants. Other installed packages are searched only if `wanted` is not known yet."""
    if isinstance(wanted, str) and wanted not in INTERPOLANTS:
        added = [module.INTERPOLANT for module in installed_modules("fieldmap.interpolants")]
        INTERPOLANTS.update({each.name: each for each in added})
    return list(INTERPOLANTS)


__all__ = [
    "INTERPOLANTS",
    "OUTSIDE_RULES",
    "Form",
    "Interpolant",
    "Jump",
    "cell_form",
    "contract",
    "global_form",
    "hermite_form",
    "jump_between_cells",
    "set_size",
]
