"""Force balance, stiffness and lift current of a levitated magnet in any map of a field.

Depends on: errors, device (payload), scipy.optimize. Never on the rooms that make maps: every function here
takes an object with `field`, `gradient`, `second_gradient`, `coil_names`, `lower` and `upper`
(`LevitationField`).
"""

from fieldmap.levitation.conventions import (
    GRAVITY,
    SENSOR_ZERO_DEPTH,
    magnet_height,
    sensor_reading,
    thesis_lift_current,
)
from fieldmap.levitation.differences import DifferencedField
from fieldmap.levitation.dipole import dipole_force, dipole_stiffness
from fieldmap.levitation.equilibrium import find_equilibrium
from fieldmap.levitation.fixed_currents import FixedCurrents
from fieldmap.levitation.force_fits import Fit, fit_horizontal_force, fit_quadratic_force, fit_vertical_force
from fieldmap.levitation.force_formulas import Exponential, HorizontalForce, QuadraticForce, VerticalForce
from fieldmap.levitation.interface import LevitationField
from fieldmap.levitation.lift import LiftCurrent, lift_current
from fieldmap.levitation.lift_nonlinear import lift_current_nonlinear
from fieldmap.levitation.result import Equilibrium, SearchReport

__all__ = [
    "GRAVITY",
    "SENSOR_ZERO_DEPTH",
    "DifferencedField",
    "Equilibrium",
    "Exponential",
    "Fit",
    "FixedCurrents",
    "HorizontalForce",
    "LevitationField",
    "LiftCurrent",
    "QuadraticForce",
    "SearchReport",
    "VerticalForce",
    "dipole_force",
    "dipole_stiffness",
    "find_equilibrium",
    "fit_horizontal_force",
    "fit_quadratic_force",
    "fit_vertical_force",
    "lift_current",
    "lift_current_nonlinear",
    "magnet_height",
    "sensor_reading",
    "thesis_lift_current",
]
