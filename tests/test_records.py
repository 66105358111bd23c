"""Properties of data objects and results: one line as text, plain Python, pickles, copies, points of any shape."""

import copy
import importlib
import json
import pickle
import pkgutil
import re
from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.currents import NearestSignals
from fieldmap.errors import InputError, Problem
from fieldmap.field import Field, FieldAtCurrents, as_field
from fieldmap.levitation import find_equilibrium
from fieldmap.records import LONGEST, FrozenDict, Record
from fieldmap.shipped import shipped_names
from fieldmap.sources import CoilSet

DEVICES = [name for name in shipped_names("geometry") if not name.startswith("planar")]


@cache
def coils():
    return CoilSet(fm.read_device("disk_six_cores").coils)


def same(one, other):
    """Equal to the last bit, recursively."""
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
    """Every corner is in its view, and the views touch their margins, with one scale for both."""
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


PLAIN_TYPES = {bool, int, float, bool | None, int | None, float | None}
PLAIN_TYPES |= {"bool", "int", "float", "bool | None", "int | None", "float | None"}
# Texts of messages; keys of file formats, read by pydantic; data that change; the parts of an inverse.
NOT_RECORDS = {
    "AtKey",
    "Problem",
    "Choice",
    "DeviceData",
    "MagnetBalance",
    "Balance",
    "RigidBalance",
    "BodyBalance",
    "SolvedStates",
    "SumOfFields",
    "SolvedField",
    "Variables",
    "Goal",
}


def public_classes():
    """Every public class of the package, except those for compiled code and commands."""
    for found in pkgutil.walk_packages(fm.__path__, "fieldmap."):
        if not found.name.endswith("__main__") and found.name.split(".")[1] not in ("core", "kernels", "cli"):
            module = importlib.import_module(found.name)
            for name, one in vars(module).items():
                if isinstance(one, type) and one.__module__ == module.__name__ and not name.startswith("_"):
                    yield one


def test_every_data_class_and_named_tuple_is_one_short_line():
    """A text of at most 400 characters, and plain Python, for all possible results of public functions."""
    long, not_plain, count = [], [], 0
    for one in public_classes():
        tuple_of = getattr(one, "__annotations__", {}) if issubclass(one, tuple) else {}
        if one.__name__ in NOT_RECORDS or not (is_dataclass(one) or tuple_of):
            continue
        count += 1
        types = [field.type for field in fields(one)] if is_dataclass(one) else list(tuple_of.values())
        shown = next(base for base in one.__mro__ if "__repr__" in vars(base))
        own = shown in (Record, Field, FieldAtCurrents) or not getattr(shown, "__dataclass_params__", None)
        own |= is_dataclass(shown) and not shown.__dataclass_params__.repr
        own &= vars(shown)["__repr__"].__module__ != "collections"  # not a named tuple's
        if not own and not set(types) <= PLAIN_TYPES:
            long.append(one)
        if is_dataclass(one) and not issubclass(one, Field | FieldAtCurrents | Record):
            not_plain.append(one)
    assert count > 200
    assert long == []
    assert not_plain == []


def test_what_holds_arrays_equals_itself_alone():
    """numpy compares arrays element by element, so comparing or hashing all fields would raise an error."""
    holding = [
        one
        for one in public_classes()
        if is_dataclass(one)
        and any(
            re.match(r"(?!.*Callable).*\b(Array|NDArray|ndarray)\b", str(field.type)) for field in fields(one)
        )
    ]
    assert len(holding) > 150
    assert [one for one in holding if one.__eq__ is not object.__eq__] == []


