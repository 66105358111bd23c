"""Opened maps: field, gradient and wrench at any point, for any currents."""

from fieldmap.interpolants import Jump
from fieldmap.lookup.actuation import (
    Actuation,
    capability,
    field_actuation,
    gradient_actuation,
    wrench_actuation,
)
from fieldmap.lookup.current_table import CurrentTable
from fieldmap.lookup.evaluation import Evaluator, MapAtCurrents
from fieldmap.lookup.field_map import FieldMap, interpolate, open_map
from fieldmap.lookup.field_sensors import MapSensors
from fieldmap.lookup.finite_magnet import FiniteMagnet, finite_magnet, volume_rule
from fieldmap.lookup.flux_linkage import back_emf, payload_linkage
from fieldmap.lookup.inverse import currents_for
from fieldmap.lookup.iron_response import (
    compiled_currents,
    core_map,
    iron_weights,
    saturates,
    table_of_currents,
    tangent_block,
    unit_block,
)
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.lookup.payload import compiled_linkages, compiled_wrench, magnetic_body
from fieldmap.lookup.several_bodies import SeveralForces, currents_for_several
from fieldmap.lookup.soft_body import (
    SoftPiece,
    demagnetising_factors,
    soft_rule,
    soft_sphere_force,
)

__all__ = [
    "Actuation",
    "CurrentTable",
    "Evaluator",
    "FieldMap",
    "FiniteMagnet",
    "Jump",
    "MagneticBody",
    "MapAtCurrents",
    "MapSensors",
    "SeveralForces",
    "SoftPiece",
    "back_emf",
    "capability",
    "compiled_currents",
    "compiled_linkages",
    "compiled_wrench",
    "core_map",
    "currents_for",
    "currents_for_several",
    "demagnetising_factors",
    "field_actuation",
    "finite_magnet",
    "gradient_actuation",
    "interpolate",
    "iron_weights",
    "magnetic_body",
    "open_map",
    "payload_linkage",
    "saturates",
    "soft_rule",
    "soft_sphere_force",
    "table_of_currents",
    "tangent_block",
    "unit_block",
    "volume_rule",
    "wrench_actuation",
]
