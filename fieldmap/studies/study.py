"""A study as data: variants of a device, sets of currents, and recorded quantities."""

import re
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo

from fieldmap import records
from fieldmap.currents import divide_currents
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import FieldmapError, Problem
from fieldmap.inputs.declared import Key, table_of
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding, one_of, shown
from fieldmap.inputs.tables import Name, Point, Positive, Text, broken, is_number, one_or_each, text_like
from fieldmap.maps.recipe import LARGEST_CURRENT_A, IronModel
from fieldmap.maps.training.plan import Accuracy
from fieldmap.provenance import fingerprint
from fieldmap.studies.quantities import GROUPS, NEED_PAYLOAD
from fieldmap.typing import Array

# Packages and modules whose code affects the numbers of a study.
CODE = ("kernels", "inputs", "device", "field", "currents", "sources", "iron", "levitation", "studies")
Value = float | int | str
MOST_AMPERES = 1e9

_UNIT = re.compile(r"_(mm|deg|T_per_m|T|A_per_V|A_m2|A|V|ohm|mH|N_s_per_m|g_mm2|g)$")


def _value(value: Any) -> Any:
    """Check that a value is a number or a text, as values of keys are."""
    if not is_number(value) and not (isinstance(value, str) and value):
        raise broken("must be a finite number or a text", shown(value), "list plain values of the key")
    return value


One = TypeVar("One")
Some = Annotated[list[One], Field(min_length=1)]
"""A list of one or more."""
Values = Some[Annotated[Any, BeforeValidator(_value)]]


@dataclass(frozen=True, repr=False)
class Linked(records.Record):
    """Keys that follow a varied one: offset + factor * value, in the units of the keys."""

    keys: Annotated[tuple[str, ...], Key(Some[Text], "key paths of the device file")]
    factor: Annotated[float, Key(float, "factor of the value")] = 1.0
    offset: Annotated[float, Key(float, "offset, in the unit of the key")] = 0.0


LinkedKeys: Any = table_of(Linked)


def _one_kind_of_value(keys: Any) -> None:
    texts = [isinstance(value, str) for value in keys.values]
    if any(texts) and not all(texts):
        raise broken("values must be all numbers or all texts", shown(keys.values), "separate them")
    if len(set(keys.values)) < len(keys.values):
        raise broken("every value must be listed once", shown(keys.values), "remove the second one")
    if keys.linked and any(texts):
        remedy = "leave [[vary.linked]] out, or write [[variant]] tables"
        raise broken("keys can only follow numbers", shown(keys.values), remedy)


@dataclass(frozen=True, repr=False)
class Axis(records.Record):
    """One varied key, an axis of the grid of variants. values: in the key's unit."""

    name: Annotated[
        str,
        Key(
            Annotated[
                str,
                text_like(
                    r"^[A-Za-z0-9][A-Za-z0-9_]*$",
                    "must begin with a letter or digit and have letters, digits and _ only",
                    'rename it, for example "gap_mm"',
                ),
            ],
            "name of the axis in tables and in the data set",
        ),
    ]
    key: Annotated[str, Key(Text, 'key path of the device file, for example "body.disk.radius_mm"')]
    values: Annotated[tuple[Value, ...], Key(Values, "the values that it takes")]
    linked: Annotated[tuple[Linked, ...], Key(list[LinkedKeys], "[[vary.linked]]: keys that follow")] = ()

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


AxisKeys: Any = table_of(Axis, rules=(_one_kind_of_value,))


@dataclass(frozen=True, repr=False)
class OneVariant(records.Record):
    """One variant by itself."""

    name: Annotated[str, Key(Name, "name of the variant")]
    set: Annotated[
        Mapping[str, Value],
        Key(
            Annotated[dict[str, Annotated[Any, BeforeValidator(_value)]], Field(min_length=1)],
            '"key.path" = value',
        ),
    ]


@dataclass(frozen=True, repr=False)
class Variant(records.Record):
    """One device of the study: its device file with changed keys. place: index along each axis, or its number."""

    name: str
    place: tuple[int, ...]
    settings: tuple[tuple[str, Value], ...]
    document: Document


@dataclass(frozen=True, eq=False, repr=False)
class CurrentSet(records.Record):
    """Currents shares * c (n_coils,) with the mean magnitude c. common: c in A, or None if c is computed so that the
    currents carry the payload at carried_at (3,), m."""

    name: str
    shares: Array
    common: float | None
    carried_at: Array | None


Amperes = Annotated[
    Any,
    one_or_each(
        lambda n: abs(n) <= LARGEST_CURRENT_A,
        "one number for all coils, or a list of one per coil, not all of them 0",
        "write for example amperes_A = 1.5",
        some=True,
    ),
]


