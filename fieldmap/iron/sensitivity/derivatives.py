"""Derivatives of a quantity by keys of a device, and what follows from them to first order."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Spread(Record):
    """Standard deviation of a quantity, of its shape, and the share of each key in its square, from 0 to 1."""

    deviation: Array
    shares: Mapping[str, Array]


@dataclass(frozen=True, eq=False, repr=False)
class Derivatives(Record):
    """Derivatives of a quantity. value: its numbers, of any shape; by: key path -> derivative of that shape, per unit
    of the key; solves: linear solves that they took."""

    value: Array
    by: Mapping[str, Array]
    solves: int

    def __getitem__(self, key: str) -> Array:
        """The derivative by one key."""
        return self.by[key]

    def change(self, steps: Mapping[str, float]) -> Array:
        """What the quantity changes by, to first order, for changes of keys in their units."""
        return np.asarray(sum(self.by[key] * step for key, step in steps.items()))

    def spread(self, deviations: Mapping[str, float]) -> Spread:
        """How far the quantity is uncertain, to first order, where keys are: standard deviations of independent numbers
        by key, in their units. Raises KeyError for a key without a derivative.

        >>> found = Derivatives(np.array(5.0), {"a": np.array(3.0), "b": np.array(-2.0)}, 1)
        >>> spread = found.spread({"a": 1.0, "b": 2.0})
        >>> float(spread.deviation), {key: round(float(share), 2) for key, share in spread.shares.items()}
        (5.0, {'a': 0.36, 'b': 0.64})
        """
        parts = {key: (self.by[key] * deviation) ** 2 for key, deviation in deviations.items()}
        variance = np.asarray(sum(parts.values(), start=np.zeros(np.shape(self.value))))
        safe = np.where(variance > 0, variance, 1.0)
        return Spread(np.sqrt(variance), {key: part / safe for key, part in parts.items()})
