"""Maps as xarray data sets: xarray finds the values of the map, and nothing is lost on the way."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import fieldmap
from fieldmap.errors import FieldmapError, InputError
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData, Provenance

SAMPLE = Path(__file__).parents[2] / "maps" / "sample.h5"
CURRENTS = np.array([1.5, -0.5, 2.0])


@pytest.fixture(scope="module")
def xarray():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own imports
        return pytest.importorskip(
            "xarray", reason='xarray is not installed (pip install "fieldmap[xarray]")'
        )


@pytest.fixture(scope="module")
def field(dipoles):
    """The Hermite form passes through the values at the nodes; counts and sides of the box differ."""
    data = dipoles.map((6, 5, 7))
    made = Provenance(title="three dipoles", device_name="none", assumptions=("no iron", "steady currents"))
    about = {"provenance": made, "flux_density": data.flux_density, "gradient": data.gradient}
    return interpolate(MapData(data.grid, data.coil_names, [1.0, 2.0, 3.0], **about), kind="hermite")


def test_what_stands_at_a_node_is_the_field_there(xarray, field, dipoles):
    data = field.to_xarray(CURRENTS)
    assert data["flux_density"].dims == ("x", "y", "z", "component")
    assert data["gradient"].dims == ("x", "y", "z", "component", "direction")
    x, y, z = (axis[k] for axis, k in zip(field.info.grid.axes, (4, 1, 6), strict=True))
    node = data.sel(x=x, y=y, z=z, method="nearest")
    place = np.array([[x, y, z]])
    parts = list(zip(CURRENTS, dipoles.moments, dipoles.sources, strict=True))
    flux = sum(i * dipoles.field(m, s, place) for i, m, s in parts)[0]
    slope = sum(i * dipoles.gradient(m, s, place) for i, m, s in parts)[0]
    np.testing.assert_allclose(node["flux_density"], flux, rtol=1e-12)
    np.testing.assert_allclose(node["gradient"], slope, rtol=1e-11, atol=1e-13)
    along_x = node["gradient"].sel(component="z", direction="x")
    assert float(along_x) == pytest.approx(slope[2, 0], rel=1e-11)
    np.testing.assert_array_equal(data["current"], CURRENTS)


def test_coils_superpose_by_their_names(xarray, field):
    units, data = field.to_xarray(), field.to_xarray({"a": 1.5, "b": -0.5, "c": 2.0})
    assert list(units["coil"].values) == ["a", "b", "c"]
    for quantity in ("flux_density", "gradient"):
        summed = (units[f"unit_{quantity}"] * data["current"]).sum("coil")
        assert summed.dims == data[quantity].dims
        np.testing.assert_allclose(summed, data[quantity], rtol=1e-12, atol=1e-15)


def test_units_and_what_the_map_rests_on(xarray, field):
    units, data = field.to_xarray(), field.to_xarray(1.0)
    assert {axis: data[axis].attrs["units"] for axis in "xyz"} == dict.fromkeys("xyz", "m")
    assert (data["flux_density"].units, data["gradient"].units) == ("T", "T m-1")
    assert (units["unit_flux_density"].units, units["unit_gradient"].units) == ("T A-1", "T m-1 A-1")
    assert (data["current"].units, data["reference_current"].units) == ("A", "A")
    np.testing.assert_array_equal(data["reference_current"], [1.0, 2.0, 3.0])
    about = data.attrs
    assert (about["title"], about["device"], about["lookup"]) == ("three dipoles", "none", "hermite")
    assert about["assumptions"].splitlines() == ["no iron", "steady currents"]


@pytest.mark.parametrize("currents", [None, CURRENTS])
def test_through_plain_python_and_back(xarray, field, currents):
    data = field.to_xarray(currents)
    xarray.testing.assert_identical(xarray.Dataset.from_dict(data.to_dict()), data)


def test_a_map_made_of_it_gives_the_same_field_everywhere(xarray, field, dipoles):
    """Through a pandas table, which does not keep our order of nodes and components."""
    data = field.to_xarray()
    frames = {name: data[name].to_dataframe().sample(frac=1, random_state=0) for name in data.data_vars}
    again = {name: frame.to_xarray()[name] for name, frame in frames.items()}
    axes = [again["unit_gradient"][axis].values for axis in "xyz"]
    lower, step = [axis[0] for axis in axes], [np.diff(axis).mean() for axis in axes]
    order = ("coil", "x", "y", "z", "component", "direction")
    made = MapData(
        Grid(lower, step, tuple(len(axis) for axis in axes)),
        tuple(again["unit_flux_density"]["coil"].values),
        again["reference_current"].values,
        flux_density=again["unit_flux_density"].transpose(*order[:5]).values,
        gradient=again["unit_gradient"].transpose(*order).values,
    )
    points = dipoles.points(200)
    flux, slope = field.field_and_gradient(points, CURRENTS)
    read, steep = interpolate(made, kind="hermite").field_and_gradient(points, CURRENTS)
    np.testing.assert_allclose(read, flux, rtol=0, atol=1e-12 * np.abs(flux).max())
    np.testing.assert_allclose(steep, slope, rtol=0, atol=1e-11 * np.abs(slope).max())


def test_through_a_netcdf_file(xarray, field, tmp_path):
    pytest.importorskip("h5netcdf", reason='h5netcdf is not installed (pip install "fieldmap[studies]")')
    data = field.to_xarray(CURRENTS)
    data.to_netcdf(tmp_path / "map.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as read:
        xarray.testing.assert_identical(read.load(), data)


def test_the_certified_error_is_that_of_the_lookup(xarray, dipoles):
    from dataclasses import replace

    from fieldmap.store import FieldError

    bounded = replace(dipoles.map(6), error_bounds={"global": FieldError(1e-6, 2e-4)})
    data = interpolate(bounded, kind="global").to_xarray(1.0)
    assert data["flux_density"].attrs["certified_error"] == 1e-6
    assert data["gradient"].attrs["certified_error"] == 2e-4
    units = interpolate(bounded, kind="global").to_xarray()
    assert units["unit_flux_density"].attrs["certified_error"] == 1e-6
    assert units["unit_gradient"].attrs["certified_error"] == 2e-4
    assert "certified_error" not in interpolate(bounded).to_xarray(1.0)["flux_density"].attrs
    # The constant field has no certified error of its own.
    fixed = replace(
        bounded,
        coil_names=("a", "b"),
        reference_current=np.ones(2),
        fixed_sources=("magnet",),
        constant_field=True,
    )
    whole = interpolate(fixed, kind="global").to_xarray()
    assert list(whole.data_vars)[1:3] == ["constant_flux_density", "constant_gradient"]
    assert "certified_error" not in whole["constant_gradient"].attrs
    assert whole["constant_flux_density"].attrs["units"] == "T"
    assert whole["constant_gradient"].attrs["long_name"].endswith("with all currents off, of magnet")
    np.testing.assert_allclose(
        whole["constant_flux_density"], units["unit_flux_density"].sel(coil="c"), atol=1e-12
    )


def test_currents_that_do_not_fit(xarray, field):
    for wrong in ([1.0, 2.0], [1.0, 2.0, np.nan]):
        with pytest.raises(InputError):
            field.to_xarray(wrong)


def test_without_xarray_the_extra_is_named(field, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(FieldmapError) as caught:
        field.to_xarray()
    (problem,) = caught.value.problems
    assert problem.where == "FieldMap.to_xarray"
    assert 'pip install "fieldmap[xarray]"' in problem.remedy


def test_xarray_opens_a_map_file(xarray):
    """By the entry point of the installed package."""
    m = fieldmap.open_map(SAMPLE)
    units, data = (
        xarray.open_dataset(SAMPLE, engine="fieldmap", **given) for given in ({}, {"currents": 1.5})
    )
    assert units.identical(m.to_xarray())
    assert data.identical(m.to_xarray(1.5))
    hermite = xarray.open_dataset(SAMPLE, engine="fieldmap", kind="hermite", drop_variables="unit_gradient")
    assert hermite.attrs["lookup"] == "hermite"
    assert "unit_gradient" not in hermite
    with pytest.raises(FieldmapError):
        xarray.open_dataset(SAMPLE.with_name("nothing.h5"), engine="fieldmap")


def test_a_field_is_no_array(field):
    for made in (field, field.at(CURRENTS)):
        with pytest.raises(InputError):
            np.asarray(made)
