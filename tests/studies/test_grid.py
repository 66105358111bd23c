"""A 2 x 2 study against direct solves of device files written by hand, a closed form, and scaling; its files."""

import csv

import numpy as np
import pytest
import xarray

import fieldmap as fm
from fieldmap.studies import read_study, run_study


@pytest.fixture(scope="module")
def run(grid, tmp_path_factory):
    return run_study(grid, tmp_path_factory.mktemp("grid") / "grid.nc")


def test_every_variant_is_a_device_file_of_its_own(run, devices):
    """The same keys changed by hand, read and solved directly, at two opposite corners of the grid."""
    text = devices.sphere.read_text()
    for turns, radius in ((100, 10.0), (250, 8.0)):
        path = devices.folder / f"by_hand_{turns}_{radius}.toml"
        path.write_text(
            text.replace("turns = 100", f"turns = {turns}").replace(
                "radius_mm = 10.0", f"radius_mm = {radius}"
            )
        )
        unit = fm.solve_linear(fm.read_device(path))
        at = run.data.sel(turns=turns, radius=radius, currents="one")
        points = [[0, 0, -0.014], [0.003, 0, -0.02]]
        np.testing.assert_array_equal(at.flux_density, unit.field(points, [1.0]))
        np.testing.assert_array_equal(at.gradient, unit.gradient(points, [1.0]))


def test_the_field_is_that_of_the_closed_form(run, sphere_below_loop):
    """Legendre series of a permeable sphere below a loop; the mesh of the tests is coarse."""
    for radius in (8.0, 10.0):
        for turns in (100, 250):
            exact = turns * sphere_below_loop(0.014, radius=1e-3 * radius, mu_r=1000.0)
            ours = float(run.data.flux_density.sel(turns=turns, radius=radius, component="z")[0, 0])
            assert ours == pytest.approx(exact, rel=4e-3)


def test_field_is_proportional_to_turns(run):
    few, many = (run.data.flux_density.sel(turns=turns).values for turns in (100, 250))
    np.testing.assert_allclose(many, 2.5 * few, rtol=1e-9, atol=1e-9 * np.abs(few).max())
    inside = run.data.largest_flux_density.values
    np.testing.assert_allclose(inside[1], 2.5 * inside[0], rtol=1e-9)


def test_units_and_coordinates_are_in_the_file(run):
    with xarray.open_dataset(run.path, engine="h5netcdf") as opened:
        assert opened.sizes["turns"] == opened.sizes["radius"] == 2
        assert opened.radius.attrs == {"long_name": "body.sphere.radius_mm", "units": "mm"}
        assert opened.flux_density.attrs["units"] == "T"
        assert opened.gradient.dims == ("turns", "radius", "currents", "point", "component", "direction")
        assert opened.point_z.attrs["units"] == "m"
        np.testing.assert_allclose(opened.point_z, [-0.014, -0.02])
        assert opened.currents.values.tolist() == ["one"]
        assert (opened.problem == "").all()
        assert opened.study_file.item() == run.study.text
        assert opened.device_file.item() == (run.study.path.parent / "sphere.toml").read_text()
        assert "mu_r = 1000" in opened.attrs["assumptions"]
        for name in run.data.data_vars:
            np.testing.assert_array_equal(opened[name].values, run.data[name].values)


def test_csv_and_netcdf_agree(run):
    with run.table.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 4
    with xarray.open_dataset(run.path, engine="h5netcdf") as data:
        for row in rows:
            at = data.sel(
                turns=float(row["turns (1)"]), radius=float(row["radius (mm)"]), currents=row["currents"]
            )
            assert float(row["flux_density 2 x (T)"]) == float(at.flux_density.sel(component="x")[1])
            assert float(row["gradient 1 z x (T m-1)"]) == float(
                at.gradient.sel(component="z", direction="x")[0]
            )
            assert float(row["current loop (A)"]) == float(at.current.sel(coil="loop")) == 1.0
            assert float(row["largest_flux_density (T)"]) == float(at.largest_flux_density)
            assert row["problem"] == ""


def test_saturating_iron_is_that_of_a_direct_solve(devices, tmp_path, sphere_below_loop):
    text = """
    format = 1
    title = "A strong loop"
    device = "sphere.toml"
    iron = { model = "saturating", refinement = 0.6 }
    variant = [{ name = "soft", set = { "material.iron.saturation_polarisation_T" = 0.6 } },
               { name = "hard", set = { "material.iron.saturation_polarisation_T" = 1.2 } }]
    currents = [{ name = "strong", amperes_A = 300.0 }]
    record = { quantities = ["field", "iron", "error"], points_mm = [[0, 0, -14]] }
    """
    run = run_study(devices.study("saturating.toml", text), tmp_path / "saturating.nc")
    assert run.data.sizes["variant"] == 2
    path = devices.folder / "soft.toml"
    path.write_text(devices.sphere.read_text().replace("polarisation_T = 1.5", "polarisation_T = 0.6"))
    state = fm.solve(fm.read_device(path), [300.0], refinement=0.6, estimate=True)
    at = run.data.sel(variant="soft", currents="strong")
    # Another process may sum in another order: both solve to a residual far below this bound.
    np.testing.assert_allclose(at.flux_density[0], state.field([0, 0, -0.014]), rtol=0, atol=1e-9)
    assert float(at.largest_flux_density) == pytest.approx(state.report.largest_flux_density, rel=1e-8)
    assert float(at.error_flux_density) == pytest.approx(state.report.error.flux_density, rel=1e-6)
    flux = run.data.flux_density.sel(component="z").values.ravel()
    air = 100 * 300 * sphere_below_loop(0.014, radius=0.01, mu_r=1.0)
    linear = 100 * 300 * sphere_below_loop(0.014, radius=0.01, mu_r=1000.0)
    assert air < flux[0] < flux[1] < linear


def test_names_of_shipped_studies():
    study = read_study("pole_disk")
    assert len(study.variants) == 12
    thick = study.variants[study.shape[1] * 1 + 2]
    assert thick.name == "radius = 66, thickness = 12"
    device = thick.document.data
    assert device["body"][0]["height_mm"] == 12.0
    # Everything on the disk has moved up by 6 mm, the yoke's leg has grown by that.
    plain = study.device_document.data
    for now, before in zip(device["body"][1:9], plain["body"][1:9], strict=True):
        assert now["position_mm"][2] == before["position_mm"][2] + 6.0
    for now, before in zip(device["coil"], plain["coil"], strict=True):
        assert now["position_mm"][2] == before["position_mm"][2] + 6.0
    parts, as_it_was = device["body"][9]["part"], plain["body"][9]["part"]
    tops = [part["position_mm"][2] + part["size_mm"][2] for part in parts[:3]]
    assert tops == [part["position_mm"][2] + part["size_mm"][2] + 6.0 for part in as_it_was[:3]]
    assert parts[2]["position_mm"] == as_it_was[2]["position_mm"]
    # The unit as it is stands in the grid unchanged.
    same = study.variants[study.shape[1] * 1 + 1]
    assert same.document.data == plain
