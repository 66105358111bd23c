"""One map for each variant of a study: equal to `generate`'s maps, with common parts solved once."""

import csv
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import xarray

import fieldmap as fm
from fieldmap.errors import InputError, StudyError
from fieldmap.iron.solvers import linear, shared
from fieldmap.maps import generate, generation, near_sources
from fieldmap.studies import generate_many, open_maps, read_study
from fieldmap.studies.many_maps import _Pieces
from fieldmap.studies.run import run_study
from tests.store.conftest import numbers_in

RECIPE = """
format = 1
title = "Below the sphere"
device = "sphere.toml"
spacing_mm = [4.0, 4.0, 2.0]
"""

# The iron varies fastest and the turns slowest, so consecutive maps share least.
STUDY = """
format = 1
title = "Spheres below a loop"
recipe = "sphere_map.toml"

[[vary]]
name = "turns"
key = "coil.loop.turns"
values = [100, 250]

[[vary]]
name = "floor"
key = "workspace.lower_mm.3"
values = [-24.0, -23.0]

[[vary]]
name = "radius"
key = "body.sphere.radius_mm"
values = [8.0, 6.0]

"""
NUMBERS = """
[[currents]]
name = "one"
amperes_A = 1.0

[record]
quantities = ["field"]
points_mm = [[0, 0, -14]]
"""


@pytest.fixture(scope="module")
def files(devices):
    devices.study("sphere_map.toml", RECIPE)
    return devices.folder / "sphere_map.toml", devices.study("spheres.toml", STUDY)


@pytest.fixture(scope="module")
def made(files, tmp_path_factory):
    """The maps, and how often each step of a solve ran."""
    places = {
        "check_geometry": generation,
        "distances_to_workspace": near_sources,
        "generate_mesh": linear,
        "assemble": linear,
        "solved_in_form": linear,
        "reaction_fields": linear,
    }
    counts = dict.fromkeys(places, 0)

    def counted(name):
        step = getattr(places[name], name)

        def counting(*arguments, **named):
            counts[name] += 1
            return step(*arguments, **named)

        return counting

    with pytest.MonkeyPatch.context() as patch:
        for name, module in places.items():
            patch.setattr(module, name, counted(name))
        # The smallest store that suffices for maps that differ in turns alone, if these are consecutive.
        patch.setattr(shared, "_MOST", 7)
        many = generate_many(*files, tmp_path_factory.mktemp("maps") / "spheres.nc")
    return many, counts


def places(many):
    """Keys of each variant and its map file."""
    for number, variant in enumerate(many.study.variants):
        yield dict(variant.settings), many.path.parent / many.data.map_file.values.flat[number]


def test_every_variant_is_the_map_of_its_device(made, files, tmp_path):
    many, _ = made
    for k, (settings, file) in enumerate(places(many)):
        alone = generate(files[0], tmp_path / f"{k}.h5", changes=settings)
        ours, theirs = numbers_in(file), numbers_in(alone)
        assert ours.keys() == theirs.keys()
        assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)
        before = file.stat().st_mtime_ns
        # `generate` accepts the file as a finished map.
        assert generate(files[0], file, changes=settings) == file
        assert file.stat().st_mtime_ns == before


def test_the_fields_are_those_of_spheres_in_closed_form(made, sphere_below_loop):
    for settings, file in places(made[0]):
        radius, turns = 1e-3 * settings["body.sphere.radius_mm"], settings["coil.loop.turns"]
        exact = turns * sphere_below_loop(0.014, radius, 1000.0)
        found = fm.open_map(file).field([0.0, 0.0, -0.014], [1.0])[2]
        assert found == pytest.approx(exact, rel=0.02)


def test_what_maps_share_is_solved_once(made):
    """Two spheres in two boxes each; also calls of the geometry kernel, which allocates memory at each call."""
    counts = {"assemble": 2, "solved_in_form": 2, "reaction_fields": 4}
    assert made[1] == {"check_geometry": 4, "distances_to_workspace": 4, "generate_mesh": 4} | counts


def test_the_index_names_map_keys_and_errors(made):
    many, _ = made
    with xarray.open_dataset(many.path, engine="h5netcdf") as index:
        assert index.map_file.dims == ("turns", "floor", "radius")
        assert index.radius.attrs["units"] == "mm"
        for turns, floor, radius in ((100, -24.0, 8.0), (250, -23.0, 6.0)):
            one = index.sel(turns=turns, floor=floor, radius=radius)
            opened = fm.open_map(many.path.parent / str(one.map_file.item()))
            bound = opened.info.error_bounds["harmonic"]
            assert one.certified_flux_density.item() == bound.flux_density
            assert one.certified_gradient.item() == bound.gradient
            assert np.isnan(one.current_flux_density)
            assert opened.lower[2] == pytest.approx(1e-3 * floor)
            assert one.lower.values.tolist() == opened.info.grid.lower.tolist()
            assert one.nodes.values.tolist() == list(opened.info.grid.shape)
    rows = list(csv.DictReader(many.table.read_text().splitlines()))
    assert len(rows) == 8
    assert (rows[1]["turns (1)"], rows[1]["floor (mm)"], rows[1]["radius (mm)"]) == ("100", "-24.0", "6.0")
    assert float(rows[1]["certified_flux_density (T)"]) == many.data.certified_flux_density.values[0, 0, 1]


