"""A map on its nodes as an xarray data set, with coordinates, units and assumptions."""

from typing import TYPE_CHECKING, Any

from fieldmap.extras import require
from fieldmap.provenance import library_versions
from fieldmap.store import FieldError, MapInfo
from fieldmap.typing import Array

if TYPE_CHECKING:
    import xarray

_FRAME = "Right-handed frame, z up, SI units."
_QUANTITIES = (
    ("flux_density", ("component",), "T", "flux density B"),
    ("gradient", ("component", "direction"), "T m-1", "dB_component/dx_direction"),
)


def data_set(
    info: MapInfo,
    kind: str,
    currents: Array | None,
    flux: Array,
    gradient: Array,
    constant: tuple[Array, Array] | None = None,
) -> "xarray.Dataset":
    """B and gradient on the nodes of a map, z fastest: (nodes, 3) and (nodes, 3, 3) at currents (n_coils,), A.

    Without currents (nodes, n_coils, 3) and (nodes, n_coils, 3, 3) per ampere. constant: field and gradient of fixed
    sources, if there are any. kind: of the lookup. Raises FieldmapError without xarray.
    """
    xarray_module = require("xarray", "xarray", "FieldMap.to_xarray")
    axes = ("x", "y", "z")
    found: dict[str, Any] = {
        "reference_current": ("coil", info.reference_current, _about("A", "currents of the stated errors"))
    }
    fields: list[tuple[str, tuple[str, ...], tuple[Array, Array], str, str]]
    if currents is None:
        fields = [("unit_", ("coil",), (flux, gradient), " A-1", " of 1 A in this coil alone")]
    else:
        fields = [("", (), (flux, gradient), "", " of the currents")]
        found["current"] = ("coil", currents, _about("A", "current of each coil"))
    if constant is not None:
        off = f" with all currents off, of {', '.join(info.fixed_sources)}"
        fields.insert(0, ("constant_", (), constant, "", off))
    bound = info.error_bounds.get(kind)
    for begin, more, arrays, per, when in fields:
        certified = None if begin == "constant_" else bound
        for (name, tail, unit, meaning), values in zip(_QUANTITIES, arrays, strict=True):
            found[begin + name] = (
                (*axes, *more, *tail),
                values.reshape(*info.grid.shape, *values.shape[1:]),
                _about(f"{unit}{per}", f"{meaning}{when}") | _bound(certified, name),
            )
    coordinates: dict[str, Any] = {
        axis: (axis, values, {**_about("m", f"{axis} of the node"), "axis": axis.upper()})
        for axis, values in zip(axes, info.grid.axes, strict=True)
    }
    coordinates |= {letters: (letters, list(axes)) for letters in ("component", "direction")}
    coordinates["coil"] = ("coil", list(info.coil_names), {"long_name": "coils in current order"})
    data: xarray.Dataset = xarray_module.Dataset(found, coordinates, _attributes(info, kind))
    return data


def _about(unit: str, meaning: str) -> dict[str, str]:
    return {"units": unit, "long_name": meaning}


def _bound(bound: FieldError | None, quantity: str) -> dict[str, float]:
    """The error that is certified up to the reference currents, T or T/m; empty for a map without certificate."""
    return {} if bound is None else {"certified_error": float(getattr(bound, quantity))}


def _attributes(info: MapInfo, kind: str) -> dict[str, str]:
    made = info.provenance
    return {
        "title": made.title,
        "Conventions": "CF-1.10",
        "comment": _FRAME,
        "source": f"fieldmap {library_versions()['fieldmap']}",
        "device": made.device_name,
        "lookup": kind,
        "assumptions": "\n".join(made.assumptions),
        "created": made.created,
        "fingerprint": made.fingerprint,
    }
