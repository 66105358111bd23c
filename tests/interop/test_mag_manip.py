"""Maps for mag_manip, read as its source code reads them, and read back. Its wheel: test_mag_manip_program.py."""

import numpy as np
import pytest

from fieldmap.errors import InputError, MapFileError
from fieldmap.interop import VectorFields, mag_manip, read_mag_manip, sample_for_mag_manip, write_mag_manip
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed (pip install fieldmap[mag-manip])")

ACCURACY = 1e-4


@pytest.fixture(scope="module")
def flat(ring):
    """A map of two of the six loops on unequal counts of nodes in a box of unequal sides: 6 x 5 x 9."""
    grid = Grid([-0.02, -0.015, -0.15], [0.008, 0.0075, 0.006], (6, 5, 9))
    flux, slope = (part[[0, 3]] for part in ring.fields(grid.points()))
    shape = (2, *grid.shape, 3)
    data = MapData(
        grid, ("1", "4"), np.ones(2), flux_density=flux.reshape(shape), gradient=slope.reshape(*shape, 3)
    )
    return interpolate(data)


def load(path):
    return yaml.load(path.read_text(), getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def read_as_the_program(entry, points):
    """B (n, 3) as mag_manip of Tesla_core 4.0.1 gives it, written anew from its source in mag_control/mag_manip.

    include/mag_manip/interpolate_regular.h:325: node (i, j, k) is column i dim_x dim_y + j dim_y + k of the data.
    src/interpolate_regular.cpp:58-342: derivatives at the nodes, also mixed ones, are central differences in steps of
    the grid, one-sided in the outermost nodes. src/interpolate_tricubic.cpp:50-142: these and the values at the eight
    corners of a cell fix its tricubic polynomial. Positions and values are floats (vfield.cpp:130-178).
    """
    low, high = (np.array([np.float32(entry[f"{end}_{a}"]) for a in "xyz"]) for end in ("min", "max"))
    nx, ny, _ = dims = np.array([entry[f"dim_{a}"] for a in "xyz"])
    data = np.array(entry["data"], dtype=np.float32).astype(float)
    i, j, k = np.indices(dims)
    nodes = {(): data[i * nx * ny + j * ny + k]}
    for axes in [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)]:
        nodes[axes] = np.gradient(nodes[axes[:-1]], axis=axes[-1])
    place = (points - low) / ((high - low) / np.float32(dims - 1))
    assert np.all(points >= low)
    assert np.all(points <= high)
    cell = np.floor(place).astype(int)
    assert np.all(cell >= 0)
    assert np.all(cell + 1 < dims)
    t = place - cell
    value = {0: 1 - t**2 * (3 - 2 * t), 1: t**2 * (3 - 2 * t)}
    slope = {0: t * (1 - t) ** 2, 1: -(t**2) * (1 - t)}
    total = np.zeros((len(points), 3))
    for axes, table in nodes.items():
        for corner in np.ndindex(2, 2, 2):
            weight = np.ones(len(points))
            for a in range(3):
                weight *= (slope if a in axes else value)[corner[a]][:, a]
            total += weight[:, None] * table[tuple((cell + corner).T)]
    return total


def points_of(m, n=1000):
    """Random points of a map's box, its corners and middles of its faces."""
    rng = np.random.default_rng(5)
    ends = np.stack([m.lower, (m.lower + m.upper) / 2, m.upper])
    special = np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.concatenate([special, m.lower + rng.random((n, 3)) * (m.upper - m.lower)])


@pytest.mark.parametrize("spacing", [None, 0.004])
def test_the_program_reads_the_field_of_a_map_of_unequal_counts(flat, tmp_path, spacing):
    sampled = sample_for_mag_manip(flat, spacing)
    content = load(sampled.write(tmp_path / "flat.yaml"))
    keys = list(content["vfields"])
    assert keys == sorted(keys)
    assert len(keys) == 2
    entries = [content["vfields"][key] for key in keys]
    assert {entry[f"dim_{a}"] for entry in entries for a in "xyz"} == {sampled.count}
    assert sampled.count >= 9
    points = points_of(flat)
    exact = flat.unit_field(points)
    read = np.stack([read_as_the_program(entry, points) for entry in entries], axis=1)
    size = np.linalg.norm(exact, axis=-1).max(axis=0)
    seen = (np.linalg.norm(read - exact, axis=-1).max(axis=0) / size).max()
    assert seen < (ACCURACY if spacing is None else 2e-3)
    # The stated error is what is seen, or a little more: it is taken where the error is largest.
    assert seen < 1.1 * sampled.flux_error < 2 * seen


