"""The layout of a map file: paths and names in it, and its header and report as JSON with hashes."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import h5py
import numpy as np

from fieldmap.records import Record
from fieldmap.store.map_data import FieldError, Grid, MapInfo, Provenance
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.typing import Array

FORMAT_VERSION, WITH_FIXED_SOURCES, WITH_HYSTERESIS = VERSIONS = 1, 2, 3
"""Version of the format, and versions that older readers refuse: of maps with fixed sources, and with hysteresis."""
# Most nodes of a chunk: few enough that a killed run loses little, many enough that the solver is efficient.
NODES_PER_CHUNK = 1000
MESHES = "/data/0/meshes"
OWN = "/fieldmap"
REDUCED_MODEL = f"{OWN}/reduced_model"
REACTION = f"{OWN}/reaction"
"""Group of the fields of the iron's reaction to magnets: data sets like those of `StoredReaction`, float32; attribute
`repelled`. Readers that do not know it read a map without."""
REPELLED = "repelled"
LINKAGE = f"{OWN}/linkage"
"""Group of the flux linkages of the coils: data sets by the names of `StoredLinkage`, float64. Readers that do not know
it read a map without."""
SENSORS = f"{OWN}/sensors"
"""Group of the field sensors: data sets like the arrays of `StoredSensors`, attribute `names` (JSON), and with iron a
group `answers` of fields, float32. Readers that do not know it read a map without."""
LOOKUP = f"{OWN}/lookup"
"""Group of large maps, whose numbers at the nodes are not read for lookups: attribute `every`; the blocks of `LargeMap`
as data sets named after their interpolants, each with an attribute `misfit`; `reaction_cells`; groups like `REACTION`
and `SENSORS`. Readers that do not know it read the numbers at the nodes."""
REACTION_CELLS = "reaction_cells"
LOOKUP_REACTION, LOOKUP_SENSORS = f"{LOOKUP}/reaction", f"{LOOKUP}/sensors"
PARAMETRISATION = "parametrisation"
"""Attribute of the reduced model, JSON: name and parameters of the parametrisation of the currents."""
DIVISION_EXPONENT = "division_exponent"
"""Data set that older readers need: n of `LiftAndDirections`, or an empty array for independent currents."""
VECTOR = ("x", "y", "z")


@dataclass(frozen=True, eq=False, repr=False)
class Quantity(Record):
    """A quantity for which a file holds one record per field.

    name: of the array in `MapData`; record: start of the record's name; components: of the record, in the order of the
    last axes (*tail,) of the array; unit: powers of length, mass, time, current, temperature, amount and luminous
    intensity; comment: of a field's record, with a place for the source.
    """

    name: str
    record: str
    components: tuple[str, ...]
    tail: tuple[int, ...]
    unit: Array
    comment: str

    def path(self, field: str = "") -> str:
        """Path of the record of a field, given its name of `record_names`; of the total unless given."""
        return f"{MESHES}/{self.record}" + (f"_{field}" if field else "")


FLUX_DENSITY = Quantity(
    "flux_density", "B", VECTOR, (3,), np.array([0.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0]), "flux density of {}"
)
GRADIENT = Quantity(
    "gradient",
    "gradB",
    tuple(i + j for i in VECTOR for j in VECTOR),
    (3, 3),
    np.array([-1.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0]),
    "gradient of the flux density of {}; component xy is dB_x/dy",
)
QUANTITIES = (FLUX_DENSITY, GRADIENT)


def record_names(coil_names: Sequence[str]) -> tuple[str, ...]:
    """One distinct part of a record's name for each coil, of ASCII letters, digits and underscores only.

    >>> record_names(["1", "upper left", "upper-left"])
    ('1', 'upper_left', 'upper_left_2')
    """
    taken: list[str] = []
    for name in coil_names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
        candidate, count = plain, 1
        while candidate in taken:
            count += 1
            candidate = f"{plain}_{count}"
        taken.append(candidate)
    return tuple(taken)


@dataclass(frozen=True)
class Chunk(Record):
    """A part of a map: the x-planes first <= i < last of the grid."""

    number: int
    first: int
    last: int


def planes_per_chunk(grid: Grid) -> int:
    """Number of x-planes in a chunk. It depends on the grid alone, so that a resumed run has the same chunks."""
    nx, ny, nz = grid.shape
    most = max(1, NODES_PER_CHUNK // (ny * nz))
    # The fewest chunks of at most `most` planes, all but the last equal.
    return -(-nx // -(-nx // most))


def chunks_of(grid: Grid) -> tuple[Chunk, ...]:
    """All chunks of a grid, in order."""
    planes = planes_per_chunk(grid)
    starts = range(0, grid.shape[0], planes)
    return tuple(Chunk(n, first, min(first + planes, grid.shape[0])) for n, first in enumerate(starts))


Value = TypeVar("Value")
# Attributes of the provenance that are in the header under the same names: texts, and mappings of texts.
_TEXTS = ("title", "device_name", "created", "fingerprint")
_NAMED_TEXTS = ("versions", "included")

# Exceptions of h5py for a damaged or foreign file.
UNREADABLE = (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError)
_EMPTY = b"\n"  # HDF5 has no string of length 0


class DamagedText(ValueError):  # noqa: N818 - internal, turned into MapFileError by the reader
    """A stored text does not have its recorded hash."""


def sha256(text: str) -> str:
    """Hexadecimal SHA-256 of a text in UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


