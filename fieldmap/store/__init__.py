"""The map as data, and the one door to its file.

Depends on: errors, h5py, numpy.
"""

from fieldmap.store.grid import Grid
from fieldmap.store.map_data import FieldError, MapData, MapInfo, Provenance
from fieldmap.store.partial import Chunk, partial_path
from fieldmap.store.reader import read_info, read_map
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.store.run_file import RunRecord, is_run_file, read_runs, write_runs
from fieldmap.store.seal import seal_map
from fieldmap.store.states import KeptState, StateArchive
from fieldmap.store.verification import MapCheck, check_map
from fieldmap.store.writer import MapWriter, open_writer, write_map

__all__ = [
    "Chunk",
    "FieldError",
    "Grid",
    "KeptState",
    "MapCheck",
    "MapData",
    "MapInfo",
    "MapWriter",
    "Provenance",
    "ReducedModel",
    "RunRecord",
    "StateArchive",
    "check_map",
    "is_run_file",
    "open_writer",
    "partial_path",
    "read_info",
    "read_map",
    "read_runs",
    "seal_map",
    "write_map",
    "write_runs",
]
