"""Maps for mag_manip, read as its source says that it reads them, and back. Its wheel: test_mag_manip_program.py."""

import numpy as np
import pytest

from fieldmap.errors import InputError, MapFileError
from fieldmap.interop import read_mag_manip, sample_for_mag_manip, write_mag_manip
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
    """B (n, 3) as mag_manip of Tesla_core 4.0.1 has it, anew from its source in mag_control/mag_manip.

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
    # What is stated is what is seen, or a little more: its points lie where the error is largest.
    assert seen < 1.1 * sampled.flux_error < 2 * seen


def test_one_field_at_fixed_currents(flat, tmp_path):
    """What a map of saturating iron can be written as: here it is known to be the sum of the coils."""
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
    # Nothing is lost of a map that needs no more nodes than it has.
    assert sample_for_mag_manip(ring.map, 0.005).count == 13
    assert sample_for_mag_manip(flat).count > 13
    assert sample_for_mag_manip(flat).to_dict()["map_nodes"] == [6, 5, 9]


def test_its_accuracy_is_of_second_order(flat):
    """One-sided differences: with half the spacing a quarter of the error of B, and half that of the gradient."""
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
