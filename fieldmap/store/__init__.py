"""Files of maps and runs, and checkpoints of long work (`fieldmap.store.checkpoint`).

A map is written by `map_writer`, read by `map_reader` and verified by `map_check`.
"""

from fieldmap.store.checkpoint import Checkpoint, Piece, checkpoint_path
from fieldmap.store.large_map import LargeMapWriter
from fieldmap.store.map_check import MapCheck, check_map
from fieldmap.store.map_data import (
    FieldError,
    Grid,
    LargeMap,
    MapData,
    MapInfo,
    Provenance,
    StoredFields,
    StoredLinkage,
    StoredReaction,
    StoredSensors,
)
from fieldmap.store.map_format import Chunk
from fieldmap.store.map_reader import map_path, read_for_lookup, read_info, read_map
from fieldmap.store.map_writer import MapWriter, open_writer, write_map
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.store.run_file import RunRecord, is_run_file, read_runs, write_runs
from fieldmap.store.seal import seal_map
from fieldmap.store.stated_accuracy import MissedAccuracy, missed_accuracy, warn_of_missed_accuracy
from fieldmap.store.whole_files import whole_file, write_whole

__all__ = [
    "Checkpoint",
    "Chunk",
    "FieldError",
    "Grid",
    "LargeMap",
    "LargeMapWriter",
    "MapCheck",
    "MapData",
    "MapInfo",
    "MapWriter",
    "MissedAccuracy",
    "Piece",
    "Provenance",
    "ReducedModel",
    "RunRecord",
    "StoredFields",
    "StoredLinkage",
    "StoredReaction",
    "StoredSensors",
    "check_map",
    "checkpoint_path",
    "is_run_file",
    "map_path",
    "missed_accuracy",
    "open_writer",
    "read_for_lookup",
    "read_info",
    "read_map",
    "read_runs",
    "seal_map",
    "warn_of_missed_accuracy",
    "whole_file",
    "write_map",
    "write_runs",
    "write_whole",
]
