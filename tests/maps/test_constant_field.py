"""Maps with a field that no current drives: linear iron, magnet and background, against fresh solves and magpylib."""

import json
import pickle

import h5py
import magpylib
import numba
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import (
    Background,
    Body,
    Box,
    CircularCoil,
    Cylinder,
    Device,
    LinearMaterial,
    PermanentMagnet,
    WorkspaceBox,
    placed,
)
from fieldmap.dynamics.field_of_currents import sampled_field, superposed
from fieldmap.errors import Infeasible, InputError, MapFileError
from fieldmap.lookup import capability, field_actuation, gradient_actuation, wrench_actuation
from fieldmap.store import Grid, MapData, check_map, read_info, read_map, seal_map, write_map
from fieldmap.store.map_format import write_text
from tests.dynamics.machines import machine_in

LOWER, UPPER = np.array([-6e-3, -6e-3, -22e-3]), np.array([6e-3, 6e-3, -12e-3])
POINTS = np.random.default_rng(2).uniform(LOWER, UPPER, (30, 3))
CURRENTS = [3.0, -2.0]
KINDS = ["harmonic", "hermite", "global"]


def machine(background=True, iron=True, mu_r=1.05):
    bodies = [Body("magnet", "hard", Box((0.008, 0.006, 0.005)), 2e-3).moved([0.004, 0.0, 0.0])]
    if iron:
        bodies.append(Body("pole", "soft", Cylinder(0.004, 0.01), 2e-3).moved([-0.012, 0.0, 0.0]))
    coils = [
        CircularCoil(name, 0.006, 0.009, 0.006, 120.0, placement=placed([x, 0.0, 0.02]))
        for name, x in (("left", -0.012), ("right", 0.012))
    ]
    return Device(
        "machine",
        "A magnet, a pole and two coils in a background",
        coils=coils,
        bodies=bodies,
        materials={
            "hard": PermanentMagnet("hard", [0.2, 0.0, 0.9], mu_r),
            "soft": LinearMaterial("soft", 500.0),
        },
        background=Background([1e-3, 0.0, -2e-3], [0.02, 0.0, 0.01, -0.03, 0.0]) if background else None,
        workspace=WorkspaceBox(LOWER, UPPER),
    )


@pytest.fixture(scope="module")
def unit():
    return fm.solve_linear(machine())


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    target = tmp_path_factory.mktemp("map") / "machine.h5"
    return fm.generate(machine(), target, spacing=1.5e-3)


@pytest.fixture(scope="module", params=KINDS)
def opened(request, path):
    return fm.open_map(path, kind=request.param)


def within(opened, ours, theirs, gradient=False):
    """Within the certified bound, or, for the Hermite form, within a share that the spacing gives."""
    bound = opened.error_bound
    if bound is None:
        return np.abs(ours - theirs).max() < 5e-3 * np.abs(theirs).max()
    off = np.linalg.norm((ours - theirs).reshape(len(ours), -1), axis=1).max()
    share = max(1.0, *np.abs(CURRENTS))
    return off <= share * (bound.gradient if gradient else bound.flux_density)


@pytest.mark.parametrize("currents", [CURRENTS, [0.0, 0.0]])
def test_fields_are_those_of_a_fresh_solve_within_the_bound(opened, unit, currents):
    assert within(opened, opened.field(POINTS, currents), unit.field(POINTS, currents))
    assert within(opened, opened.gradient(POINTS, currents), unit.gradient(POINTS, currents), True)
    assert np.abs(unit.constant_field(POINTS)).max() > 1e-3


