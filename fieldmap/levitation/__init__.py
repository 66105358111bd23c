"""Force balance, stiffness and lift current of a levitated magnet in any field.

Every function here takes a `fieldmap.field.Field` with a box, an object that `as_field` converts, or a state at its
currents. The package depends on device (payload) and lookup (magnets of finite size), never on the packages that make
maps.
"""

from fieldmap.extras import needs

# All modules need scipy. If it is missing, the error is raised here.
with needs("levitation", "fieldmap.levitation"):
    import scipy

    del scipy

from fieldmap.constants import GRAVITY
from fieldmap.levitation.balance import (
    MODELS,
    MagnetModel,
    dipole_force,
    dipole_stiffness,
    magnet_balance,
    model_assumptions,
)
from fieldmap.levitation.branches import (
    EquilibriumBranch,
    Sensitivity,
    equilibrium_at,
    equilibrium_sensitivity,
    follow_equilibrium,
)
from fieldmap.levitation.calibration import Calibration, LiftReadings, PositionReadings, Reading, calibrate
from fieldmap.levitation.comparison import (
    ForceFit,
    LiftAtHeight,
    ShiftBesideMeasured,
    fit_force,
    lift_by_height,
    shifts_beside_measured,
)
from fieldmap.levitation.continuation import Fold, FollowedBranch, follow_branch
from fieldmap.levitation.equilibrium import Equilibrium, SearchReport, find_equilibrium
from fieldmap.levitation.lift import LiftCurrent, force_per_ampere, lift_current, lift_shares, push_shares
from fieldmap.levitation.reachable_set import ReachableSet, SearchedSet, reachable, zonotope
from fieldmap.levitation.signal_surface import EquilibriumSurface, equilibrium_surface
from fieldmap.levitation.stationary import StationaryPoint, StationarySet, stationary_points

__all__ = [
    "GRAVITY",
    "MODELS",
    "Calibration",
    "Equilibrium",
    "EquilibriumBranch",
    "EquilibriumSurface",
    "Fold",
    "FollowedBranch",
    "ForceFit",
    "LiftAtHeight",
    "LiftCurrent",
    "LiftReadings",
    "MagnetModel",
    "PositionReadings",
    "ReachableSet",
    "Reading",
    "SearchReport",
    "SearchedSet",
    "Sensitivity",
    "ShiftBesideMeasured",
    "StationaryPoint",
    "StationarySet",
    "calibrate",
    "dipole_force",
    "dipole_stiffness",
    "equilibrium_at",
    "equilibrium_sensitivity",
    "equilibrium_surface",
    "find_equilibrium",
    "fit_force",
    "follow_branch",
    "follow_equilibrium",
    "force_per_ampere",
    "lift_by_height",
    "lift_current",
    "lift_shares",
    "magnet_balance",
    "model_assumptions",
    "push_shares",
    "reachable",
    "shifts_beside_measured",
    "stationary_points",
    "zonotope",
]
