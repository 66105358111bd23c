"""Manners of data objects and results: one line as text, plain Python, pickles, copies, points of any shape."""

import copy
import json
import pickle
import re
from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.field import as_field
from fieldmap.levitation import find_equilibrium
from fieldmap.records import LONGEST, FrozenDict
from fieldmap.shipped import shipped_names
from fieldmap.sources import CoilSet

DEVICES = [name for name in shipped_names("geometry") if not name.startswith("planar")]


@cache
def coils():
    return CoilSet(fm.read_device("disk_six_cores").coils)


def same(one, other):
    """Equal to the last bit, all the way down."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
@pytest.mark.parametrize("name", DEVICES)
def test_devices_survive_pickles_and_copies(name, again):
    device = fm.read_device(name)
    other = again(device)
    assert other is not device
    assert same(other, device)
    with pytest.raises(TypeError):
        other.materials["steel"] = None


@pytest.mark.parametrize("name", DEVICES)
def test_text_of_devices_is_one_short_line(name):
    device = fm.read_device(name)
    parts = (device, *device.coils, *device.bodies, *device.materials.values(), device.payload)
    for text in map(repr, parts):
        assert len(text) <= LONGEST
        assert "\n" not in text
    assert name in repr(device)
    plain = json.loads(json.dumps(device.to_dict()))
    assert [coil["turns"] for coil in plain["coils"]] == [coil.turns for coil in device.coils]
    assert all(coil in device._repr_html_() for coil in device.coil_names)


@pytest.mark.parametrize("name", ["eight_coils", "drive_unit"])
def test_the_picture_of_a_device_fits_its_frame(name):
    """Every corner lies in its view, and the views touch their margins: one scale for both."""
    device = fm.read_device(name)
    html = device._repr_html_()
    outlines = re.findall(r"points='([^']*)'", html)
    solids = sum(part.operation == "add" for body in device.bodies for part in body.parts)
    assert len(outlines) == 2 * (solids + len(device.coils))
    corners = [np.array([pair.split(",") for pair in one.split()], float) for one in outlines]
    views = corners[: len(corners) // 2], corners[len(corners) // 2 :]
    for number, view in enumerate(views):
        every = np.concatenate(view) - [220.0 * number, 0.0]
        assert every.min() >= 5.9
        assert every.max() <= 214.1
    assert max(np.ptp(np.concatenate(view), axis=0).max() for view in views) == pytest.approx(208.0, abs=0.3)


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_a_solution_an_equilibrium_and_its_report(again):
    unit = fm.solve_linear(fm.read_device("loop_and_sphere"), refinement=0.5)
    point = [0.0, 0.0, -0.02]
    box = np.array([-0.02, -0.02, -0.14]), np.array([0.02, 0.02, -0.02])
    payload = fm.read_device("disk_six_cores").payload
    e = find_equilibrium(as_field(coils(), box), 12.0, payload)
    assert np.array_equal(again(unit).field(point, 1.0), unit.field(point, 1.0))
    assert np.array_equal(again(unit.at(1.0)).gradient(point), unit.at(1.0).gradient(point))
    assert np.array_equal(again(e).stiffness, e.stiffness)
    for one in (unit, unit.at(1.0), unit.report, unit.mesh, unit.state, e, e.report):
        assert len(repr(one)) <= LONGEST
        assert "\n" not in repr(one)
    assert "unknowns" in unit._repr_html_()
    assert "<table>" in unit.at(1.0)._repr_html_()
    for one in (unit.report, e, e.report):
        assert json.loads(json.dumps(one.to_dict()))


def test_a_frozen_dict_does_not_change():
    frozen = FrozenDict(a=1)
    for change in (lambda: frozen.update(b=2), lambda: frozen.pop("a"), frozen.clear):
        with pytest.raises(TypeError):
            change()
    assert frozen == {"a": 1}


POINTS = np.random.default_rng(1).uniform(-0.02, 0.02, (4, 5, 3)) - [0.0, 0.0, 0.1]


@pytest.mark.parametrize("what", ["field", "gradient", "second_gradient", "unit_field", "unit_gradient"])
def test_points_of_any_leading_shape(what):
    field = coils()
    given = () if what.startswith("unit") else ({"1": 1.5},)
    flat = getattr(field, what)(POINTS.reshape(-1, 3), *given)
    for points in (POINTS, POINTS.tolist()):
        found = getattr(field, what)(points, *given)
        assert found.shape == (4, 5, *flat.shape[1:])
        assert np.array_equal(found.reshape(flat.shape), flat)
    if given:
        assert np.array_equal(getattr(field.at(*given), what)(POINTS), found)


def test_currents_and_moments_for_every_point_of_a_grid():
    field = coils()
    currents = np.random.default_rng(2).normal(size=(4, 5, 6))
    moments = np.random.default_rng(3).normal(size=(4, 5, 3))
    found = field.wrench(POINTS, moments, currents)
    assert found.shape == (4, 5, 6)
    one = field.wrench(POINTS[2, 3], moments[2, 3], currents[2, 3])
    assert found[2, 3] == pytest.approx(one, rel=1e-12)
    assert field.field(points=POINTS, currents=1.0).shape == (4, 5, 3)
    assert field.field(np.zeros((0, 5, 3)), 1.0).shape == (0, 5, 3)


def test_coils_that_a_mapping_leaves_out_carry_no_current():
    assert np.array_equal(
        coils().field(POINTS, {"1": 1.5}), coils().field(POINTS, [1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    )
    with pytest.raises(InputError) as caught:
        coils().field(POINTS, {"7": 1.5})
    assert caught.value.problems[0].where == "currents"


@pytest.mark.parametrize("points", [np.zeros((4, 5, 2)), [[[0.0, 0.0]]], np.full((2, 2, 3), np.nan), "abc"])
def test_points_that_are_none(points):
    with pytest.raises(InputError):
        coils().field(points, 1.0)