def test_all_ways_to_look_a_field_up_agree(opened):
    whole, slopes = opened.field_and_gradient(POINTS, CURRENTS)
    size = np.abs(whole).max()
    fixed = opened.at(CURRENTS)
    rows = np.tile(CURRENTS, (len(POINTS), 1))
    one = np.array([opened.field(point, np.array(CURRENTS)) for point in POINTS])
    by_name = opened.field(POINTS, {"left": 3.0, "right": -2.0})
    superposed_sum = opened.unit_field(POINTS).swapaxes(1, 2) @ CURRENTS + opened.constant_field(POINTS)
    for other in (fixed.field(POINTS), opened.field(POINTS, rows), one, by_name, superposed_sum):
        assert other == pytest.approx(whole, abs=1e-12 * size)
    slope_sum = np.moveaxis(opened.unit_gradient(POINTS), 1, -1) @ CURRENTS + opened.constant_gradient(POINTS)
    assert slope_sum == pytest.approx(slopes, abs=1e-12 * np.abs(slopes).max())
    off = opened.at(0.0)
    assert opened.constant_field(POINTS) == pytest.approx(off.field(POINTS), abs=1e-15)
    second = opened.second_gradient(POINTS, CURRENTS)
    assert second == pytest.approx(fixed.second_gradient(POINTS), abs=1e-12 * np.abs(second).max())
    potential = opened.potential(POINTS, CURRENTS)
    assert potential == pytest.approx(fixed.potential(POINTS), abs=1e-12 * np.abs(potential).max())
    again = pickle.loads(pickle.dumps(opened))
    assert np.array_equal(again.field(POINTS, CURRENTS), whole)


@numba.njit
def both(function, data, at, fixed, currents, x, y, z):
    return function(data, currents, x, y, z), at(fixed, x, y, z)


def test_compiled_lookups_take_the_currents_of_the_coils(opened):
    x, y, z = POINTS[0]
    pairs = *opened.compiled(), *opened.at(CURRENTS).compiled()
    free, bound = both(*pairs, np.array(CURRENTS), x, y, z)
    flux, slope = opened.field_and_gradient(POINTS[0], CURRENTS)
    for found in (free, bound):
        assert np.array(found[0]) == pytest.approx(flux, rel=1e-12)
        assert np.array(found[1]) == pytest.approx(slope, rel=1e-11, abs=1e-12 * np.abs(slope).max())


def test_it_is_affine_and_says_so(path):
    m = fm.open_map(path)
    assert (m.proportional, m.affine) == (False, True)
    assert m.fixed_sources == ("magnet", "background")
    assert m.coil_names == ("left", "right")
    for wrong in ([1.0, 2.0, 1.0], [1.0]):
        with pytest.raises(InputError):
            m.field(POINTS, wrong)
        with pytest.raises(InputError):
            m.field_and_gradient(POINTS[0], np.array(wrong))


def test_the_magnet_alone_is_that_of_magpylib(tmp_path):
    """At mu_r = 1 a magnet is its remanence."""
    device = machine(background=False, iron=False, mu_r=1.0)
    m = fm.open_map(fm.generate(device, tmp_path / "magnet.h5", spacing=2e-3))
    block = magpylib.magnet.Cuboid((0.004, 0.0, 0.0025), None, (0.008, 0.006, 0.005), (0.2, 0.0, 0.9))
    exact = block.getB(POINTS)
    assert np.abs(m.field(POINTS, 0.0) - exact).max() < 2e-3 * np.abs(exact).max()
    coil = fm.solve_linear(device).unit_field(POINTS)
    assert m.unit_field(POINTS) == pytest.approx(coil, abs=1e-4 * np.abs(coil).max())