def test_one_field_at_fixed_currents(flat, tmp_path):
    """So a map of saturating iron can be written; this map's field is known: the sum of the coils'."""
    sampled = sample_for_mag_manip(flat, currents=[1.5, -0.5])
    content = load(sampled.write(tmp_path / "fixed.yaml"))
    (entry,) = content["vfields"].values()
    points = points_of(flat, 200)
    exact = flat.field(points, [1.5, -0.5])
    error = np.linalg.norm(read_as_the_program(entry, points) - exact, axis=1).max()
    assert error < ACCURACY * np.linalg.norm(exact, axis=1).max()
    with pytest.raises(InputError):
        sample_for_mag_manip(flat, currents=[1.0, 2.0, 3.0])


def test_saturating_iron_needs_currents(flat, monkeypatch):
    monkeypatch.setattr(type(flat), "proportional", False)
    with pytest.raises(InputError) as caught:
        sample_for_mag_manip(flat)
    assert "currents" in caught.value.problems[0].where
    assert len(sample_for_mag_manip(flat, 0.01, 1.0).coil_names) == 1


def test_as_many_nodes_as_the_spacing_asks_for(flat, ring):
    # The longest side is 48 mm.
    assert sample_for_mag_manip(flat, 0.005).count == 11
    # The longest side of the ring's map is 60 mm.
    assert sample_for_mag_manip(ring.map, 0.005).count == 13
    assert sample_for_mag_manip(flat).count > 13
    assert sample_for_mag_manip(flat).to_dict()["map_nodes"] == [6, 5, 9]


def test_its_accuracy_is_of_second_order(flat):
    """With half the spacing, one-sided differences leave a quarter of the error of B and half that of the gradient."""
    coarse, fine = (sample_for_mag_manip(flat, 0.048 / cells) for cells in (12, 24))
    assert coarse.flux_error / fine.flux_error == pytest.approx(4, rel=0.2)
    assert coarse.gradient_error / fine.gradient_error == pytest.approx(2, rel=0.2)


def test_there_and_back(ring, tmp_path):
    back = read_mag_manip(write_mag_manip(ring.map, tmp_path / "coarse.yaml", spacing=0.008))
    assert back.data.coil_names == ("coil_00", "coil_01", "coil_02", "coil_03", "coil_04", "coil_05")
    currents = np.array([1.0, -1, 2, 0, 1, 1])
    rng = np.random.default_rng(9)
    points = ring.map.lower + rng.random((500, 3)) * (ring.map.upper - ring.map.lower)
    exact, steep = (np.einsum("c...,c->...", part, currents) for part in ring.fields(points))
    flux, slope = interpolate(back.data).field_and_gradient(points, currents)
    assert np.abs(flux - exact).max() < 4e-5 * np.abs(exact).max()
    assert np.abs(slope - steep).max() < 1e-3 * np.abs(steep).max()


def test_files_that_are_not_mag_manip(tmp_path, ring):
    for text in ("name: x\n", "vfields: {a: {dim_x: 2}}\n", ": :\n  - [", "- 1\n"):
        (tmp_path / "bad.yaml").write_text(text)
        with pytest.raises(MapFileError) as caught:
            read_mag_manip(tmp_path / "bad.yaml")
        assert caught.value.problems[0].where == str(tmp_path / "bad.yaml")
    with pytest.raises(InputError) as refused:
        write_mag_manip(ring.map, tmp_path / "ring.yaml", spacing=-1.0)
    assert refused.value.problems[0].where == "spacing"
    assert not (tmp_path / "ring.yaml").exists()


BOX = Grid([-0.02, -0.01, -0.12], [0.005, 0.004, 0.006], (6, 5, 7))


def of_gradient(slope, curvature=0.0):
    """A map of B = slope x + curvature (x^2 - z^2, 0, -2 x z) on a box of unequal sides."""
    x, y, z = BOX.points().T
    flux = BOX.points() @ slope.T + curvature * np.stack([x**2 - z**2, 0 * y, -2 * x * z], axis=1)
    steep = np.tile(slope, (len(x), 1, 1))
    steep[:, 0, 0] += 2 * curvature * x
    steep[:, 0, 2] -= 2 * curvature * z
    steep[:, 2, 0] -= 2 * curvature * z
    steep[:, 2, 2] -= 2 * curvature * x
    shape = (1, *BOX.shape, 3)
    arrays = {"flux_density": flux.reshape(shape), "gradient": steep.reshape(*shape, 3)}
    return interpolate(MapData(BOX, ("1",), [1.0], **arrays))


