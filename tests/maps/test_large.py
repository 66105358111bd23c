"""Large maps: the same numbers and polynomials as maps in memory, larger cells where the field allows them, runs that
stop, and disks that are full."""

import pickle
import shutil
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import InputError, MapAccuracyWarning, MapFileError, RecipeError
from fieldmap.iron import solve_linear
from fieldmap.lookup import field_map, interpolate, open_map
from fieldmap.maps import generate
from fieldmap.store import check_map, checkpoint_path, map_check, read_map, seal_map
from fieldmap.store.large_map import LargeMapWriter

BOX = np.array([[-0.010, -0.010, -0.012], [0.010, 0.010, 0.012]])
# Sixteen cells along each axis: cells of the lookup that span two of them would miss the accuracy.
SPACING = (BOX[1] - BOX[0]) / 16
CURRENTS = [2.0, -0.5]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("large")


@pytest.fixture(scope="module")
def pair():
    return read_device(Path(__file__).parents[1] / "devices" / "pair.toml")


@pytest.fixture(scope="module")
def both(folder, pair):
    """Paths of one map made both ways, with a reference current other than 1 A."""
    options = {"spacing": SPACING, "box": BOX, "reference_current": 3.0}
    return SimpleNamespace(
        large=generate(pair, folder / "large.h5", large=True, **options),
        small=generate(pair, folder / "small.h5", large=False, **options),
    )


@pytest.fixture
def points():
    return BOX[0] + np.random.default_rng(5).random((300, 3)) * (BOX[1] - BOX[0])


def test_numbers_are_those_of_a_map_in_memory(both):
    large, small = read_map(both.large), read_map(both.small)
    assert large.grid.shape == small.grid.shape == (17, 17, 17)
    np.testing.assert_array_equal(large.flux_density, small.flux_density)
    np.testing.assert_array_equal(large.gradient, small.gradient)
    with h5py.File(both.large) as ours, h5py.File(both.small) as theirs:
        for record in ("B", "B_upper", "gradB_lower"):
            for name, values in theirs[f"/data/0/meshes/{record}"].items():
                np.testing.assert_array_equal(ours[values.name][()], values[()])
                assert dict(ours[values.name].attrs).keys() == dict(values.attrs).keys(), name


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_lookups_are_those_of_a_map_in_memory_to_the_last_bit(both, points, kind):
    large, small = open_map(both.large, kind), interpolate(read_map(both.large), kind)
    for name in ("field", "gradient", "second_gradient", "potential"):
        np.testing.assert_array_equal(
            getattr(large, name)(points, CURRENTS), getattr(small, name)(points, CURRENTS)
        )
    assert large.error_bound == open_map(both.small, kind).error_bound
    clamped = open_map(both.large, kind, outside="clamp")
    np.testing.assert_array_equal(
        clamped.field([0.0, 0.0, 1.0], CURRENTS), large.field([0.0, 0.0, 0.012], CURRENTS)
    )
    with pytest.raises(ValueError, match="box"):
        large.field([0.0, 0.0, 1.0], CURRENTS)


def test_only_forms_in_the_file_can_be_asked_for(both):
    with pytest.raises(InputError, match="global, harmonic"):
        open_map(both.large, "hermite")
    assert interpolate(read_map(both.large), "hermite").kind == "hermite"


def test_a_pickled_map_holds_a_path(both, points):
    opened = open_map(both.large, outside="clamp")
    text = pickle.dumps(opened)
    assert len(text) < 20_000 < opened.nbytes
    again = pickle.loads(text)
    np.testing.assert_array_equal(again.field(points, CURRENTS), opened.field(points, CURRENTS))
    assert np.isfinite(again.field([0.0, 0.0, 1.0], CURRENTS)).all()


def test_cells_too_many_to_be_summed_are_superposed_at_each_point(both, points, monkeypatch):
    summed = open_map(both.large).at(CURRENTS).field(points)
    monkeypatch.setattr(field_map, "MOST_SUMMED", 100)
    each = open_map(both.large).at(CURRENTS)
    np.testing.assert_allclose(each.field(points), summed, rtol=0, atol=1e-15 * np.abs(summed).max() * 10)
    np.testing.assert_allclose(each.field(points[0]), summed[0], rtol=1e-13)
    with pytest.raises(InputError, match="give its function the currents"):
        each.compiled()


@pytest.fixture(scope="module")
def coarse(folder, pair):
    """A map of a smooth field with lookup cells larger than its node cells."""
    box = 0.25 * BOX
    path = generate(pair, folder / "coarse.h5", spacing=(box[1] - box[0]) / 24, box=box, large=True)
    return SimpleNamespace(path=path, opened=open_map(path), box=box)