def write_text(file: h5py.File, name: str, text: str) -> None:
    """Store a text under /fieldmap, with its hash; replaces an earlier one."""
    path = f"{OWN}/{name}"
    if path in file:
        del file[path]
    raw = text.encode() or _EMPTY
    file[path] = np.array(raw, dtype=h5py.string_dtype("utf-8", len(raw)))
    file[path].attrs["sha256"] = np.bytes_(hashlib.sha256(raw).hexdigest())


def read_text(data: h5py.Dataset) -> str:
    """Read a stored text. Raises DamagedText if its hash is not the recorded one."""
    raw = bytes(data[()])
    if hashlib.sha256(raw).hexdigest().encode() != bytes(data.attrs["sha256"]):
        raise DamagedText(data.name)
    return "" if raw == _EMPTY else raw.decode()


def format_of(info: MapInfo) -> int:
    """Version of the format that a map is written in."""
    if info.reduced_model is not None and info.reduced_model.remembers:
        return WITH_HYSTERESIS
    return WITH_FIXED_SOURCES if info.fixed_sources else FORMAT_VERSION


def header_of(info: MapInfo) -> dict[str, Any]:
    """The part of a map's description that is known before it is computed, as plain JSON."""
    source = info.provenance
    fixed = {"fixed_sources": list(info.fixed_sources), "constant_field": info.constant_field}
    return {
        "format": format_of(info),
        **{name: getattr(source, name) for name in _TEXTS},
        "recipe_sha256": sha256(source.recipe_text),
        "device_sha256": sha256(source.device_text),
        **{name: dict(getattr(source, name)) for name in _NAMED_TEXTS},
        "coil_names": list(info.coil_names),
        "record_names": list(record_names(info.field_names)),
        "reference_current_A": info.reference_current.tolist(),
        "lower_m": info.grid.lower.tolist(),
        "spacing_m": info.grid.spacing.tolist(),
        "shape": list(info.grid.shape),
        "planes_per_chunk": planes_per_chunk(info.grid),
        **(fixed if info.fixed_sources else {}),
    }


def report_of(info: MapInfo) -> dict[str, Any]:
    """The part of a map's description that is known only after it was computed, as plain JSON."""
    return {
        "solver_report": dict(info.provenance.solver_report),
        "assumptions": list(info.provenance.assumptions),
        "interpolation_error": _error_keys(info.interpolation_error),
        "error_bounds": {kind: _error_keys(error) for kind, error in info.error_bounds.items()},
        "current_error": _error_keys(info.current_error),
    }


def info_from(
    header: Mapping[str, Any],
    report: Mapping[str, Any],
    recipe: str,
    device: str,
    reduced_model: ReducedModel | None,
) -> MapInfo:
    """The map's description from header, report and source texts; KeyError, TypeError or ValueError if ill-formed."""
    texts: dict[str, Any] = {name: _value(header, name, str) for name in _TEXTS}
    # Older files do not state the files that the device refers to.
    texts |= {name: _named_texts({"included": {}, **header}[name]) for name in _NAMED_TEXTS}
    provenance = Provenance(
        recipe_text=recipe,
        device_text=device,
        solver_report=dict(report["solver_report"]),
        assumptions=_texts(report, "assumptions"),
        **texts,
    )

    def stated(name: str) -> FieldError | None:
        return None if report.get(name) is None else _error_from(report[name])

    return MapInfo(
        grid=Grid(header["lower_m"], header["spacing_m"], tuple(header["shape"])),
        coil_names=_texts(header, "coil_names"),
        reference_current=np.array(header["reference_current_A"]),
        provenance=provenance,
        interpolation_error=stated("interpolation_error"),
        error_bounds={kind: _error_from(error) for kind, error in report["error_bounds"].items()},
        reduced_model=reduced_model,
        current_error=stated("current_error"),
        fixed_sources=_texts({"fixed_sources": [], **header}, "fixed_sources"),
        constant_field=_value({"constant_field": False, **header}, "constant_field", bool),
    )


def _value(keys: Mapping[str, Any], name: str, kind: type[Value]) -> Value:
    if not isinstance(keys[name], kind):
        raise TypeError(f"{name}: {type(keys[name]).__name__} in the place of another type")
    return keys[name]


def _named_texts(keys: Mapping[str, Any]) -> dict[str, str]:
    return {name: _value(keys, name, str) for name in dict(keys)}


def _texts(keys: Mapping[str, Any], name: str) -> tuple[str, ...]:
    return tuple(_value({name: text}, name, str) for text in _value(keys, name, list))


def to_json(values: Mapping[str, Any]) -> str:
    """Readable JSON; floats survive the round trip exactly."""
    return json.dumps(values, indent=1, ensure_ascii=False)


def _error_keys(error: FieldError | None) -> dict[str, float] | None:
    if error is None:
        return None
    return {"flux_density_T": float(error.flux_density), "gradient_T_per_m": float(error.gradient)}


def _error_from(keys: Mapping[str, float]) -> FieldError:
    numbers = (float(keys["flux_density_T"]), float(keys["gradient_T_per_m"]))
    if not all(np.isfinite(number) and number >= 0.0 for number in numbers):
        raise ValueError(f"a stated error of {numbers}")
    return FieldError(*numbers)
