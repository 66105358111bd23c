"""A map as a CSV table: its numbers are those of the map, and a map fitted to them is the same field."""

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from fieldmap import CircularCoil
from fieldmap.errors import InputError
from fieldmap.field import StateField, as_field
from fieldmap.interop import fit_map, read_measurements, sampling, write_csv
from fieldmap.interop.sampling import MOST_NODES, sample_grid
from fieldmap.lookup import interpolate
from fieldmap.sources import CoilSet
from fieldmap.store import Grid, MapData, Provenance
from tests.refusals import refused

CURRENTS = np.array([1.5, 0.5, -1.0, 2.0, 0.0, 1.0])


def table(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def test_coil_by_coil(ring, tmp_path):
    path = write_csv(ring.map, tmp_path / "ring.csv")
    rows = table(path)
    nodes = ring.grid.points()
    assert len(rows) == 6 * len(nodes)
    exact, slope = ring.fields(nodes)
    for number in (0, len(nodes) + 5, 6 * len(nodes) - 1):
        coil, node = divmod(number, len(nodes))
        row = rows[number]
        np.testing.assert_allclose([float(row[f"{axis}_m"]) for axis in "xyz"], nodes[node], atol=1e-15)
        assert [float(row[f"I_{name}_A"]) for name in "123456"] == np.eye(6)[coil].tolist()
        ours = [float(row[f"B{axis}_T"]) for axis in "xyz"]
        np.testing.assert_allclose(ours, exact[coil, node], atol=1e-5 * np.abs(exact).max())
        ours = [[float(row[f"dB{i}_d{j}_T_per_m"]) for j in "xyz"] for i in "xyz"]
        np.testing.assert_allclose(ours, slope[coil, node], atol=1e-4 * np.abs(slope).max())
    assert path.read_text().splitlines()[2].startswith("# frame: ")


def test_every_coil_has_its_own_reference_current(ring, tmp_path):
    """Coil k at k A, on a grid of unequal counts."""
    grid, amperes = Grid(ring.grid.lower, ring.grid.spacing, (9, 8, 13)), np.arange(1.0, 7.0)
    part = {name: getattr(ring.data, name)[:, :, :8] for name in ("flux_density", "gradient")}
    path = write_csv(interpolate(MapData(grid, tuple("123456"), amperes, **part)), tmp_path / "ring.csv")
    rows, nodes = table(path), grid.points()
    exact = ring.fields(nodes[:1])[0][:, 0]
    for k, row in enumerate(rows[:: len(nodes)]):
        assert [float(row[f"I_{name}_A"]) for name in "123456"] == (amperes * np.eye(6)[k]).tolist()
        ours = [float(row[f"B{axis}_T"]) for axis in "xyz"]
        np.testing.assert_allclose(ours, amperes[k] * exact[k], atol=1e-5 * np.abs(exact).max())
    assert "# nodes: 9 x 8 x 13, z fastest" in path.read_text().splitlines()


def test_pandas_reads_it(ring, tmp_path):
    pandas = pytest.importorskip("pandas", reason="pandas, which xarray brings, is not installed")
    frame = pandas.read_csv(write_csv(ring.map, tmp_path / "ring.csv"), comment="#")
    nodes = ring.grid.points()
    assert len(frame) == 6 * len(nodes)
    of_coil_4 = frame[frame["I_4_A"] == 1.0]
    np.testing.assert_allclose(of_coil_4[["x_m", "y_m", "z_m"]], nodes, atol=1e-15)
    exact, slope = (part[3] for part in ring.fields(nodes))
    flux = of_coil_4[["Bx_T", "By_T", "Bz_T"]]
    np.testing.assert_allclose(flux, exact, rtol=0, atol=1e-5 * np.abs(exact).max())
    steep = of_coil_4["dBx_dz_T_per_m"]
    np.testing.assert_allclose(steep, slope[:, 0, 2], rtol=0, atol=1e-4 * np.abs(slope).max())


def test_numbers_read_back_to_the_last_bit(ring, tmp_path):
    read = read_measurements(write_csv(ring.map, tmp_path / "ring.csv", CURRENTS))
    assert read.coil_names == ("fixed",)
    np.testing.assert_array_equal(read.currents, 1.0)
    inside = np.clip(read.points, ring.map.lower, ring.map.upper)
    np.testing.assert_array_equal(read.flux_density, ring.map.field(inside, CURRENTS))
    words = (tmp_path / "ring.csv").read_text().splitlines()[4]
    assert words.startswith("# I_fixed_A = 1 ")
    in_coils = [(name, float(value)) for value, name in re.findall(r"(\S+) A in coil (\w+)", words)]
    assert in_coils == [(str(k + 1), value) for k, value in enumerate(CURRENTS)]


@pytest.mark.parametrize("fixed", [False, True])
def test_imported_again_it_is_the_same_field(ring, tmp_path, fixed):
    path = write_csv(ring.map, tmp_path / "ring.csv", CURRENTS if fixed else None)
    measured = fit_map(read_measurements(path), spacing=0.005)
    again = interpolate(measured.data)
    assert again.coil_names == (("fixed",) if fixed else ring.map.coil_names)
    rng = np.random.default_rng(3)
    points = ring.map.lower + rng.random((300, 3)) * (ring.map.upper - ring.map.lower)
    for currents in (CURRENTS, np.ones(6)):
        if fixed and currents is not CURRENTS:
            continue
        flux, slope = again.field_and_gradient(points, np.ones(1) if fixed else currents)
        wanted, steep = ring.map.field_and_gradient(points, currents)
        assert np.abs(flux - wanted).max() < 4e-5 * np.abs(wanted).max()
        assert np.abs(slope - steep).max() < 1e-3 * np.abs(steep).max()
    # The stated residual is as small.
    assert measured.report.residual < 1e-5 * np.abs(wanted).max()


def test_a_spacing_of_too_many_nodes_is_refused_before_any_is_computed(ring, tmp_path):
    """The box is 40 x 40 x 60 mm; the remedy states a spacing that is accepted."""
    with pytest.raises(InputError) as caught:
        write_csv(ring.map, tmp_path / "ring.csv", CURRENTS, spacing=1e-5)
    (problem,) = caught.value.problems
    assert problem.where == "spacing"
    assert str(MOST_NODES) in problem.must_hold
    assert str(4001 * 4001 * 6001) in problem.received
    wider = 1e-3 * float(re.search(r"[\d.]+", problem.remedy)[0])
    assert 0.5 * MOST_NODES < np.prod(sample_grid(ring.map, wider).shape) <= MOST_NODES
    assert not list(tmp_path.iterdir())


def test_currents_that_do_not_fit(ring, tmp_path):
    with pytest.raises(InputError):
        write_csv(ring.map, tmp_path / "ring.csv", [1.0, 2.0])
    (tmp_path / "file").touch()
    with pytest.raises(InputError) as caught:
        write_csv(ring.map, tmp_path / "file" / "ring.csv")
    assert caught.value.problems[0].where == str(tmp_path / "file" / "ring.csv")
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_nodes_divide_the_box(ring, monkeypatch):
    """They are no farther apart than asked; by default a map keeps its own. The box is 40 x 40 x 60 mm."""
    for spacing, shape in (
        (0.01, (5, 5, 7)),
        (0.0099, (6, 6, 8)),
        (0.01 / (1 + 1e-12), (5, 5, 7)),
        (None, (9, 9, 13)),
    ):
        grid = sample_grid(ring.map, spacing)
        assert grid.shape == shape
        np.testing.assert_allclose([grid.lower, grid.upper], [ring.map.lower, ring.map.upper], atol=1e-15)
    assert MOST_NODES == 4_000_000
    for most, fits in ((175, True), (174, False)):
        monkeypatch.setattr(sampling, "MOST_NODES", most)
        if fits:
            sample_grid(ring.map, 0.01)
            continue
        # 1.1 times the spacing of the limit, if counts went with the inverse cube of the spacing.
        remedy = f"take {1.1 * 10 * (175 / 174) ** (1 / 3):.2g} mm or more"
        with refused(InputError, where="spacing", received="0.01 m: 175 nodes", remedy=remedy):
            sample_grid(ring.map, 0.01)
    for spacing in (0.0, -0.01, np.nan):
        with refused(InputError, where="spacing", received=repr(spacing)):
            sample_grid(ring.map, spacing)
    with refused(InputError, where="spacing", received="none"):
        sample_grid(as_field(ring.map.at(CURRENTS), (ring.map.lower, ring.map.upper)))


def test_what_is_said_above_the_numbers(ring, tmp_path):
    """A map's title and device, the name given for another field, and the currents of a state."""
    told = Provenance(title="Six\n loops", device_name="ring")
    named = interpolate(replace(ring.data, provenance=told))
    coils = CoilSet(
        [CircularCoil("left", 0.01, 0.02, 0.01, 100), CircularCoil("right", 0.03, 0.04, 0.01, 50)]
    )
    box = np.zeros(3), np.array([0.01, 0.02, 0.03])
    field, state = as_field(coils, box), StateField(coils.at([1.5, -0.25]), box)
    for given, how, lines in (
        (named, {"device": "other"}, ["# Six loops", "# device: ring"]),
        (field, {"spacing": 0.01, "device": "a\nrig"}, ["# fieldmap", "# device: a rig"]),
        (state, {"spacing": 0.01}, ["# fieldmap", "# device: not recorded"]),
    ):
        text = write_csv(given, tmp_path / "field.csv", **how).read_text().splitlines()
        assert text[:2] == lines
        remarks = [line for line in text if line[0] == "#"]
        assert len(remarks) == 4 + (given is state)
    assert remarks[-2:] == [
        "# nodes: 2 x 3 x 4, z fastest",
        "# I_fixed_A = 1 stands for 1.5 A in coil left, -0.25 A in coil right",
    ]
    row = table(tmp_path / "field.csv")[-1]
    flux = coils.field([0.01, 0.02, 0.03], [1.5, -0.25])
    assert [float(row[f"B{axis}_T"]) for axis in "xyz"] == pytest.approx(flux, rel=1e-12)
    assert sampling.sample(field, spacing=0.01).currents_in_words == "1 A in each coil alone"
    np.testing.assert_array_equal(sampling.sample(field, spacing=0.01).reference, [1.0, 1.0])
