"""Files written and read: devices, recipes, scenarios, maps and recorded runs return their numbers; a map interrupted
anywhere is complete in the end."""

import tomllib

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fieldmap as fm
from fieldmap.dynamics import read_scenario
from fieldmap.maps.recipe import read_recipe
from fieldmap.shipped import shipped_file
from fieldmap.store import (
    Grid,
    MapData,
    Provenance,
    RunRecord,
    open_writer,
    read_map,
    read_runs,
    write_map,
    write_runs,
)

lengths = st.floats(0.1, 400.0)
coordinates = st.floats(-500.0, 500.0)
points = st.tuples(coordinates, coordinates, coordinates)
names = st.text("abcXYZ019_", min_size=1, max_size=12).filter(lambda text: text[0].isalnum())
# Titles contain quotes, backslashes, syntax of TOML and other scripts.
titles = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=30).filter(str.strip)


@st.composite
def coils(draw):
    """(name, lengths in mm, turns, position in mm) of circular coils with different names."""
    found = []
    for name in draw(st.lists(names, min_size=1, max_size=4, unique=True)):
        inner, wider, height = draw(lengths), draw(lengths), draw(lengths)
        found.append((name, inner, inner + wider, height, draw(st.integers(1, 5000)), draw(points)))
    return found


@given(titles, coils())
def test_a_device_as_a_file(title, wound):
    """Made in Python, written, and read by tomllib; read by fieldmap, it has the file's numbers."""
    made = [
        fm.CircularCoil(
            name, 1e-3 * a, 1e-3 * b, 1e-3 * h, turns, placement=fm.placed(1e-3 * np.array(place))
        )
        for name, a, b, h, turns, place in wound
    ]
    text = fm.Device("machine", title.strip(), made).to_toml()
    data = tomllib.loads(text)
    assert data["title"] == title.strip()
    again = fm.read_device(text)
    for (name, a, b, h, turns, place), table, coil in zip(wound, data["coil"], again.coils, strict=True):
        written = [table[key] for key in ("inner_radius_mm", "outer_radius_mm", "height_mm")]
        assert written == pytest.approx([a, b, h], rel=1e-12)
        assert table["position_mm"] == pytest.approx(place, rel=1e-12, abs=1e-9) if any(place) else True
        assert (coil.name, coil.turns) == (name, turns)
        found = [coil.inner_radius, coil.outer_radius, coil.height]
        assert found == pytest.approx([1e-3 * a, 1e-3 * b, 1e-3 * h])
        np.testing.assert_allclose(coil.placement.position, 1e-3 * np.array(place), rtol=1e-12, atol=1e-15)
    assert fm.read_device(again.to_toml()).to_toml() == again.to_toml()


@given(lengths, points, st.tuples(lengths, lengths, lengths), st.floats(1e-6, 0.1), st.floats(0.1, 10.0))
def test_a_recipe(tmp_path_factory, spacing, lower, size, tolerance, refinement):
    upper = [low + side for low, side in zip(lower, size, strict=True)]
    path = tmp_path_factory.getbasetemp() / "recipe.toml"
    path.write_text(
        f'format = 1\ntitle = "a"\ndevice = "drive_unit"\nspacing_mm = {spacing!r}\n[box]\n'
        f"lower_mm = {list(lower)!r}\nupper_mm = {upper!r}\n"
        f"[iron]\ntolerance = {tolerance!r}\nrefinement = {refinement!r}\n"
    )
    recipe = read_recipe(path)
    np.testing.assert_allclose(recipe.spacing, [1e-3 * spacing] * 3, rtol=1e-15)
    np.testing.assert_allclose(recipe.lower, 1e-3 * np.array(lower), rtol=1e-15)
    np.testing.assert_allclose(recipe.upper, 1e-3 * np.array(upper), rtol=1e-15)
    assert (recipe.tolerance, recipe.refinement) == (tolerance, refinement)


@given(st.floats(0.01, 100.0), st.floats(0.1, 50.0), st.floats(1.0, 30.0), st.floats(-3.0, 3.0))
def test_a_scenario(tmp_path_factory, duration, gain, depth, step):
    """Changed in the text or by the caller: the same result, with all other keys unchanged."""
    text = shipped_file("maps", "scenarios/vertical_step").read_text()
    path = tmp_path_factory.getbasetemp() / "scenario.toml"
    new = text.replace("duration_s = 4.0", f"duration_s = {duration!r}").replace(
        "by_mm = 1.0", f"by_mm = {step!r}"
    )
    new = new.replace("Kc = 0.334\n", f"Kc = {gain!r}\n").replace(
        "depth_mm = 10.0\n", f"depth_mm = {depth!r}\n"
    )
    path.write_text(new)
    read = read_scenario(path).contents
    assert (read.duration_s, read.control.z.Kc, read.start.depth_mm) == (duration, gain, depth)
    assert read.reference[0].by_mm == step
    path.write_text(text)
    keys = {"duration_s": duration, "control.z.Kc": gain, "start.depth_mm": depth, "reference.0.by_mm": step}
    assert read_scenario(path, keys).contents == read
    changed = read_scenario(path, {"drag.linear_N_s_per_m.1": gain}).contents.drag.linear_N_s_per_m
    assert list(changed) == [0.005, gain, 0.005]


