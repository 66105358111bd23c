"""A file that keeps solved states while a model is trained, one after the other; it survives a kill at any moment."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.store.partial import UNREADABLE, disk_errors, to_disk
from fieldmap.store.record import to_json
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class KeptState:
    """currents (c,); values (n,), or the reason why there are none; seconds of the clock and of the processors that
    it took; estimate: of how much the state was needed, NaN where nobody asked."""

    currents: Array
    values: Array | str
    seconds: float = 0.0
    processor_seconds: float = 0.0
    estimate: float = float("nan")


class StateArchive:
    """States (currents (c,), values (n,) or a reason why there are none), numbered, under one fingerprint.

    A file with another fingerprint, or a damaged one, is begun anew.
    """

    def __init__(self, path: str | os.PathLike[str], fingerprint: str) -> None:
        self.path = Path(path)
        self._file = self._reopen(fingerprint) or self._begin(fingerprint)

    def __enter__(self) -> "StateArchive":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def remove(self) -> None:
        """Close and delete the file: what it was kept for is done."""
        self._file.close()
        self.path.unlink(missing_ok=True)

    def kept(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """What `keep` kept, or None."""
        try:
            group = self._file["result"]
            if group.attrs["complete"] != 1:
                return None
            arrays = {name: np.ascontiguousarray(group["arrays"][name][()]) for name in group["arrays"]}
            return arrays, json.loads(bytes(group["about"][()]).decode())
        except UNREADABLE:
            return None

    def keep(self, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> None:
        """Keep what was made of the states, so that resuming need not make it again."""
        with disk_errors(self.path):
            if "result" in self._file:
                del self._file["result"]
            group = self._file.create_group("result")
            for name, values in arrays.items():
                data = np.asarray(values)
                checked = bool(data.ndim and data.size) or None
                group.create_dataset(f"arrays/{name}", data=data, fletcher32=checked)
            group["about"] = np.bytes_(to_json(about).encode())
            to_disk(self._file)
            group.attrs["complete"] = np.uint8(1)
            to_disk(self._file)

    def get(self, number: int, currents: Array | None = None) -> KeptState | None:
        """The state of this number, or None if it was never tried, or with other currents than these (c,)."""
        try:
            group = self._file[f"{number:05d}"]
            if group.attrs["complete"] != 1:
                return None
            kept = group["currents"][()]
            if currents is not None and not np.array_equal(kept, currents):
                return None
            values = str(group.attrs["failed"]) if "failed" in group.attrs else group["values"][()]
            return KeptState(kept, values, *map(float, group.attrs["costs"]))
        except UNREADABLE:
            return None

    def put(self, number: int, state: KeptState) -> None:
        """Keep a state, or the reason why it could not be solved. Raises FieldmapError if the disk is full."""
        name = f"{number:05d}"
        with disk_errors(self.path):
            if name in self._file:
                del self._file[name]
            group = self._file.create_group(name)
            group.create_dataset("currents", data=state.currents, fletcher32=True)
            group.attrs["costs"] = (state.seconds, state.processor_seconds, state.estimate)
            if isinstance(state.values, str):
                group.attrs["failed"] = state.values
            else:
                group.create_dataset("values", data=state.values, fletcher32=True)
            to_disk(self._file)
            group.attrs["complete"] = np.uint8(1)
            to_disk(self._file)

    def _reopen(self, fingerprint: str) -> h5py.File | None:
        if not self.path.is_file():
            return None
        try:
            file = h5py.File(self.path, "r+")
        except UNREADABLE:
            return None
        if file.attrs.get("fingerprint") == fingerprint:
            return file
        file.close()
        return None

    def _begin(self, fingerprint: str) -> h5py.File:
        with disk_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = h5py.File(self.path, "w")
            file.attrs["fingerprint"] = fingerprint
            to_disk(file)
        return file