def test_cells_span_many_nodes_where_the_field_is_smooth(coarse, pair):
    opened, (lower, upper) = coarse.opened, coarse.box
    with h5py.File(coarse.path) as file:
        every = int(file["/fieldmap/lookup"].attrs["every"])
        block = file["/fieldmap/lookup/harmonic"].size
    assert every == 8
    assert block == 24 + 3**3 * 2 * 36
    # Points all over the box against the coils' own field, which no interpolant was fitted to.
    at = lower + np.random.default_rng(6).random((2000, 3)) * (upper - lower)
    exact, slopes = solve_linear(pair).unit_fields(at)
    of_flux = np.linalg.norm(opened.unit_field(at).swapaxes(0, 1) - exact, axis=2).sum(axis=0).max()
    of_slope = np.linalg.norm(opened.unit_gradient(at).swapaxes(0, 1) - slopes, axis=(2, 3)).sum(axis=0).max()
    bound = opened.error_bound
    assert of_flux < bound.flux_density
    assert of_slope < bound.gradient < 1e-6 * np.linalg.norm(slopes, axis=(2, 3)).sum(axis=0).max() * 10


def test_the_stated_misfit_is_the_largest_at_any_node(coarse):
    data = read_map(coarse.path)
    nodes = np.clip(data.grid.points(), coarse.opened.lower, coarse.opened.upper)
    flux, slope = coarse.opened.unit_field(nodes), coarse.opened.unit_gradient(nodes)
    of_flux = np.linalg.norm(flux.swapaxes(0, 1) - data.flux_density.reshape(2, -1, 3), axis=2).sum(axis=0)
    theirs = data.gradient.reshape(2, -1, 3, 3)
    of_slope = np.linalg.norm(slope.swapaxes(0, 1) - theirs, axis=(2, 3)).sum(axis=0)
    with h5py.File(coarse.path) as file:
        stated = file["/fieldmap/lookup/harmonic"].attrs["misfit"]
    # At nodes on faces two polynomials hold; the lookup takes one of them.
    assert 0.3 * stated[0] < of_flux.max() <= stated[0] * (1 + 1e-6)
    assert 0.3 * stated[1] < of_slope.max() <= stated[1] * (1 + 1e-6)
    assert stated[0] < 1e-6 * np.linalg.norm(data.flux_density, axis=-1).sum(axis=0).max()


def numbers_of(path):
    with h5py.File(path) as file:
        found = {}
        file.visititems(
            lambda name, one: found.update({name: one[()].tobytes()}) if hasattr(one, "dtype") else None
        )
    return {
        name: raw
        for name, raw in found.items()
        if "text" not in name and not name.endswith(("header", "report"))
    }


class Stopped(Exception):  # noqa: N818 - reads as what happened
    pass


@pytest.mark.parametrize("damage", ["none", "a part", "between the parts", "everything"])
def test_a_run_that_stopped_goes_on_to_the_same_bytes(tmp_path, pair, both, damage):
    target = tmp_path / "map.h5"
    options = {"spacing": SPACING, "box": BOX, "reference_current": 3.0, "large": True}

    def stop(message, _):
        if "part 4 of 6" in message:
            raise Stopped

    with pytest.raises(Stopped):
        generate(pair, target, progress=stop, **options)
    numbers = tmp_path / "map.h5.numbers.partial"
    assert numbers.is_file()
    assert not target.exists()
    raw = bytearray(numbers.read_bytes())
    with h5py.File(both.large) as file:
        begin = file["/data/0/meshes/B_upper/y"].id.get_offset()
    if damage == "a part":
        raw[begin + 1000] ^= 1
    if damage == "between the parts":
        raw[:512] = bytes(512)
    numbers.write_bytes(raw)
    if damage == "everything":
        numbers.unlink()
    said = []
    generate(pair, target, progress=lambda message, _: said.append(message), **options)
    resumed = {"none": 3, "a part": 2, "between the parts": 3, "everything": 0}[damage]
    assert (f"resumed with {resumed} of 6 parts" in said) == (resumed > 0)
    assert numbers_of(target) == numbers_of(both.large)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["map.h5"]


def test_a_run_of_the_other_kind_begins_anew(tmp_path, pair):
    options = {"spacing": SPACING, "box": BOX}

    def stop(message, _):
        if "part 4 of 6" in message:
            raise Stopped

    with pytest.raises(Stopped):
        generate(pair, tmp_path / "map.h5", progress=stop, large=False, **options)
    path = generate(pair, tmp_path / "map.h5", large=True, **options)
    assert check_map(path).info.grid.size == 17**3


def test_a_disk_without_room_is_told_before_the_start(tmp_path, pair, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=200_000))
    said = []
    with pytest.raises(RecipeError) as caught:
        generate(
            pair,
            tmp_path / "map.h5",
            spacing=SPACING,
            box=BOX,
            large=True,
            progress=lambda m, _: said.append(m),
        )
    assert caught.value.problems[0].where.endswith("spacing_mm")
    assert said == ["checking recipe, device and geometry"]
    assert list(tmp_path.iterdir()) == []


