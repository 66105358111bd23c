"""The two-dimensional model: iron, conductors and walls that extend to infinity across the plane."""

from fieldmap.planar.linear import solve_planar
from fieldmap.planar.model import PlanarBody, PlanarCoil, PlanarDevice, RectangularWire, RoundWire
from fieldmap.planar.nonlinear import solve_planar_state
from fieldmap.planar.reader import read_planar_device
from fieldmap.planar.solution import PlanarReport, PlanarSolution
from fieldmap.planar.state import PlanarState
from fieldmap.planar.stationary import StationaryPoint, stationary_points

__all__ = [
    "PlanarBody",
    "PlanarCoil",
    "PlanarDevice",
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
