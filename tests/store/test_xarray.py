"""xarray with h5netcdf opens a finished, sealed map. FieldMesh and the openPMD validator: test_openpmd."""

import warnings

import numpy as np

from fieldmap.store import write_map


def test_xarray_reads_a_record_with_its_coordinates(make_map, tmp_path):
    """As shown in docs/map_file.md."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of its own imports
        import xarray
    data = make_map(reference_current=2.0)
    path = write_map(tmp_path / "map.h5", data)
    for record, values in (("B_1", data.flux_density[0]), ("B_upper_left", data.flux_density[1])):
        with xarray.open_dataset(
            path, engine="h5netcdf", group=f"/data/0/meshes/{record}", phony_dims="sort"
        ) as opened:
            at = opened.attrs
            assert list(opened) == ["x", "y", "z"]
            for c, name in enumerate("xyz"):
                np.testing.assert_allclose(opened[name].values, 2.0 * values[..., c], rtol=1e-15)
                assert opened[name].attrs["unitSI"] == 1.0
            axes = [
                start + step * np.arange(count)
                for start, step, count in zip(
                    at["gridGlobalOffset"], at["gridSpacing"], opened["x"].shape, strict=True
                )
            ]
            for ours, theirs in zip(data.grid.axes, axes, strict=True):
                np.testing.assert_allclose(ours, theirs, atol=1e-15)