def walked(thing, seen, depth=0):
    """The objects of the package in a result, recursively."""
    if id(thing) in seen or depth > 8:
        return
    seen[id(thing)] = thing
    if isinstance(thing, dict):
        below = list(thing.values())
    elif isinstance(thing, list | tuple) and len(thing) < 1000:
        below = list(thing)
    elif is_dataclass(thing) and not isinstance(thing, type):
        below = [getattr(thing, field.name) for field in fields(thing)]
    else:
        below = []
    if type(thing).__module__.startswith("fieldmap.") and not isinstance(thing, FrozenDict | Problem):
        yield thing
    for one in below:
        yield from walked(one, seen, depth + 1)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results of the main functions by name, for coils alone and for small iron bodies."""
    from fieldmap import control, dynamics, levitation, studies
    from fieldmap.io import find_source
    from fieldmap.io.answers import floating, probe
    from fieldmap.io.map_summary import summarise_map
    from fieldmap.lookup import finite_magnet
    from fieldmap.maps import read_recipe
    from fieldmap.planar import read_planar_device
    from fieldmap.store import check_map
    from fieldmap.thesis.printed import read_rows

    folder = tmp_path_factory.mktemp("records")
    device = fm.read_device("disk_six_cores").replace(bodies=[], materials={})
    path = fm.generate(device, folder / "coils.h5", spacing=8e-3, iron={"tolerance": 1e-3})
    m, loop = fm.open_map(path), fm.read_device("loop_and_sphere")
    e = fm.find_equilibrium(m, 16.0, device.payload)
    unit = fm.solve_linear(loop, refinement=0.5)
    text = 'format = 1\ntitle = "Turns"\ndevice = "loop_and_sphere"\n[[vary]]\nname = "turns"\n'
    text += 'key = "coil.loop.turns"\nvalues = [100, 200]\n[[currents]]\nname = "one"\namperes_A = 1.0\n'
    text += (
        '[record]\nquantities = ["currents", "field"]\npoints_mm = [[0, 0, -14]]\n[iron]\nmodel = "linear"\n'
    )
    (folder / "turns.toml").write_text(text + "refinement = 0.5\n")
    run = studies.run_study(folder / "turns.toml", folder / "turns.nc")
    source = find_source(path)
    return {
        "open_map": m,
        "open_map.at": m.at(1.0),
        "MapInfo": m.info,
        "check_map": check_map(path),
        "summarise_map": summarise_map(path),
        "find_source": source,
        "probe": probe(source, np.array([[0.0, 0.0, -0.1]]), 1.0, np.array([0.0, 0.0, 0.8])),
        "floating": floating(source, device.payload, 16.0),
        "find_equilibrium": e,
        "lift_current": levitation.lift_current(m, device.payload, np.array([0.0, 0.0, -0.1])),
        "finite_magnet": finite_magnet(device.payload.magnet, m, 1e-3),
        "solve_linear": unit,
        "solve_linear.at": unit.at(1.0),
        "design_figures": fm.design_figures(loop, 1.0, unit),
        "read_recipe": read_recipe("workspace"),
        "read_study": run.study,
        "run_study": run,
        "StudyRow": run.rows(),
        "read_scenario": dynamics.read_scenario("vertical_step"),
        "thesis": read_rows(),
        "control": control.from_roots(4.0, [-1.0], [-2.0, -3.0]),
        "planar": read_planar_device("planar_drive_unit"),
        "CoilSet": coils(),
        "CoilSet.at": coils().at(1.0),
        "NearestSignals": NearestSignals(np.zeros((40, 3)), np.zeros(40)),
    }


def test_results_are_one_short_line_all_the_way_down(results):
    seen, kinds = {}, set()
    for thing in walked(results, seen):
        kinds.add(type(thing).__name__)
        text = repr(thing)
        assert len(text) <= LONGEST, type(thing)
        assert "\n" not in text, type(thing)
        assert " object at 0x" not in text, type(thing)
        if hasattr(thing, "_repr_html_"):
            assert thing._repr_html_().startswith("<table>")
    assert {"Study", "Variant", "Document", "MapInfo", "Provenance", "PrintedNumber", "Recipe"} <= kinds


def test_results_are_plain_python(results):
    for name, thing in results.items():
        for one in thing if isinstance(thing, list | tuple) else [thing]:
            if hasattr(one, "to_dict"):
                assert json.loads(json.dumps(one.to_dict())), name


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_results_survive_pickles_and_copies(results, again):
    point = [0.0, 0.0, -0.1]
    for name, thing in results.items():
        other = again(thing)
        assert type(other) is type(thing), name
        assert repr(other) == repr(thing), name
        if hasattr(thing, "at"):
            assert np.array_equal(other.field(point, 1.0), thing.field(point, 1.0)), name
        elif name.endswith(".at"):
            assert np.array_equal(other.gradient(point), thing.gradient(point)), name