def test_currents_compensate_the_constant_field(opened):
    place, moment = np.array([1e-3, -1e-3, -18e-3]), np.array([0.0, 0.0, 0.2])
    nothing = opened.currents_for(place, field=[np.nan, np.nan, 0.0])
    assert abs(opened.field(place, nothing)[2]) < 1e-12 * np.abs(opened.constant_field(place)).max()
    assert np.abs(nothing).max() > 0.1
    wanted = np.array([np.nan, np.nan, 2e-3])
    lift = opened.currents_for(place, force=wanted, moment=moment)
    assert opened.wrench(place, moment, lift)[2] == pytest.approx(2e-3, rel=1e-9)
    # A demand that the constant field meets costs no current.
    free = opened.wrench(place, moment, 0.0)
    assert np.array_equal(opened.currents_for(place, torque=free[3:], moment=moment), [0.0, 0.0])
    with pytest.raises(Infeasible) as error:
        opened.currents_for(place, force=[np.nan, np.nan, 0.05], moment=moment, limits=0.5)
    share = error.value.share
    assert share is None or 0.0 < share < 1.0
    if share is not None:
        # Exactly this share is feasible.
        some = opened.currents_for(
            place, force=[np.nan, np.nan, 0.05 * share * 0.999], moment=moment, limits=0.5
        )
        assert np.abs(some).max() <= 0.5 + 1e-9
        with pytest.raises(Infeasible):
            opened.currents_for(
                place, force=[np.nan, np.nan, 0.05 * share * 1.001], moment=moment, limits=0.5
            )


def test_what_is_nearest_counts_the_constant_field(path):
    m = fm.open_map(path)
    place = [1e-3, -1e-3, -18e-3]
    with pytest.raises(Infeasible) as error:
        m.currents_for(place, field=[0.0, 0.0, 0.0])
    matrix, constant = m.unit_field(place).T, m.constant_field(place)
    best = constant - matrix @ np.linalg.lstsq(matrix, constant, rcond=None)[0]
    assert error.value.reachable == pytest.approx(best, rel=1e-9)


def test_actuation_is_matrix_and_constant(opened):
    place, moment = np.array([1e-3, -1e-3, -18e-3]), np.array([0.1, 0.0, 0.2])
    field = field_actuation(opened, place)
    assert field.matrix @ CURRENTS + field.constant == pytest.approx(opened.field(place, CURRENTS), rel=1e-12)
    both = gradient_actuation(opened, place)
    slope = opened.gradient(place, CURRENTS)
    five = slope[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]
    assert (both.matrix @ CURRENTS + both.constant)[3:] == pytest.approx(
        five, rel=1e-11, abs=1e-12 * np.abs(slope).max()
    )
    wrench = wrench_actuation(opened, place, moment)
    expected = opened.wrench(place, moment, CURRENTS)
    assert wrench.matrix @ CURRENTS + wrench.constant == pytest.approx(
        expected, rel=1e-11, abs=1e-12 * np.abs(expected).max()
    )
    up = np.array([[0.0, 0.0, 1.0]])
    force, torque = capability(opened, place[None], moment, up, 2.0)
    corners = [[a, b] for a in (-2.0, 2.0) for b in (-2.0, 2.0)]
    values = np.array([opened.wrench(place, moment, i) for i in corners])
    assert force[0, 0] == pytest.approx(values[:, 2].max(), rel=1e-9)
    assert torque[0, 0] == pytest.approx(values[:, 5].max(), rel=1e-9)
    assert wrench.largest(np.eye(6)[2:3], 2.0)[0] == pytest.approx(values[:, 2].max(), rel=1e-9)


def test_a_solution_is_sampled_with_its_constant_field(unit, path):
    sampled = sampled_field(unit, 1.5e-3)
    m = fm.open_map(path)
    assert sampled.affine
    assert not sampled.proportional
    assert sampled.field(POINTS, CURRENTS) == pytest.approx(m.field(POINTS, CURRENTS), rel=1e-6, abs=1e-9)


def test_compiled_loops_give_the_constant_field_weight_1(path):
    field = superposed(fm.open_map(path), scale=1.5)
    machine = machine_in(field, 2)
    assert machine.follow(np.array(CURRENTS))
    assert machine.weights.tolist() == [4.5, -3.0, 1.5]


def test_data_set_has_the_constant_field(path):
    pytest.importorskip("xarray")
    m = fm.open_map(path)
    data = m.to_xarray()
    nodes = m.info.grid.points()
    off = m.field(np.clip(nodes, m.lower, m.upper), 0.0).reshape(*m.info.grid.shape, 3)
    assert data.constant_flux_density.values == pytest.approx(off, abs=1e-15)
    assert data.sizes["coil"] == 2
    assert "constant_flux_density" not in m.to_xarray(CURRENTS)


