"""Maps for other programs, and maps from them: C, MuJoCo, mag_manip, measurements.

Depends on: errors, store, lookup. Never on the rooms that make maps.
"""

from fieldmap.adapters.c_map import c_header, write_c_map
from fieldmap.adapters.csv_map import write_csv
from fieldmap.adapters.mag_manip import read_mag_manip, write_mag_manip
from fieldmap.adapters.measured_map import FitReport, MeasuredMap, fit_map
from fieldmap.adapters.measurements import Measurements, read_measurements
from fieldmap.adapters.mujoco_magnets import MagnetForces
from fieldmap.adapters.whole_files import write_whole

__all__ = [
    "FitReport",
    "MagnetForces",
    "MeasuredMap",
    "Measurements",
    "c_header",
    "fit_map",
    "read_mag_manip",
    "read_measurements",
    "write_c_map",
    "write_csv",
    "write_mag_manip",
    "write_whole",
]
