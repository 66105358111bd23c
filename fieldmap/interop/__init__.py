"""Maps for other programs, and maps from them: C, FMI, JAX, MuJoCo, mag_manip, measurements.

Depends on: errors, extras, store, lookup, dynamics. Never on the packages that make maps.
"""

from fieldmap.interop.c_map import (
    c_header,
    c_iron_header,
    write_c32_files,
    write_c_files,
    write_c_iron_files,
    write_c_iron_map,
    write_c_map,
)
from fieldmap.interop.c_sensors import write_c_controller, write_c_curve, write_c_sensors
from fieldmap.interop.csv_map import write_csv
from fieldmap.interop.fmu import write_fmu
from fieldmap.interop.jax_field import JaxEvaluator, JaxField, jax_field
from fieldmap.interop.mag_manip import VectorFields, read_mag_manip, sample_for_mag_manip, write_mag_manip
from fieldmap.interop.measured_map import FitReport, MeasuredMap, fit_map
from fieldmap.interop.mujoco_magnets import MagnetForces
from fieldmap.interop.readings import Measurements, read_measurements

__all__ = [
    "FitReport",
    "JaxEvaluator",
    "JaxField",
    "MagnetForces",
    "MeasuredMap",
    "Measurements",
    "VectorFields",
    "c_header",
    "c_iron_header",
    "fit_map",
    "jax_field",
    "read_mag_manip",
    "read_measurements",
    "sample_for_mag_manip",
    "write_c32_files",
    "write_c_controller",
    "write_c_curve",
    "write_c_files",
    "write_c_iron_files",
    "write_c_iron_map",
    "write_c_map",
    "write_c_sensors",
    "write_csv",
    "write_fmu",
    "write_mag_manip",
]