def test_a_linear_field_is_read_as_it_is():
    """Central and one-sided differences are exact for it: nothing is left but the rounding of the box."""
    slope = np.array([[1.0, 2.0, 3.0], [2.0, 5.0, -4.0], [3.0, -4.0, -6.0]])
    sampled = sample_for_mag_manip(of_gradient(slope))
    assert sampled.count == 7
    assert sampled.flux_error < 1e-5
    assert sampled.gradient_error < 1e-5
    # The box is rounded to single precision outwards, by no more than its rounding.
    for face, edge, sense in (
        (sampled.lower, [-0.02, -0.01, -0.12], -1),
        (sampled.upper, [0.005, 0.006, -0.084], 1),
    ):
        assert (face == face.astype(np.float32)).all()
        assert (sense * (face - edge) > 0).all()
        assert (np.abs(face - edge) < 6e-7 * np.maximum(np.abs(edge), 0.02)).all()


def test_a_quadratic_field_is_off_by_what_one_sided_differences_miss():
    """For f = a x^2 the slope at an outermost node is off by a h, and the interpolation in its cell by 4/27 a h^2, a
    third into the cell; further inside both are exact. The other component, -2 a x z, is linear along each axis, so it
    is exact."""
    curvature, count = 50.0, 13
    sampled = sample_for_mag_manip(of_gradient(np.zeros((3, 3)), curvature), 0.003)
    assert sampled.count == count
    h = (sampled.upper - sampled.lower) / (count - 1)
    # x^2 - z^2: on an edge of the box both are off, with opposite signs; z, with the larger step, decides.
    off = 4 / 27 * curvature * max(h[0], h[2]) ** 2
    x, z = (np.linspace(sampled.lower[k], sampled.upper[k], 200) for k in (0, 2))
    x, z = np.meshgrid(x, z)
    size = curvature * np.hypot(x**2 - z**2, 2 * x * z).max()
    assert sampled.flux_error == pytest.approx(off / size, rel=0.03)
    # The slope there is off by a h along x and along z, in a corner nearly by both.
    steepest = 0.5 * 8**0.5 / np.hypot(h[0], h[2]) * sampled.gradient_error * np.hypot(0.02, 0.12)
    assert 0.85 < 2 * steepest < 1.0


def test_nodes_are_added_until_the_error_is_small_enough(flat, monkeypatch):
    """The error goes with the square of the spacing; the number of nodes has a limit."""
    begin = sample_for_mag_manip(flat, 0.006)
    assert (begin.count, begin.map_nodes) == (9, (6, 5, 9))
    for accuracy, most, count in ((1.001, 99, 9), (0.999, 99, 10), (0.21, 99, 19), (0.2, 12, 12)):
        monkeypatch.setattr(mag_manip, "ACCURACY", accuracy * begin.flux_error)
        monkeypatch.setattr(mag_manip, "MOST_NODES", most)
        assert sample_for_mag_manip(flat).count == count
    assert sample_for_mag_manip(flat, 0.006).count == 9


def test_what_is_said_of_a_field(flat, tmp_path):
    """The currents are in its name, a comment states what was done, and programs get the same numbers."""
    sampled = sample_for_mag_manip(flat, 0.006, [1.5, -0.25])
    assert sampled.coil_names == ("1.5 A in coil 1, -0.25 A in coil 4",)
    middle = flat.field((sampled.lower + sampled.upper) / 2, [1.5, -0.25])
    assert sampled.flux_density[4, 4, 4, 0] == pytest.approx(middle, rel=1e-5)
    lines = sampled.write(tmp_path / "fixed.yaml").read_text().splitlines()
    assert lines[0] == "# coils in current order: 1.5 A in coil 1, -0.25 A in coil 4"
    assert "6 x 5 x 9 nodes resampled to 9 in each" in lines[1]
    errors = f"{sampled.flux_error:.1e}", f"{sampled.gradient_error:.1e}"
    assert [word for word in lines[1].split() if "e-" in word] == [*errors]
    assert lines[2] == 'name: "fieldmap"'
    told = {"map_nodes": [6, 5, 9], "nodes": [9, 9, 9]}
    assert sampled.to_dict() == {
        **told,
        "flux_error": sampled.flux_error,
        "gradient_error": sampled.gradient_error,
    }


