"""Recorded runs of a simulation as HDF5: one group for each run, with arrays, their units, and the end of the run."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import InputError
from fieldmap.records import Record
from fieldmap.store.map_format import UNREADABLE
from fieldmap.store.map_reader import Refused, hard, stored
from fieldmap.store.seal import check_seal, is_sealed, seal_map
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import Array

FORMAT = "fieldmap run 1"


@dataclass(frozen=True, eq=False, repr=False)
class RunRecord(Record):
    """A recorded run.

    Attributes
    ----------
    arrays : by name: the array, its unit, and the names of its columns.
    about : texts and numbers about the run.
    """

    arrays: Mapping[str, tuple[Array, str, str]]
    about: Mapping[str, Any]


def write_runs(path: str | os.PathLike[str], runs: Iterable[RunRecord], about: Mapping[str, str]) -> Path:
    """Write runs into one file, which appears complete or not at all. It is sealed like a map.

    The data sets are /run_0000/time, /run_0000/position and so on, with attributes `unit` and `columns`. The group
    /run_0000 has the attribute `about`, JSON.

    Parameters
    ----------
    path
        Path of the file.
    runs
        The runs.
    about
        Texts about all of them.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    target = Path(path)
    with whole_file(target, "recorded runs") as partial:
        with h5py.File(partial, "w") as file:
            file.attrs["format"] = FORMAT
            for name, text in about.items():
                file.attrs[name] = text
            for number, run in enumerate(runs):
                _write(file.create_group(f"run_{number:04d}"), run)
        seal_map(partial)
    return target


def _write(group: h5py.Group, run: RunRecord) -> None:
    group.attrs["about"] = json.dumps(run.about, allow_nan=False)
    for name, (values, unit, columns) in run.arrays.items():
        data = group.create_dataset(name, data=values, fletcher32=bool(np.size(values)))
        data.attrs["unit"], data.attrs["columns"] = unit, columns


def is_run_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file states that it holds recorded runs.

    Parameters
    ----------
    path
        Path of the file.

    Returns
    -------
    bool
        True for a file of runs.
    """
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("format", "")) == FORMAT
    except UNREADABLE:
        return False


def read_runs(path: str | os.PathLike[str]) -> tuple[list[RunRecord], dict[str, str]]:
    """Read the runs of a file, and the texts about all of them.

    Links are not followed, and no more memory is allocated than the file fills. Files of versions before 0.2 have no
    seal.

    Parameters
    ----------
    path
        Path of the file.

    Raises
    ------
    InputError
        For a file that does not hold runs, or differs from its seal.
    """
    source = Path(path)
    must, remedy = "must be a file of runs, written by `fieldmap simulate -o`", "simulate again"
    try:
        if is_sealed(source):
            check_seal(source, remedy)
        with h5py.File(source, "r") as file:
            about = {name: str(value) for name, value in file.attrs.items()}
            if about.pop("format", "") != FORMAT:
                raise Refused(must, "another HDF5 file", remedy)
            return [_run(file, name) for name in sorted(file)], about
    except Refused as refusal:
        must_hold, received, _ = refusal.args
        raise InputError.of(str(source), must_hold, received, remedy) from None
    except InputError:
        raise
    except (*UNREADABLE, MemoryError) as error:
        received = str(error).splitlines()[0] if str(error) else "no file of runs"
        raise InputError.of(str(source), must, received, remedy) from None


def _run(file: h5py.File, name: str) -> RunRecord:
    """Read one run. Raises Refused if part of it lies in another file."""
    group = hard(file, name)
    if not isinstance(group, h5py.Group):
        raise Refused(f"{name}: a run", "numbers", "")
    arrays = {}
    for key in group:
        data = stored(file, f"{name}/{key}", "fiu")
        arrays[key] = (np.asarray(data[()], float), str(data.attrs["unit"]), str(data.attrs["columns"]))
    about = json.loads(str(group.attrs["about"]))
    if not isinstance(about, dict):
        raise Refused(f"{name}, about: names and values", type(about).__name__, "")
    return RunRecord(arrays, about)