def _of_some_size(keys: Any) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        largest = float(np.abs(divide_currents(keys.u_A or 1.0, keys.x, keys.y, keys.n)).max())
    if not largest <= MOST_AMPERES:
        must_hold = f"the signals must leave every coil below {MOST_AMPERES:g} A"
        raise broken(must_hold, f"a coil at {largest:.3g}", "narrow x, y and n, or lower u_A")


@dataclass(frozen=True, repr=False)
class Signals(records.Record):
    """Six currents from one lift and two direction signals: `fieldmap.currents.LiftAndDirections`."""

    u: Annotated[float | None, Key(Positive | None, "mean current; left out where it is looked for", "A")] = (
        None
    )
    x: Annotated[float, Key(float, "direction signal along x")] = 0.0
    y: Annotated[float, Key(float, "direction signal along y")] = 0.0
    n: Annotated[float, Key(Positive, "how much more the two coils on the x axis follow x")] = 1.0


def _given_or_looked_for(keys: Any) -> None:
    names = [name for name in type(keys).model_fields if name != "name" and getattr(keys, name) is not None]
    received, signals = ", ".join(names) or "none of them", keys.lift_and_directions
    divided = signals is not None and signals.u_A is not None
    if keys.carries_at_mm is None:
        ways = [keys.amperes_A, signals]
        if ways.count(None) != 1 or keys.shares is not None or divided != (signals is not None):
            must_hold = "a set of currents has amperes_A or lift_and_directions with u_A, or carries_at_mm"
            raise broken(must_hold, received, "give one of them")
    elif keys.amperes_A is not None or divided:
        must_hold = "currents that carry the payload are looked for: only their shares can be given"
        raise broken(must_hold, received, "write shares, or lift_and_directions without u_A")
    elif keys.shares is not None and signals is not None:
        raise broken("shares or lift_and_directions", received, "leave one of them out")


@dataclass(frozen=True, eq=False, repr=False)
class StatedCurrents(records.Record):
    """One set of currents: given, or those that carry the payload at a place."""

    name: Annotated[str, Key(Text, "name of the set")]
    amperes: Annotated[Any, Key(Amperes, "one current for all coils, or one per coil", "A")] = None
    shares: Annotated[Any, Key(Amperes, "of each coil, where the currents are looked for")] = None
    lift_and_directions: Annotated[
        Signals | None,
        Key(
            table_of(Signals, rules=(_of_some_size,)) | None,
            "six currents of a lift and two direction signals",
        ),
    ] = None
    carries_at: Annotated[Array | None, Key(Point | None, "where the currents carry the payload", "mm")] = (
        None
    )

    def currents(self, coils: int) -> CurrentSet:
        """The set for a number of coils; `mistakes` reports lists of a wrong length."""
        amperes: Any = self.shares if self.amperes is None else self.amperes
        if self.lift_and_directions is not None:
            of = self.lift_and_directions
            amperes = divide_currents(of.u or 1.0, of.x, of.y, of.n)
        fits = amperes is not None and np.size(amperes) in (1, coils)
        return current_set(self.name, amperes if fits else 1.0, coils, self.carries_at)

    def mistakes(self, device: Device) -> Iterator[Finding]:
        """Findings for keys that do not fit the device."""
        coils = len(device.coils)
        for key, given in (("amperes_A", self.amperes), ("shares", self.shares)):
            if np.ndim(given) and len(given) != coils:
                names = ", ".join(device.coil_names)
                must_hold = f"one number for each of the {coils} coils ({names}), or one for all"
                remedy = "list as many as there are coils"
                yield Finding((key,), must_hold, f"{len(given)} numbers", remedy)
        if self.lift_and_directions is not None and coils != 6:
            must_hold, remedy = "lift_and_directions is for six coils", "write amperes_A or shares"
            yield Finding(("lift_and_directions",), must_hold, f"{coils} coils", remedy)
        if self.carries_at is not None and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            remedy = "add them to the device file, or write amperes_A"
            yield Finding(("carries_at_mm",), must_hold, "none", remedy)


CurrentsKeys: Any = table_of(StatedCurrents, rules=(_given_or_looked_for,))


def _one_that_chooses_the_mesh(keys: Any) -> None:
    if keys.model == "saturating" and keys.mu_r != "initial":
        received = f"mu_r = {shown(keys.mu_r)}"
        raise broken("saturating iron follows its B-H law", received, "leave mu_r out")
    if keys.model == "linear" and keys.accuracy is not None and "refinement" in keys.model_fields_set:
        must_hold = "with accuracy, the meshes of linear iron are chosen by their errors"
        raise broken(must_hold, "accuracy and refinement", "leave one of them out")


@dataclass(frozen=True, repr=False)
class StudyIron(IronModel):
    """How the iron is modelled and how well it is solved. accuracy: None for a single mesh."""

    accuracy: Annotated[
        float | None, Key(Accuracy | None, "estimated error of B in the workspace at which refining stops")
    ] = None


