"""From field and gradient at the nodes of a grid to the coefficients of an interpolant: three forms of one map.

Both halves of the house need it: MAKE to certify a map against the solver, USE to look it up.
"""

from fieldmap.interpolants.cell_form import cell_form
from fieldmap.interpolants.form import OUTSIDE_RULES, Form, contract, set_size
from fieldmap.interpolants.global_form import global_form
from fieldmap.interpolants.hermite_form import hermite_form
from fieldmap.interpolants.jumps import Jump, jump_between_cells

__all__ = [
    "OUTSIDE_RULES",
    "Form",
    "Jump",
    "cell_form",
    "contract",
    "global_form",
    "hermite_form",
    "jump_between_cells",
    "set_size",
]
