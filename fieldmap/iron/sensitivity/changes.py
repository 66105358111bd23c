"""Parameters by key path, and the parts of a device that depend on them.

A key is set a little above and a little below its value, and the two devices are compared part by part. Places,
turns and remanences depend on their keys so smoothly that their differences are derivatives to ten digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.device.changes import key_finding, with_changes
from fieldmap.device.model import Device
from fieldmap.device.reader import TEXT, device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, InputError
from fieldmap.inputs.document import Document, parsed
from fieldmap.inputs.key_paths import matches, value_at
from fieldmap.records import Record
from fieldmap.typing import Array

# Step, relative to the value; smallest steps by the unit in a key; smallest step without a unit.
_STEP = 1e-4
_LEAST = {"mm": 1e-3, "deg": 1e-2}
_LEAST_OF_ANY = 1e-6
_CURRENT, _PARAMETER = "current.", "parameters."
# Parts of a device that may depend on a parameter.
_WHOLE = ("coils", "bodies", "materials", "background", "joints", "payload", "driver", "workspace")


@dataclass(frozen=True, eq=False, repr=False)
class RigidMotion(Record):
    """Velocity (3,) of an origin and angular velocity (3, 3), antisymmetric, per unit of a key."""

    velocity: Array
    spin: Array


@dataclass(frozen=True, eq=False, repr=False)
class Change(Record):
    """The effect of a key: currents (c,) of the coils per unit of the key, and the devices with the key above and below
    its value, `width` apart; one and the same device if the key is a current."""

    key: str
    currents: Array
    above: Device
    below: Device
    width: float = 1.0

    def slope(self, of: Callable[[Any], Any]) -> Any:
        """Derivative of a function of the device by the key, from the difference of both sides."""
        return (of(self.above) - of(self.below)) / self.width

    def has(self, *names: str) -> bool:
        """Whether one of these parts of the device depends on the key."""
        return not all(same(getattr(self.above, name), getattr(self.below, name)) for name in names)

    @cached_property
    def coils(self) -> tuple[int, ...]:
        """Numbers of the coils that depend on the key."""
        pairs = zip(self.above.coils, self.below.coils, strict=True)
        return tuple(k for k, (one, other) in enumerate(pairs) if not same(one, other))

    @property
    def has_shapes(self) -> bool:
        """Whether places or shapes of bodies depend on the key; sizes of elements do not count."""
        above, below = ([body.parts for body in side.bodies] for side in (self.above, self.below))
        return not same(above, below)

    def motion(self, k: int) -> RigidMotion | None:
        """The rigid motion of coil k; None if the coil changes in another way."""
        one, other = self.above.coils[k], self.below.coils[k]
        if not same(replace(one, placement=other.placement), other):  # zuban: ignore[misc]
            return None
        position, rotation = (
            self.slope(lambda side, name=name: getattr(side.coils[k].placement, name))
            for name in ("position", "rotation")
        )
        middle = 0.5 * (one.placement.rotation + other.placement.rotation)
        spin = rotation @ middle.T
        return RigidMotion(position, 0.5 * (spin - spin.T))

    def turns(self, k: int) -> float | None:
        """Derivative of the turns of coil k over the turns; None if anything else of the coil depends on the key."""
        one, other = self.above.coils[k], self.below.coils[k]
        if not same(replace(one, turns=other.turns), other):  # zuban: ignore[misc]
            return None
        return self.slope(lambda side: side.coils[k].turns) / (0.5 * (one.turns + other.turns))


class Parameters:
    """The parameters of a device: its keys, and "current.NAME" for the current of a coil."""

    def __init__(self, device: Device) -> None:
        self.device = device

    @cached_property
    def _document(self) -> Document:
        path = self.device.source or Path(TEXT)
        return DEVICE.prepared(parsed(path, self.device.text or self.device.to_toml(), DeviceFileError))

    def value(self, key: str) -> float:
        """The number that a key has, in its unit; raises as `change`."""
        finding = key_finding((key,), key, self._document)
        if finding is not None:
            raise DeviceFileError(*Document(self._document.path, "", {}).problems([finding]))
        values = [value_at(self._document.data, place) for place in matches(self._document.data, key)]
        numbers = [
            value for value in values if isinstance(value, int | float) and not isinstance(value, bool)
        ]
        if len(numbers) < len(values) or len(set(numbers)) > 1:
            must_hold, remedy = "must name one number, or several that are equal", "name one of them"
            raise InputError.of(f"derivative, {key}", must_hold, f"{values}"[:80], remedy)
        return float(numbers[0])

    def change(self, key: str, step: float | None = None) -> Change:
        """The effect of a key. Raises DeviceFileError for a key that the device lacks, InputError for one that is no
        number or cannot be changed to both sides, and for a parameter on which nothing depends."""
        names = self.device.coil_names
        if key.startswith(_CURRENT):
            name = key.removeprefix(_CURRENT)
            if name not in names and name != "*":
                must_hold = f"must be the name of a coil, {', '.join(names)}, or *"
                raise InputError.of(f"derivative, {key}", must_hold, repr(name), "use one of these")
            return Change(
                key, np.array([float(name in (one, "*")) for one in names]), self.device, self.device
            )
        value = self.value(key)
        units = [step.rpartition("_")[2] for step in key.split(".")]
        least = next((least for unit, least in _LEAST.items() if unit in units), _LEAST_OF_ANY)
        width = step or max(_STEP * abs(value), least)
        try:
            above, below = (self._with(key, value + side * width) for side in (1, -1))
        except DeviceFileError as error:
            raise InputError(*error.problems) from error
        change = Change(key, np.zeros(len(names)), above, below, 2 * width)
        if key.startswith(_PARAMETER) and not change.has(*_WHOLE):
            # The text of a device that includes files, or had keys changed, has numbers in place of expressions.
            must_hold = (
                "must be a parameter that something follows; of a file that includes others nothing does"
            )
            remedy = "name the keys that follow it"
            raise InputError.of(f"derivative, {key}", must_hold, "nothing follows it", remedy)
        return change

    def _with(self, key: str, value: float) -> Device:
        """The device with a key changed; derived classes may change other parts with the key."""
        return device_of(with_changes(self._document, {key: value}), written=False)


def same(one: Any, other: Any) -> bool:
    """Whether two parts of devices are equal, number by number."""
    if one is other or type(one) is not type(other):
        return one is other
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other))
    if is_dataclass(one):
        return all(same(getattr(one, item.name), getattr(other, item.name)) for item in fields(one))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return bool(one == other)