def test_file_is_checked_and_refused_by_readers_of_before(path, tmp_path):
    found = check_map(path)
    assert found.info.fixed_sources == ("magnet", "background")
    assert found.info.field_names[-1] == "no current"
    with h5py.File(path) as file:
        # A reader of format 1 checks this first.
        assert file["/fieldmap"].attrs["format_version"] == 2
        assert file["/ExternalFieldPath/3"].attrs["masterParameter"] == b"none"
        total = file["/data/0/meshes/B/z"][()]
        parts = [file[f"/data/0/meshes/B_{name}/z"][()] for name in ("left", "right", "no_current")]
    assert total == pytest.approx(sum(parts), abs=1e-15)
    data = read_map(path)
    again = write_map(tmp_path / "again.h5", data)
    assert np.array_equal(read_map(again).flux_density, data.flux_density)


def changed_header(path, target, **changes):
    target.write_bytes(path.read_bytes())
    with h5py.File(target, "r+") as file:
        header = json.loads(bytes(file["/fieldmap/header"][()]))
        version = changes.pop("attribute", None)
        header |= changes
        write_text(file, "header", json.dumps({key: v for key, v in header.items() if v is not None}))
        if version is not None:
            file["/fieldmap"].attrs["format_version"] = version
    seal_map(target)
    return target


@pytest.mark.parametrize(
    "changes",
    [
        {"attribute": 1},
        {"format": 1},
        {"attribute": 1, "format": 1},
        {"constant_field": False},
        {"constant_field": 1},
        {"constant_field": None},
        {"fixed_sources": []},
        {"fixed_sources": None, "constant_field": None},
        {"fixed_sources": None, "constant_field": None, "attribute": 1, "format": 1},
        {"attribute": 3},
    ],
)
def test_a_file_that_contradicts_itself_is_refused(path, tmp_path, changes):
    broken = changed_header(path, tmp_path / "broken.h5", **changes)
    for read in (read_info, read_map, check_map, fm.open_map):
        with pytest.raises(MapFileError):
            read(broken)


def test_a_map_of_coils_alone_is_of_the_first_format(tmp_path):
    device = machine().replace(bodies=[], background=None, materials={})
    made = fm.generate(device, tmp_path / "coils.h5", spacing=3e-3)
    with h5py.File(made) as file:
        assert file["/fieldmap"].attrs["format_version"] == 1
        header = json.loads(bytes(file["/fieldmap/header"][()]))
    assert header["format"] == 1
    assert not {"fixed_sources", "constant_field"} & set(header)
    assert fm.open_map(made).proportional


def test_constant_data_need_a_name_of_what_makes_them():
    one = {
        "grid": Grid([0, 0, 0], [0.01, 0.01, 0.01], (3, 3, 3)),
        "coil_names": (),
        "reference_current": np.zeros(0),
        "fixed_sources": ("background",),
        "constant_field": True,
        "flux_density": np.ones((1, 3, 3, 3, 3)),
        "gradient": np.zeros((1, 3, 3, 3, 3, 3)),
    }
    with pytest.raises(InputError):
        MapData(**{**one, "fixed_sources": ()})
    assert MapData(**one).reference_weights.tolist() == [1.0]


@pytest.mark.parametrize("name", ["sphere_in_field", "shell_in_field"])
def test_maps_of_the_shipped_devices_agree_with_their_closed_forms(name, tmp_path):
    """A device without coils has a map, too."""
    device = fm.read_device(name)
    m = fm.open_map(fm.generate(device, tmp_path / "map.h5", spacing=2e-3))
    at = [reference for reference in device.references if "/" not in reference.quantity]
    size = max(abs(reference.value) for reference in at)
    for reference in at:
        value = m.field(reference.at, [])["xyz".index(reference.quantity[1])]
        assert abs(value - reference.value) < 2e-4 * size
