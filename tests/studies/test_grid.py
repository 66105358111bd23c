"""A 2 x 2 study against direct solves of device files written by hand, a closed form, and scaling; its files."""

import csv

import numpy as np
import pytest
import xarray

import fieldmap as fm
from fieldmap.iron.error import estimate_error, workspace_surface
from fieldmap.studies import read_study, run_study


@pytest.fixture(scope="module")
def run(grid, tmp_path_factory):
    return run_study(grid, tmp_path_factory.mktemp("grid") / "grid.nc")


def test_every_variant_is_a_device_file_of_its_own(run, devices):
    """Against the same keys changed by hand, read and solved directly, at two opposite corners of the grid."""
    text = devices.sphere.read_text()
    for turns, radius in ((100, 10.0), (250, 8.0)):
        by_hand = text.replace("turns = 100", f"turns = {turns}")
        unit = fm.solve_linear(fm.read_device(by_hand.replace("radius_mm = 10.0", f"radius_mm = {radius}")))
        at = run.data.sel(turns=turns, radius=radius, currents="one")
        points = [[0, 0, -0.014], [0.003, 0, -0.02]]
        np.testing.assert_array_equal(at.flux_density, unit.field(points, [1.0]))
        np.testing.assert_array_equal(at.gradient, unit.gradient(points, [1.0]))


def test_the_field_is_that_of_the_closed_form(run, sphere_below_loop):
    """Against the Legendre series of a permeable sphere below a loop; the tests use a coarse mesh."""
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
    # Another process may sum in another order; both residuals are far below this bound.
    np.testing.assert_allclose(at.flux_density[0], state.field([0, 0, -0.014]), rtol=0, atol=1e-9)
    assert float(at.largest_flux_density) == pytest.approx(state.report.largest_flux_density, rel=1e-8)
    assert float(at.error_flux_density) == pytest.approx(state.report.error.flux_density, rel=1e-6)
    soft, hard = run.data.flux_density.sel(component="z").values.ravel()
    air, linear = (100 * 300 * sphere_below_loop(0.014, radius=0.01, mu_r=mu_r) for mu_r in (1.0, 1000.0))
    assert air < soft < hard < linear


def test_names_of_shipped_studies():
    study = read_study("pole_disk")
    assert len(study.variants) == 12
    # The variant with the unit's own values is the unchanged unit.
    same, thick = study.variants[study.shape[1] + 1 : study.shape[1] + 3]
    assert thick.name == "radius = 66, thickness = 12"
    device = thick.document.data
    assert device["body"][0]["height_mm"] == 12.0
    # All parts on the disk moved up by 6 mm, and the yoke's leg grew by 6 mm.
    plain = study.device_document.data
    assert same.document.data == plain
    lifted, as_they_were = ([*of["body"][1:9], *of["coil"]] for of in (device, plain))
    for now, before in zip(lifted, as_they_were, strict=True):
        assert now["position_mm"][2] == before["position_mm"][2] + 6.0
    parts, as_it_was = device["body"][9]["part"], plain["body"][9]["part"]
    tops = [part["position_mm"][2] + part["size_mm"][2] for part in parts[:3]]
    assert tops == [part["position_mm"][2] + part["size_mm"][2] + 6.0 for part in as_it_was[:3]]
    assert parts[2]["position_mm"] == as_it_was[2]["position_mm"]


def test_rows_and_words_of_a_run(run):
    """Every number of the data set by variant, also as plain Python; the settings of iron and record."""
    rows = run.rows()
    assert [row.settings for row in rows] == [
        {"turns": t, "radius": r} for t in (100, 250) for r in (8.0, 10.0)
    ]
    for row, told in zip(rows, run.to_dict()["rows"], strict=True):
        at = run.data.sel(**row.settings, currents="one")
        assert (row.currents, row.problem) == (told["currents"], told["problem"]) == ("one", "")
        assert {name: told[name] for name in row.settings} == row.settings
        assert (
            set(row.numbers)
            == set(told) - {*row.settings, "currents", "problem"}
            == {
                *("common_current", "current", "flux_density", "gradient"),
                *("largest_flux_density", "body_flux_density"),
            }
        )
        for name, numbers in row.numbers.items():
            np.testing.assert_array_equal(numbers, at[name])
            np.testing.assert_array_equal(told[name], at[name])
    assert (run.to_dict()["title"], run.to_dict()["failed"], run.failed) == ("Turns and radius", {}, {})
    about = run.data.attrs
    assert (about["title"], about["Conventions"], about["force_share"]) == (
        "Turns and radius",
        "CF-1.10",
        "0.01",
    )
    assert about["current_limit_A"] == "none"
    assert about["fingerprint"] == run.study.fingerprint
    # No set of currents carries a payload here.
    assert "payload" not in about["assumptions"]
    assert "copper" not in about["assumptions"]
    for name, axis in (("coil", "loop"), ("body", "sphere")):
        assert run.data[name].values.tolist() == [axis]
    np.testing.assert_allclose([run.data[f"point_{a}"] for a in "xyz"], [[0, 0.003], [0, 0], [-0.014, -0.02]])
    largest = run.data.body_flux_density.sel(body="sphere")
    np.testing.assert_array_equal(largest, run.data.largest_flux_density)


def test_the_error_of_linear_iron_is_that_of_a_coarser_mesh(devices, tmp_path):
    """Against mesh sizes 1.4 times as large, and the other formulation."""
    text = """
    format = 1
    title = "Errors"
    device = "sphere.toml"
    iron = { refinement = 0.8, mu_r = 50.0 }
    variant = [{ name = "as it is", set = { "coil.loop.turns" = 100 } }]
    currents = [{ name = "one", amperes_A = 1.0 }]
    record = { quantities = ["error"] }
    """
    run = run_study(devices.study("errors.toml", text), tmp_path / "errors.nc")
    device = fm.read_device(devices.sphere)
    fine = fm.solve_linear(device, 50.0, refinement=0.8)
    coarse = fm.solve_linear(device, 50.0, refinement=0.8 / 1.4, form=fine.report.form)
    other = (
        fm.solve_linear(device, 50.0, refinement=0.8, form="flux")
        if fine.report.form == "potential"
        else None
    )
    error = estimate_error(workspace_surface(device), fine, coarse, other)
    at = run.data.isel(variant=0, currents=0)
    assert float(at.error_flux_density) == pytest.approx(error.flux_density, rel=1e-6)
    assert float(at.error_gradient) == pytest.approx(error.gradient, rel=1e-6)
    assert float(at.surface_faces) == fine.report.surface_faces
    assert run.rows()[0].settings == {"variant": "as it is"}
    head, row = (line.split(",") for line in run.table.read_text().splitlines())
    assert head == [
        "variant",
        "currents",
        "error_flux_density (1)",
        "error_gradient (1)",
        "surface_faces (1)",
        "problem",
    ]
    assert (row[:2], float(row[2]), row[-1]) == (["as it is", "one"], float(at.error_flux_density), "")
