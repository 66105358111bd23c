"""Force balance, stiffness and lift current of a levitated magnet in any map of a field.

Depends on: errors, device (payload), scipy.optimize. Never on the rooms that make maps: every function here
takes an object with `field`, `gradient`, `second_gradient`, `coil_names`, `lower` and `upper`
(`LevitationField`).
"""

from fieldmap.levitation.branches import EquilibriumBranch, equilibrium_at, follow_equilibrium
from fieldmap.levitation.calibration import Calibration, LiftReadings, PositionReadings, Reading, calibrate
from fieldmap.levitation.continuation import Fold, FollowedBranch, follow_branch
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
from fieldmap.levitation.magnet_models import MODELS, MagnetModel, magnet_balance, model_assumptions
from fieldmap.levitation.result import Equilibrium, SearchReport
from fieldmap.levitation.sensitivity import Sensitivity, equilibrium_sensitivity
from fieldmap.levitation.signal_surface import EquilibriumSurface, equilibrium_surface
from fieldmap.levitation.stationary import StationaryPoint, StationarySet, stationary_points

__all__ = [
    "GRAVITY",
    "MODELS",
    "SENSOR_ZERO_DEPTH",
    "Calibration",
    "DifferencedField",
    "Equilibrium",
    "EquilibriumBranch",
    "EquilibriumSurface",
    "Exponential",
    "Fit",
    "FixedCurrents",
    "Fold",
    "FollowedBranch",
    "HorizontalForce",
    "LevitationField",
    "LiftCurrent",
    "LiftReadings",
    "MagnetModel",
    "PositionReadings",
    "QuadraticForce",
    "Reading",
    "SearchReport",
    "Sensitivity",
    "StationaryPoint",
    "StationarySet",
    "VerticalForce",
    "calibrate",
    "dipole_force",
    "dipole_stiffness",
    "equilibrium_at",
    "equilibrium_sensitivity",
    "equilibrium_surface",
    "find_equilibrium",
    "fit_horizontal_force",
    "fit_quadratic_force",
    "fit_vertical_force",
    "follow_branch",
    "follow_equilibrium",
    "lift_current",
    "lift_current_nonlinear",
    "magnet_balance",
    "magnet_height",
    "model_assumptions",
    "sensor_reading",
    "stationary_points",
    "thesis_lift_current",
]