IronKeys: Any = table_of(StudyIron, rules=(_one_that_chooses_the_mesh,))


def _quantity(value: Any) -> Any:
    if value not in GROUPS:
        raise broken(f"must be one of {one_of(list(GROUPS))}", shown(value), "choose from these")
    return value


def _corners_in_order(box: Any, info: ValidationInfo) -> None:
    if box is not None and not all(low < high for low, high in zip(*box, strict=True)):
        must_hold = "the lower corner of box_mm must lie below the upper one, along x, y and z"
        raise broken(must_hold, shown(box), "write [[lower x, y, z], [upper x, y, z]]")


@dataclass(frozen=True, eq=False, repr=False)
class Record(records.Record):
    """The recorded quantities of every variant at every set of currents.

    groups: of quantities. points (n, 3), m. current_limit: A. box: corners (3,), m.
    """

    groups: Annotated[
        tuple[str, ...],
        Key(
            list[Annotated[str, BeforeValidator(_quantity)]] | None,
            f"of {', '.join(GROUPS)}; what the device allows, without inductance and power, if left out",
            name="quantities",
            examples=(["currents", "equilibrium"],),
        ),
    ] = None  # type: ignore[assignment]
    points: Annotated[
        Array,
        Key(
            list[Point],
            "where field and force are recorded",
            "mm",
            make=lambda points: np.array(points, float).reshape(-1, 3),
        ),
    ] = field(default_factory=lambda: np.zeros((0, 3)))
    force_share: Annotated[
        float,
        Key(Annotated[float, Field(gt=0, le=1)], "share of the weight that bounds the equilibrium area"),
    ] = 0.01
    current_limit: Annotated[
        float | None, Key(Positive | None, "of every coil; the driver's if left out", "A")
    ] = None
    box: Annotated[
        tuple[Array, Array] | None,
        Key(
            Annotated[list[Point], Field(min_length=2, max_length=2)] | None,
            "lower and upper corner of the box whose homogeneity is recorded",
            "mm",
            check=_corners_in_order,
            examples=([[-5.0, -5.0, -110.0], [5.0, 5.0, -100.0]],),
        ),
    ] = None


@dataclass(frozen=True, eq=False, repr=False)
class Study(records.Record):
    """A study, in SI; path and text: the file as read. axes: varied keys; none if variants are listed one by one.

    device_document: the unchanged device file. coil_names: in the order of currents; body_names: in that of the file.
    """

    path: Path
    text: str
    title: str
    axes: tuple[Axis, ...]
    variants: tuple[Variant, ...]
    current_sets: tuple[CurrentSet, ...]
    iron: StudyIron
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
        """The varied values of a variant.

        Parameters
        ----------
        number
            Number of the variant.

        Returns
        -------
        dict[str, Value]
            The varied keys in their units by the names of their axes; or the variant's name.
        """
        variant = self.variants[number]
        values = {axis.name: axis.values[k] for axis, k in zip(self.axes, variant.place, strict=False)}
        return values or {"variant": variant.name}

    @property
    def fingerprint(self) -> str:
        """Fingerprint of everything that determines the numbers. If it is equal, so are the data on one machine."""
        device = device_of(self.device_document)
        return fingerprint((self.text, repr(self.iron), *device.texts), CODE)


def current_set(name: str, amperes: Any, coils: int, place: Array | None) -> CurrentSet:
    """A set of currents, from one number for all coils or (coils,), A; with a place (3,), m, their common factor is
    computed so that they carry the payload there."""
    currents = np.array(np.broadcast_to(np.asarray(amperes, dtype=float), coils))
    common = float(np.abs(currents).mean())
    return CurrentSet(name, currents / common, common if place is None else None, place)


def lacking(device: Device, record: Record, saturating: bool) -> list[tuple[frozenset[str], str, str, str]]:
    """Requirements that device, record or iron do not meet: groups that need each, what must hold, what was received,
    and the remedy."""
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
    points, letters = tuple(str(k + 1) for k in range(len(record.points))), ("x", "y", "z")
    labels = {"coil": coil_names, "other_coil": coil_names, "body": body_names}
    return labels | {"point": points, "component": letters, "direction": letters}


def settings_with(key: str, value: Any, linked: Iterable[Linked]) -> tuple[tuple[str, Value], ...]:
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


def saturates(device: Device) -> bool:
    """Whether a body of the device is of a material that saturates."""
    return any(device.materials[body.material].saturates for body in device.bodies)


def refused(document: Document) -> list[tuple[str, Problem]]:
    """Problems of a changed device file, with their keys."""
    try:
        device_of(document)
    except FieldmapError as error:
        return [(problem.where.split(": ", 1)[-1], problem) for problem in error.problems]
    return []
