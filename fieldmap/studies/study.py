"""A study as data: variants of a device, sets of currents, and what is recorded of each."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap import records
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.inputs.document import Document
from fieldmap.provenance import fingerprint
from fieldmap.studies.quantities import NEED_PAYLOAD
from fieldmap.typing import Array

# Packages and modules whose code takes part in a study.
CODE = ("kernels", "inputs", "device", "field", "currents", "sources", "iron", "levitation", "studies")
Value = float | int | str

_UNIT = re.compile(r"_(mm|deg|T_per_m|T|A_per_V|A_m2|A|V|ohm|mH|N_s_per_m|g_mm2|g)$")


@dataclass(frozen=True, repr=False)
class Axis(records.Record):
    """One varied key: name in the data set, key path, values in the key's unit."""

    name: str
    key: str
    values: tuple[Value, ...]

    @property
    def unit(self) -> str:
        """The unit that is the last part of the key; "" for a text, "1" for a number without one.

        >>> Axis("z", "body.disk.position_mm.3", (0.0,)).unit
        'mm'
        """
        if isinstance(self.values[0], str):
            return ""
        words = [step for step in self.key.split(".") if not step.isdigit()]
        found = _UNIT.search(words[-1]) if words else None
        return found[1].replace("_per_", "/").replace("_", " ") if found else "1"


@dataclass(frozen=True, repr=False)
class Variant(records.Record):
    """One device of the study: its device file with changed keys. place: index along each axis, or its number."""

    name: str
    place: tuple[int, ...]
    settings: tuple[tuple[str, Value], ...]
    document: Document


@dataclass(frozen=True, eq=False, repr=False)
class CurrentSet(records.Record):
    """Currents shares * c (n_coils,), whose magnitudes have the mean c. common: c in A, or None where it is looked for
    so that they carry the payload at carried_at (3,), m."""

    name: str
    shares: Array
    common: float | None
    carried_at: Array | None


@dataclass(frozen=True)
class IronModel(records.Record):
    """How the iron is modelled: mu_r None for the initial slope of its law; accuracy None for one mesh as it is."""

    saturating: bool
    mu_r: float | None = None
    tolerance: float = 1e-3
    refinement: float = 1.0
    accuracy: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Record(records.Record):
    """What is recorded: groups of quantities, points (n, 3) in m, share of the weight, largest current in A, corners
    of the box whose field is to be homogeneous, m."""

    groups: tuple[str, ...]
    points: Array
    force_share: float
    current_limit: float | None
    box: tuple[Array, Array] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Study(records.Record):
    """What to solve, in SI; path and text: the file as read. axes: varied keys; none with variants one by one.

    device_document: the device file as it is. coil_names: in current order; body_names: in that of the file.
    """

    path: Path
    text: str
    title: str
    axes: tuple[Axis, ...]
    variants: tuple[Variant, ...]
    current_sets: tuple[CurrentSet, ...]
    iron: IronModel
    record: Record
    device_document: Document
    coil_names: tuple[str, ...]
    body_names: tuple[str, ...]

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        """Labels of the entries along each axis that a quantity may have; points count from 1."""
        return axis_labels(self.record, self.coil_names, self.body_names)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of variants along each axis."""
        return tuple(len(axis.values) for axis in self.axes) or (len(self.variants),)

    def settings(self, number: int) -> dict[str, Value]:
        """Of a variant, the varied keys in their units by the names of their axes; or its name."""
        variant = self.variants[number]
        values = {axis.name: axis.values[k] for axis, k in zip(self.axes, variant.place, strict=False)}
        return values or {"variant": variant.name}

    @property
    def fingerprint(self) -> str:
        """Of everything that decides the numbers; equal ones mean equal data on one machine."""
        device = device_of(self.device_document)
        return fingerprint((self.text, repr(self.iron), *device.texts), CODE)


def current_set(name: str, amperes: Any, coils: int, place: Array | None) -> CurrentSet:
    """A set of currents of amperes, one for all coils or (coils,); with a place (3,), m, they are looked for so that
    they carry the payload there, in these proportions."""
    currents = np.array(np.broadcast_to(np.asarray(amperes, dtype=float), coils))
    common = float(np.abs(currents).mean())
    return CurrentSet(name, currents / common, common if place is None else None, place)


def lacking(device: Device, record: Record, saturating: bool) -> list[tuple[frozenset[str], str, str, str]]:
    """What the device and the record do not have, or the iron does not allow: groups that need it, what they need, what
    is there, and the remedy."""
    payload, box = device.payload is not None, device.workspace is not None
    both, limit = "needs the device's [payload] and [workspace]", "needs the limit of the currents"
    reach, points, corners = {"reach", "reachable_share"}, {"field", "force_per_ampere"}, {"homogeneity"}
    linear, iron = "superposes coils: linear iron only", {"iron", "error"}
    needs: list[tuple[bool, Set[str], str, str, str]] = [
        (payload and box, NEED_PAYLOAD, both, "none", "add them to the device file"),
        (record.current_limit is not None, reach, limit, "none", "add record.current_limit_A or a [driver]"),
        (len(record.points) > 0, points, "needs points", "none", "add record.points_mm = [[x, y, z]]"),
        (record.box is not None, corners, "needs a box", "none", "add record.box_mm, its corners"),
        (not saturating, {"reachable_share"}, linear, "saturating iron", "take reach"),
        (bool(device.bodies), iron, "needs iron", "a device without bodies", "add a body"),
        (box, {"error"}, "needs the device's [workspace]", "none", "add it to the device file"),
    ]
    return [
        (frozenset(groups), must_hold, received, remedy)
        for there, groups, must_hold, received, remedy in needs
        if not there
    ]


def axis_labels(
    record: Record, coil_names: tuple[str, ...], body_names: tuple[str, ...]
) -> dict[str, tuple[str, ...]]:
    """Labels of the entries along each axis of quantities."""
    letters = ("x", "y", "z")
    points = tuple(str(k + 1) for k in range(len(record.points)))
    return {
        "coil": coil_names,
        "other_coil": coil_names,
        "body": body_names,
        "point": points,
        "component": letters,
        "direction": letters,
    }


def settings_with(key: str, value: Any, linked: Iterable[Any]) -> tuple[tuple[str, Value], ...]:
    """A key with its value, and the keys that follow it: offset + factor * value."""
    followers = [(name, one.offset + one.factor * value) for one in linked for name in one.keys]
    return ((key, value), *followers)


def setting_words(settings: Mapping[str, Any]) -> str:
    """The changed keys in words.

    >>> setting_words({"radius": 56.0, "steel": "soft"})
    'radius = 56, steel = soft'
    """
    return ", ".join(
        f"{name} = {value}" if isinstance(value, str) else f"{name} = {value:g}"
        for name, value in settings.items()
    )
