"""The results of a study as an xarray data set, as NetCDF and as CSV."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fieldmap.device.reader import device_of
from fieldmap.extras import require
from fieldmap.provenance import library_versions
from fieldmap.store.whole_files import whole_file
from fieldmap.studies.quantities import NEED_PAYLOAD, Quantity, number_names, recorded
from fieldmap.studies.study import Axis, Study
from fieldmap.studies.variant_result import COPPER_WINDINGS, VariantResult
from fieldmap.typing import Array

_CONVENTIONS = (
    "SI units. Right-handed frame, z up, origin on the centre of the pole disk's lower face. gradient: "
    "dB_component/dx_direction."
)
_OF_THE_PAYLOAD = (
    "the payload is a vertical point dipole at the magnet's centre and does not magnetise the iron",
    "the currents are constant",
)


def require_xarray() -> ModuleType:
    """The module xarray. Raises FieldmapError, with the extra to install, where it or h5netcdf is missing."""
    require("h5netcdf", "studies", "fieldmap.studies")
    return require("xarray", "studies", "fieldmap.studies")


def data_set(study: Study, results: Sequence[VariantResult]) -> Any:
    """xarray.Dataset of all variants: one axis for each varied key (or `variant`), then `currents`: docs/studies.md."""
    xarray = require_xarray()
    leading = _leading(study)
    variables = {}
    for quantity in recorded(study.record.groups):
        attributes = {"units": quantity.unit, "long_name": quantity.meaning}
        variables[quantity.name] = ((*leading, *quantity.axes), _values(study, results, quantity), attributes)
    reasons = np.array(
        [[" || ".join(row.problems) for row in result.rows] for result in results], dtype=object
    )
    about = {"long_name": "why numbers of this variant are missing; empty where nothing failed"}
    variables["problem"] = (leading, reasons.reshape(*study.shape, -1), about)
    variables |= _files(study)
    return xarray.Dataset(variables, coords=_coordinates(study), attrs=_attributes(study, results))


def _files(study: Study) -> dict[str, Any]:
    """The files as read; variables, because an attribute of HDF5 holds no more than 64 kB."""
    device = device_of(study.device_document)
    included = json.dumps(dict(sorted(device.included.items())))
    texts = {
        "study_file": (study.text, "the study file as read"),
        "device_file": (device.text, "the device file as read, before any key was changed"),
        "included_files": (included, "files that the device file names, as JSON: name to text or hash"),
    }
    return {name: ((), text, {"long_name": meaning}) for name, (text, meaning) in texts.items()}


def _leading(study: Study) -> tuple[str, ...]:
    return (*(tuple(axis.name for axis in study.axes) or ("variant",)), "currents")


def _values(study: Study, results: Sequence[VariantResult], quantity: Quantity) -> Array:
    """(axes of the variants, currents, axes of the quantity); NaN where there is no number."""
    shape = tuple(len(study.labels[axis]) for axis in quantity.axes)
    missing = np.full(shape, np.nan)
    rows = [[row.numbers.get(quantity.name, missing) for row in result.rows] for result in results]
    return np.array(rows, dtype=float).reshape(*study.shape, len(study.current_sets), *shape)


def _coordinates(study: Study) -> dict[str, Any]:
    found: dict[str, Any] = {"currents": ("currents", [entry.name for entry in study.current_sets])}
    for axis in study.axes:
        found[axis.name] = (axis.name, np.array(axis.values), _axis_attributes(axis))
    if not study.axes:
        found["variant"] = ("variant", [variant.name for variant in study.variants])
    axes = {axis for quantity in recorded(study.record.groups) for axis in quantity.axes}
    found |= {axis: (axis, list(study.labels[axis])) for axis in sorted(axes - {"point"})}
    if "point" in axes:
        for k, letter in enumerate("xyz"):
            found[f"point_{letter}"] = ("point", study.record.points[:, k], {"units": "m"})
    return found


def _axis_attributes(axis: Axis) -> dict[str, str]:
    attributes = {"long_name": axis.key}
    return attributes | {"units": axis.unit} if axis.unit else attributes


def _attributes(study: Study, results: Sequence[VariantResult]) -> dict[str, str]:
    carried = NEED_PAYLOAD & set(study.record.groups) or any(
        entry.common is None for entry in study.current_sets
    )
    assumed = dict.fromkeys(text for result in results for text in result.assumptions)
    if "power" in study.record.groups:
        assumed[COPPER_WINDINGS] = None
    limit = study.record.current_limit
    return {
        "title": study.title,
        "Conventions": "CF-1.10",
        "comment": _CONVENTIONS,
        "source": ", ".join(
            f"{name} {number}" for name, number in library_versions("xarray", "h5netcdf").items()
        ),
        "assumptions": "\n".join((*(_OF_THE_PAYLOAD if carried else ()), *assumed)),
        "force_share": f"{study.record.force_share!r}",
        "current_limit_A": "none" if limit is None else f"{limit!r}",
        "iron": repr(study.iron),
        "fingerprint": study.fingerprint,
    }


def write_netcdf(data: Any, path: Path) -> None:
    """Write the data set; the file appears complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        data.to_netcdf(partial, engine="h5netcdf")


def csv_text(study: Study, results: Sequence[VariantResult]) -> str:
    """One line for each variant and set of currents; every number of the data set, units in the header.

    A column is NAME [axis labels] (unit): `flux_density 1 z (T)` is B_z at the first point, `current 5 (A)` of coil 5.
    """
    columns = number_names(study.record.groups, study.labels)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    axes = [f"{axis.name} ({axis.unit})" if axis.unit else axis.name for axis in study.axes] or ["variant"]
    names = [f"{name} ({quantity.unit})" for name, (quantity, _) in columns.items()]
    writer.writerow([*axes, "currents", *names, "problem"])
    for variant, result in zip(study.variants, results, strict=True):
        values = [axis.values[k] for axis, k in zip(study.axes, variant.place, strict=False)] or [
            variant.name
        ]
        for entry, row in zip(study.current_sets, result.rows, strict=True):
            cells = [_cell(row.numbers.get(quantity.name), at) for quantity, at in columns.values()]
            writer.writerow([*values, entry.name, *cells, " || ".join(row.problems)])
    return out.getvalue()


def _cell(value: Any, at: tuple[int, ...]) -> str:
    for k in at:
        value = None if value is None else value[k]
    return "" if value is None else repr(float(value))
