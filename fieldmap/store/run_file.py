"""Recorded runs of a simulation as HDF5: one group a run, arrays with units, and how each run ended."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import Array

FORMAT = "fieldmap run 1"


@dataclass(frozen=True, eq=False, repr=False)
class RunRecord(Record):
    """arrays: by name, each with its unit and what its columns are; about: texts and numbers about the run."""

    arrays: Mapping[str, tuple[Array, str, str]]
    about: Mapping[str, Any]


def write_runs(path: str | os.PathLike[str], runs: Iterable[RunRecord], about: Mapping[str, str]) -> Path:
    """Write runs into one file; it appears complete or not at all. about: texts about all of them.

    /run_0000/time, /run_0000/position, ...: datasets with attributes `unit` and `columns`; /run_0000 has the attribute
    `about`, JSON. Raises InputError where the place cannot be written.
    """
    target = Path(path)
    with whole_file(target) as partial, h5py.File(partial, "w") as file:
        file.attrs["format"] = FORMAT
        for name, text in about.items():
            file.attrs[name] = text
        for number, run in enumerate(runs):
            group = file.create_group(f"run_{number:04d}")
            group.attrs["about"] = json.dumps(run.about, allow_nan=False)
            for name, (values, unit, columns) in run.arrays.items():
                data = group.create_dataset(name, data=values, fletcher32=np.size(values) > 0)
                data.attrs["unit"], data.attrs["columns"] = unit, columns
    return target


def is_run_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file says of itself that it holds runs."""
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("format", "")) == FORMAT
    except OSError:
        return False


def read_runs(path: str | os.PathLike[str]) -> tuple[list[RunRecord], dict[str, str]]:
    """The runs of a file, and the texts about all of them. Raises InputError for a file that is none."""
    source = Path(path)
    must = "must be a file of runs, written by `fieldmap simulate -o`"
    try:
        with h5py.File(source, "r") as file:
            about = {name: str(value) for name, value in file.attrs.items()}
            if about.pop("format", "") != FORMAT:
                raise InputError(Problem(str(source), must, "another HDF5 file", "simulate again"))
            return [_run(file[name]) for name in sorted(file)], about
    except (OSError, KeyError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(Problem(str(source), must, str(error), "simulate again")) from None


def _run(group: Any) -> RunRecord:
    arrays = {
        name: (np.asarray(data[()], float), str(data.attrs["unit"]), str(data.attrs["columns"]))
        for name, data in group.items()
    }
    return RunRecord(arrays, json.loads(group.attrs["about"]))
