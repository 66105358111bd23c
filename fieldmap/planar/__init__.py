"""The two-dimensional model: iron, conductors and walls that extend to infinity across the plane."""

from fieldmap.extras import needs

# As in fieldmap.iron: without scipy, this import raises one error for all modules.
with needs("make", "fieldmap.planar"):
    import scipy

    del scipy

from fieldmap.planar.device_file import read_planar_device
from fieldmap.planar.linear import solve_planar
from fieldmap.planar.model import PlanarBody, PlanarCoil, PlanarDevice, RectangularWire, RoundWire
from fieldmap.planar.saturating import PlanarState, solve_planar_state
from fieldmap.planar.solution import PlanarFieldAtCurrents, PlanarReport, PlanarSolution
from fieldmap.planar.stationary import StationaryPoint, stationary_points

__all__ = [
    "PlanarBody",
    "PlanarCoil",
    "PlanarDevice",
    "PlanarFieldAtCurrents",
    "PlanarReport",
    "PlanarSolution",
    "PlanarState",
    "RectangularWire",
    "RoundWire",
    "StationaryPoint",
    "read_planar_device",
    "solve_planar",
    "solve_planar_state",
    "stationary_points",
]
