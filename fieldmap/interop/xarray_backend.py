"""Map files in xarray: `xarray.open_dataset("map.h5", engine="fieldmap")`.

xarray finds the engine by an entry point of the group "xarray.backends".
"""

from collections.abc import Iterable
from typing import Any, ClassVar

from xarray import Dataset
from xarray.backends import BackendEntrypoint


class MapEngine(BackendEntrypoint):
    """Opens a map on its nodes, as `fieldmap.lookup.FieldMap.to_xarray` does.

    >>> import xarray                                                                # doctest: +SKIP
    >>> xarray.open_dataset("map.h5", engine="fieldmap", currents=[2.0])             # doctest: +SKIP
    """

    description: ClassVar[str] = "Maps of flux density and gradient that fieldmap made"
    open_dataset_parameters: ClassVar[tuple[str, ...]] = (
        "filename_or_obj",
        "drop_variables",
        "currents",
        "kind",
    )

    def open_dataset(  # type: ignore[override]
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        currents: Any = None,
        kind: str = "harmonic",
    ) -> Dataset:
        """Open the data set of a map file. currents: A, as for `FieldMap.field`; by default the fields of all coils
        per ampere. kind: of lookup. Raises FieldmapError as `fieldmap.open_map` and `FieldMap.to_xarray` do."""
        from fieldmap.lookup import open_map

        data: Dataset = open_map(filename_or_obj, kind=kind).to_xarray(currents)
        unwanted = [drop_variables] if isinstance(drop_variables, str) else list(drop_variables or ())
        return data.drop_vars(unwanted, errors="ignore")
