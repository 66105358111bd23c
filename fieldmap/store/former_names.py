"""The archive of states that `fieldmap.store.Checkpoint` has replaced. It warns, and goes with the next release."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.deprecated import warn_renamed
from fieldmap.records import Record
from fieldmap.store.checkpoint import Checkpoint
from fieldmap.typing import Array, PathLike

_RESULT = "result"


@dataclass(frozen=True, eq=False, repr=False)
class KeptState(Record):
    """currents (c,); values (n,), or the reason why there are none; seconds of the clock and of the processors that
    it took; estimate: how much the state was needed, NaN where nobody asked."""

    currents: Array
    values: Array | str
    seconds: float = 0.0
    processor_seconds: float = 0.0
    estimate: float = float("nan")


class StateArchive:
    """States by number, under one fingerprint, as pieces of a checkpoint.

    A file with another fingerprint, a damaged one, and one of an earlier version are begun anew.
    """

    def __init__(self, path: PathLike, fingerprint: str) -> None:
        warn_renamed("fieldmap.store.StateArchive", "fieldmap.store.Checkpoint", level=2)
        self.path = Path(path)
        self._checkpoint = Checkpoint(path, fingerprint)

    def __enter__(self) -> StateArchive:
        return self

    def __exit__(self, *_: object) -> None:
        self._checkpoint.close()

    def remove(self) -> None:
        """Close and delete the file."""
        self._checkpoint.remove()

    def kept(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
        """What `keep` was given, or None."""
        piece = self._checkpoint.get(_RESULT)
        return None if piece is None else (piece.arrays, piece.about)

    def keep(self, arrays: Mapping[str, NDArray[Any]], about: Mapping[str, Any]) -> None:
        """Add what was made of the states. Raises FieldmapError if the disk is full."""
        self._checkpoint.put(_RESULT, arrays, about)

    def get(self, number: int, currents: Array | None = None) -> KeptState | None:
        """The state of this number, or None if it was never tried, or with other currents than these (c,)."""
        piece = self._checkpoint.get(f"{number:05d}")
        if piece is None or not (currents is None or np.array_equal(piece.arrays["currents"], currents)):
            return None
        values = piece.about["failed"] if "failed" in piece.about else piece.arrays["values"]
        return KeptState(piece.arrays["currents"], values, *piece.arrays["costs"].tolist())

    def put(self, number: int, state: KeptState) -> None:
        """Add a state, or the reason why it could not be solved. Raises FieldmapError if the disk is full."""
        costs = np.array([state.seconds, state.processor_seconds, state.estimate])
        arrays = {"currents": np.asarray(state.currents, float), "costs": costs}
        if isinstance(state.values, str):
            self._checkpoint.put(f"{number:05d}", arrays, {"failed": state.values})
        else:
            self._checkpoint.put(f"{number:05d}", arrays | {"values": np.asarray(state.values)})