@pytest.mark.parametrize(("coils", "last"), [(2, "coil_01"), (100, "coil_99"), (101, "coil_100")])
def test_keys_of_coils_sort_in_the_order_of_currents(tmp_path, coils, last):
    """Keys sort as texts; characters that would end a name or a line are left out."""
    corner, names = np.arange(3.0), tuple(f"a\n{k}" for k in range(coils))
    data = np.arange(24.0 * coils).reshape(2, 2, 2, coils, 3)
    made = VectorFields('a "title"\\', names, corner, corner + [1, 2, 4], data, (2, 3, 4), 1e-5, 1e-3)
    content = load(made.write(tmp_path / "many.yaml"))
    assert content["name"] == "a  title  "
    keys = list(content["vfields"])
    assert keys == sorted(keys)
    assert keys[-1] == last
    assert content["vfields"][last]["data"][3] == data[0, 1, 1, -1].tolist()
    box = {"min_x": 0, "max_x": 1, "min_y": 1, "max_y": 3, "min_z": 2, "max_z": 6}
    assert {key: content["vfields"][last][key] for key in box} == box


def entry(counts, lower, upper, slope):
    """The entry of a coil with B = slope x, z fastest."""
    axes = [np.linspace(*ends) for ends in zip(lower, upper, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    made = {"data": (points @ slope.T).tolist()}
    for axis, *numbers in zip("xyz", counts, lower, upper, strict=True):
        made |= {
            f"{name}_{axis}": number for name, number in zip(("dim", "min", "max"), numbers, strict=True)
        }
    return made


def test_a_file_of_another_program(tmp_path):
    """Two coils, each on a grid of its own, listed out of order; the map's nodes are as close as the file's closest."""
    one = np.array([[1.0, 2.0, 3.0], [2.0, 5.0, -4.0], [3.0, -4.0, -6.0]])
    other = np.diag([1.0, 2.0, -3.0])
    fields = {
        "b": entry((3, 2, 4), (0.0, 0.0, -0.1), (0.02, 0.02, -0.07), other),
        "a": entry((4, 3, 3), (0.0, 0.0, -0.1), (0.027, 0.03, -0.07), one),
    }
    path = tmp_path / "a.yaml"
    path.write_text(yaml.dump({"vfields": fields}))
    back = read_mag_manip(path)
    assert back.data.coil_names == ("a", "b")
    # Spacing along x: 9 mm in a, 10 mm in b.
    assert back.data.grid.shape == (4, 5, 5)
    field, point = interpolate(back.data), np.array([0.011, 0.007, -0.083])
    np.testing.assert_allclose(field.unit_field(point), [one @ point, other @ point], atol=1e-8)
    assert read_mag_manip(path, 0.02).data.grid.shape == (3, 3, 3)
    # Whole numbers are read; too few rows, rows of two numbers and texts are not.
    fields["b"]["data"][0] = [0, 0, 0.3]
    for data in (fields["b"]["data"], fields["b"]["data"][1:], [[0.0, 0.0]] * 24, [[0.0, 0.0, "x"]] * 24):
        path.write_text(yaml.dump({"vfields": {"b": fields["b"] | {"data": data}}}))
        if data is fields["b"]["data"]:
            assert read_mag_manip(path, 0.02).report.readings == 24
            continue
        with pytest.raises(MapFileError):
            read_mag_manip(path)


def test_no_more_than_a_hundred_coils_are_read(tmp_path, monkeypatch):
    small = entry((2, 2, 2), (0, 0, 0), (1, 1, 1), np.eye(3))

    def refusal(coils):
        (tmp_path / "a.yaml").write_text(yaml.dump({"vfields": {f"c{k:03}": small for k in range(coils)}}))
        with pytest.raises(InputError) as caught:
            read_mag_manip(tmp_path / "a.yaml")
        return caught.value.problems[0]

    assert refusal(101).received == "101 vfields, where 1 to 100 are read"
    monkeypatch.setattr(mag_manip, "MOST_COILS", 2)
    # Two coils are few enough: it is the fit that finds eight readings too few.
    assert [refusal(coils).where for coils in (2, 3)] == ["fit_map", str(tmp_path / "a.yaml")]