def test_maps_are_read_when_they_are_asked_for(files, devices, tmp_path, monkeypatch):
    one_box = devices.study("one_box.toml", STUDY.replace("values = [-24.0, -23.0]", "values = [-24.0]"))
    many = generate_many(files[0], one_box, tmp_path / "one_box.nc")
    opened = []

    def counted(path):
        opened.append(path)
        return fm.open_map(path)

    monkeypatch.setattr("fieldmap.studies.opened_maps.open_map", counted)
    data = open_maps(many.path)
    assert data.unit_flux_density.dims == ("turns", "floor", "radius", "x", "y", "z", "coil", "component")
    del opened[:]
    chosen = data.sel(turns=250, radius=8.0).isel(floor=0, x=2, z=slice(1, 4))
    file = many.path.parent / str(chosen.map_file.item())
    b, slope = chosen.unit_flux_density.values, chosen.unit_gradient.values
    assert opened == [file]
    alone = fm.open_map(file).to_xarray().isel(x=2, z=slice(1, 4))
    np.testing.assert_array_equal(b, alone.unit_flux_density)
    np.testing.assert_array_equal(slope, alone.unit_gradient)
    along = data.unit_flux_density.isel(floor=0, x=2, y=2, z=-1, coil=0, component=2)
    np.testing.assert_allclose(along.sel(turns=250), 2.5 * along.sel(turns=100), rtol=1e-6)
    # Numbers of the study, merged with the maps.
    with_numbers = devices.study("numbers.toml", one_box.read_text() + NUMBERS)
    numbers = run_study(with_numbers, tmp_path / "numbers.nc").data[["flux_density"]]
    together = xarray.merge([data, numbers.sel(currents="one", point=0)], compat="override")
    at = {"floor": 0, "x": 2, "y": 2, "coil": 0}
    ours = together.unit_flux_density.isel(at).interp(z=-0.014, method="cubic")
    np.testing.assert_allclose(ours, together.flux_density.isel(floor=0), rtol=0.02, atol=1e-6)
    assert not fm.open_map(file).info.fixed_sources
    with pytest.raises(InputError, match="same nodes"):
        open_maps(generate_many(*files, tmp_path / "boxes.nc").path)


def test_a_variant_that_fails_is_recorded_and_tried_again(files, devices, tmp_path):
    # A sphere of 20 mm intersects the workspace.
    study = devices.study("large.toml", STUDY.replace("values = [8.0, 6.0]", "values = [8.0, 20.0]"))
    many = generate_many(files[0], study, tmp_path / "large.nc")
    assert len(many.failed) == 4
    assert all("radius = 20" in name for name in many.failed)
    assert (many.data.problem.sel(radius=20.0) != "").all()
    assert (many.data.problem.sel(radius=8.0) == "").all()
    assert many.data.certified_flux_density.sel(radius=20.0).isnull().all()
    assert len(list((tmp_path / "large").glob("*.h5"))) == 4


def test_parts_are_all_maps_and_the_index_comes_after_them(files, made, tmp_path):
    index = tmp_path / "parts.nc"
    for k in (1, 2, 3):
        assert generate_many(*files, index, part=(k, 3)) is None
        assert not index.exists()
    there = sorted((tmp_path / "parts").glob("*.h5"))
    before = [file.stat().st_mtime_ns for file in there]
    many = generate_many(*files, index)
    assert len(there) == 8
    assert [file.stat().st_mtime_ns for file in there] == before
    xarray.testing.assert_equal(many.data.drop_vars("map_file"), made[0].data.drop_vars("map_file"))
    with pytest.raises(InputError):
        generate_many(*files, index, part=(4, 3))


def test_the_device_is_that_of_the_recipe(files, devices, tmp_path):
    other = devices.study(
        "other.toml", STUDY.replace('recipe = "sphere_map.toml"', 'device = "thin_loop.toml"')
    )
    with pytest.raises(StudyError):
        generate_many(files[0], read_study(other), tmp_path / "other.nc")


def test_numbers_need_currents_and_maps_do_not(files, tmp_path):
    with pytest.raises(StudyError) as caught:
        run_study(files[1], tmp_path / "numbers.nc")
    assert caught.value.problems[0].where == f"{files[1]}: currents"
    assert not list(tmp_path.iterdir())


RUN = """
import os, signal, sys
from fieldmap.studies import generate_many

recipe, study, index, moment = sys.argv[1:]

def tell(text, share):
    print(text, flush=True)
    if moment and text.startswith(moment):
        os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    generate_many(recipe, study, index, progress=tell, workers=1 if moment else 2)
"""


def test_killed_twice_and_finished_by_two_workers(files, made, tmp_path):
    index = tmp_path / "killed.nc"
    for moment, kept in (("3 of 8", 3), ("5 of 8", 5), ("", 8)):
        arguments = [sys.executable, "-c", RUN, *map(str, files), str(index), moment]
        done = subprocess.run(
            arguments, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": "."}
        )
        assert done.returncode == (-signal.SIGKILL if moment else 0), done.stderr
        assert len(list((tmp_path / "killed").glob("*.h5"))) == kept
    with xarray.open_dataset(index, engine="h5netcdf") as data:
        xarray.testing.assert_equal(data.load().drop_vars("map_file"), made[0].data.drop_vars("map_file"))
    for file in (tmp_path / "killed").glob("*.h5"):
        ours, theirs = numbers_in(file), numbers_in(made[0].path.with_suffix("") / file.name)
        assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)


def test_maps_with_a_new_iron_are_expected_to_take_longer():
    """Two irons with three maps each, 8 s for the first map of an iron and 1 s for the next: after one of each kind the
    whole time is known."""
    pieces = _Pieces([True, False, False, True, False, False])
    wholes = []
    for index, seconds in enumerate([8.0, 1.0, 1.0, 8.0, 1.0, 1.0]):
        pieces.count(index, seconds)
        wholes.append(pieces.whole)
    assert wholes == [48.0, *[20.0] * 5]
    assert pieces.done == 20.0