def test_the_numbers_of_cells_are_made_a_multiple_of_eight(tmp_path, pair):
    path = generate(pair, tmp_path / "map.h5", spacing=(BOX[1] - BOX[0]) / [9, 8, 17], box=BOX, large=True)
    assert check_map(path).info.grid.shape == (17, 9, 25)


def flipped(path, offset):
    raw = bytearray(path.read_bytes())
    raw[offset] ^= 4
    path.write_bytes(raw)


def test_a_wrong_bit_is_found_where_it_is_read(both, tmp_path):
    path = tmp_path / "map.h5"

    def place(name):
        shutil.copy(both.large, path)
        with h5py.File(path) as file:
            return file[name].id.get_offset()

    flipped(path, place("/data/0/meshes/gradB_lower/xy") + 800)
    assert open_map(path).coil_names == ("upper", "lower")
    for read in (read_map, check_map):
        with pytest.raises(MapFileError, match="SHA-256"):
            read(path)
    for name in ("/fieldmap/lookup/harmonic", "/fieldmap/lookup/global"):
        flipped(path, place(name) + 800)
        with pytest.raises(MapFileError, match="SHA-256"):
            open_map(path)
    shutil.copy(both.large, path)
    flipped(path, -150)  # the second seal itself
    with pytest.raises(MapFileError):
        open_map(path)
    shutil.copy(both.large, path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(MapFileError):
        open_map(path)


def test_a_map_sealed_anew_is_verified_as_a_whole(both, tmp_path):
    path = shutil.copy(both.large, tmp_path / "map.h5")
    seal_map(path)
    assert b"without numbers" not in path.read_bytes()[-400:]
    field = open_map(path).field([0, 0, 0], CURRENTS)
    np.testing.assert_array_equal(field, open_map(both.large).field([0, 0, 0], CURRENTS))


@pytest.mark.parametrize("axis", range(3))
def test_the_check_in_parts_finds_what_the_check_of_the_whole_finds(tmp_path, pair, monkeypatch, axis):
    """B has its largest steps along an axis of few cells."""
    cells = np.where(np.arange(3) == axis, 6, 12)
    path = generate(pair, tmp_path / "map.h5", spacing=(BOX[1] - BOX[0]) / cells, box=BOX)
    names = ("divergence", "curl", "values_and_gradients", "total", "data_sets")
    whole = check_map(path)
    for nodes in (1, 300):
        monkeypatch.setattr(map_check, "_NODES_AT_A_TIME", nodes)
        parts = check_map(path)
        assert [getattr(parts, name) for name in names] == [getattr(whole, name) for name in names]
    assert whole.values_and_gradients > 1e-6


def test_iron_answers_magnets_as_in_a_map_in_memory(tmp_path):
    device = read_device("loop_and_sphere")
    lower, upper = device.bounds
    options = {"spacing": (upper - lower) / 8, "iron": {"refinement": 0.5}, "accept_error": True}
    large = open_map(generate(device, tmp_path / "large.h5", large=True, **options))
    small = open_map(generate(device, tmp_path / "small.h5", large=False, **options))
    at = lower + np.random.default_rng(7).random((20, 3)) * (upper - lower)
    moments = np.random.default_rng(8).normal(size=(20, 3))
    assert large.reaction is not None
    np.testing.assert_array_equal(large.wrench(at, moments, 1.0), small.wrench(at, moments, 1.0))
    np.testing.assert_array_equal(large.inductance(), small.inductance())


def test_parts_are_verified_once(tmp_path, pair, monkeypatch):
    """A finished map leaves neither checkpoint nor numbers, and is left alone."""
    options = {"spacing": SPACING, "box": BOX, "large": True}
    path = generate(pair, tmp_path / "map.h5", **options)
    assert not checkpoint_path(path).exists()
    monkeypatch.setattr(LargeMapWriter, "write", None)
    assert generate(pair, path, **options) == path


def test_iron_that_saturates(few_states, few_states_map, tmp_path):
    """The fields are known after the training only; the reference currents are not 1 A."""
    path = generate(few_states, tmp_path / "large.h5", large=True, accept_error=True)
    numbers = read_map(path)
    assert len(numbers.field_names) > len(numbers.coil_names)
    with pytest.warns(MapAccuracyWarning):
        ours = open_map(path)
    theirs = interpolate(read_map(few_states_map.path))
    at = ours.lower + np.random.default_rng(9).random((50, 3)) * (ours.upper - ours.lower)
    exact = theirs.field(at, [1.5, 0.7])
    np.testing.assert_allclose(ours.field(at, [1.5, 0.7]), exact, rtol=0, atol=1e-3 * np.abs(exact).max())
    assert check_map(path).total < 1e-12
