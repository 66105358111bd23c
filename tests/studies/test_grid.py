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
        by_hand = text.replace("turns = 100", f"turns = {turns}")
        unit = fm.solve_linear(fm.read_device(by_hand.replace("radius_mm = 10.0", f"radius_mm = {radius}")))
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
    for name in ("flux_density", "largest_flux_density"):
        few, many = (run.data[name].sel(turns=turns).values for turns in (100, 250))
        np.testing.assert_allclose(many, 2.5 * few, rtol=1e-9, atol=1e-9 * np.abs(few).max())


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
            turns, radius = float(row["turns (1)"]), float(row["radius (mm)"])
            at = data.sel(turns=turns, radius=radius, currents=row["currents"])
            numbers = {
                "flux_density 2 x (T)": at.flux_density.sel(component="x")[1],
                "gradient 1 z x (T m-1)": at.gradient.sel(component="z", direction="x")[0],
                "current loop (A)": at.current.sel(coil="loop"),
                "largest_flux_density (T)": at.largest_flux_density,
            }
            assert {name: float(row[name]) for name in numbers} == {
                name: float(v) for name, v in numbers.items()
            }
            assert (float(row["current loop (A)"]), row["problem"]) == (1.0, "")


@pytest.mark.filterwarnings("ignore::fieldmap.errors.UnusualValueWarning")
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
    soft = fm.read_device(devices.sphere.read_text().replace("polarisation_T = 1.5", "polarisation_T = 0.6"))
    state = fm.solve(soft, [300.0], refinement=0.6, estimate=True)
    at = run.data.sel(variant="soft", currents="strong")
    # Another process may sum in another order: both solve to a residual far below this bound.
    np.testing.assert_allclose(at.flux_density[0], state.field([0, 0, -0.014]), rtol=0, atol=1e-9)
    assert float(at.largest_flux_density) == pytest.approx(state.report.largest_flux_density, rel=1e-8)
    assert float(at.error_flux_density) == pytest.approx(state.report.error.flux_density, rel=1e-6)
    soft, hard = run.data.flux_density.sel(component="z").values.ravel()
    air, linear = (100 * 300 * sphere_below_loop(0.014, radius=0.01, mu_r=mu_r) for mu_r in (1.0, 1000.0))
    assert air < soft < hard < linear


def test_names_of_shipped_studies():
    study = read_study("pole_disk")
    assert len(study.variants) == 12
    # The unit as it is stands in the grid unchanged.
    same, thick = study.variants[study.shape[1] + 1 : study.shape[1] + 3]
    assert thick.name == "radius = 66, thickness = 12"
    device = thick.document.data
    assert device["body"][0]["height_mm"] == 12.0
    # Everything on the disk has moved up by 6 mm, the yoke's leg has grown by that.
    plain = study.device_document.data
    assert same.document.data == plain
    lifted, as_they_were = ([*of["body"][1:9], *of["coil"]] for of in (device, plain))
    for now, before in zip(lifted, as_they_were, strict=True):
        assert now["position_mm"][2] == before["position_mm"][2] + 6.0
    parts, as_it_was = device["body"][9]["part"], plain["body"][9]["part"]
    tops = [part["position_mm"][2] + part["size_mm"][2] for part in parts[:3]]
    assert tops == [part["position_mm"][2] + part["size_mm"][2] + 6.0 for part in as_it_was[:3]]
    assert parts[2]["position_mm"] == as_it_was[2]["position_mm"]