def numbers(seed, shape):
    rng = np.random.default_rng(seed)
    # Numbers of all sizes, and zeros of both signs.
    values = rng.normal(size=shape) * 10.0 ** rng.integers(-12, 3, shape)
    values[rng.random(shape) < 0.05] = -0.0
    return values


@st.composite
def maps(draw):
    shape = draw(st.tuples(st.integers(3, 6), st.integers(2, 5), st.integers(2, 5)))
    coil_names = tuple(draw(st.lists(names, min_size=1, max_size=3, unique=True)))
    seed, count = draw(st.integers(0, 10**6)), len(coil_names)
    grid = Grid(
        1e-3 * np.array(draw(points)), 1e-3 * np.array(draw(st.tuples(lengths, lengths, lengths))), shape
    )
    return MapData(
        grid,
        coil_names,
        np.array(draw(st.lists(st.floats(0.01, 100.0), min_size=count, max_size=count))),
        Provenance(title=draw(titles), recipe_text=draw(titles), device_text=draw(titles), fingerprint="f"),
        flux_density=numbers(seed, (count, *shape, 3)),
        gradient=numbers(seed + 1, (count, *shape, 3, 3)),
    )


@settings(max_examples=12)
@given(maps())
def test_a_map_holds_its_numbers(tmp_path_factory, data):
    """Read by h5py alone, per coil at its reference current; and by fieldmap, per ampere."""
    path = write_map(tmp_path_factory.getbasetemp() / "map.h5", data)
    again = read_map(path)
    assert again.coil_names == data.coil_names
    assert again.provenance.recipe_text == data.provenance.recipe_text
    assert again.provenance.device_text == data.provenance.device_text
    np.testing.assert_allclose(again.flux_density, data.flux_density, rtol=1e-15)
    np.testing.assert_allclose(again.gradient, data.gradient, rtol=1e-15)
    np.testing.assert_array_equal(again.grid.lower, data.grid.lower)
    np.testing.assert_array_equal(again.grid.spacing, data.grid.spacing)
    with h5py.File(path) as file:
        for k, (name, amperes) in enumerate(zip(data.coil_names, data.reference_current, strict=True)):
            record = next(
                one
                for key, one in file["/data/0/meshes"].items()
                if key.startswith("B_") and one.attrs.get("coilName", b"") in (name, name.encode())
            )
            for axis, letter in enumerate("xyz"):
                np.testing.assert_allclose(
                    record[letter][()], amperes * data.flux_density[k, ..., axis], rtol=1e-15
                )


@settings(max_examples=12)
@given(maps(), st.data())
def test_a_map_interrupted_anywhere_is_the_map(tmp_path_factory, monkeypatch, data, draw):
    """Chunks in any order, runs that end after any of them, files cut or changed at any byte: the map has its
    numbers in the end."""
    # Maps this small would have one chunk.
    monkeypatch.setattr("fieldmap.store.map_format.planes_per_chunk", lambda grid: 1)
    folder = tmp_path_factory.mktemp("resumed")
    target = folder / "map.h5"
    with open_writer(target, data) as writer:
        chunks = list(writer.missing)
    assert len(chunks) == data.grid.shape[0]
    order = draw.draw(st.permutations(chunks))
    rng = np.random.default_rng(draw.draw(st.integers(0, 10**6)))
    while order:
        now = draw.draw(st.integers(1, len(order)))
        with open_writer(target, data) as writer:
            for chunk in (
                writer.missing if now == len(order) else [c for c in order[:now] if c in writer.missing]
            ):
                planes = slice(chunk.first, chunk.last)
                writer.write(chunk, data.flux_density[:, planes], data.gradient[:, planes])
        order = order[now:]
        partial = next(folder.glob("map.h5*"))
        harm = draw.draw(st.sampled_from(["none", "cut", "byte", "byte"])) if order else "none"
        raw = bytearray(partial.read_bytes()) if harm != "none" else bytearray()
        if harm == "cut":
            partial.write_bytes(raw[: rng.integers(0, len(raw) + 1)])
        elif harm == "byte":
            raw[rng.integers(0, len(raw))] ^= 0x41
            partial.write_bytes(raw)
    with open_writer(target, data) as writer:
        for chunk in writer.missing:
            planes = slice(chunk.first, chunk.last)
            writer.write(chunk, data.flux_density[:, planes], data.gradient[:, planes])
        writer.finish({"iterations": 1})
    found = read_map(target)
    np.testing.assert_allclose(found.flux_density, data.flux_density, rtol=1e-15)
    np.testing.assert_allclose(found.gradient, data.gradient, rtol=1e-15)
    assert [path.name for path in folder.iterdir()] == ["map.h5"]


@settings(max_examples=12)
@given(
    st.integers(1, 40), st.integers(0, 5), st.dictionaries(titles, titles, max_size=3), st.integers(0, 10**6)
)
def test_recorded_runs(tmp_path_factory, rows, columns, about, seed):
    path = tmp_path_factory.getbasetemp() / "runs.h5"
    arrays = {
        "time": (np.arange(rows) * 0.1, "s", "time"),
        "x": (numbers(seed, (rows, columns)), "m", "µ, x"),
    }
    write_runs(path, [RunRecord(arrays, about)] * 2, {"title": "a"})
    runs, texts = read_runs(path)
    assert texts == {"title": "a"}
    for run in runs:
        assert run.about == about
        for name, (values, unit, told) in arrays.items():
            np.testing.assert_array_equal(run.arrays[name][0], values)
            assert run.arrays[name][1:] == (unit, told)
