"""Scenarios on fields other than maps: a solved device runs as its map does."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.cli import main
from fieldmap.currents import divide_currents
from fieldmap.dynamics import prepare, read_scenario, sampled_field, simulate, tabled
from fieldmap.errors import FieldmapError, InputError, Problem
from fieldmap.field import Field, as_field
from fieldmap.lookup import interpolate
from fieldmap.maps.recipe import FEWEST_NODES
from tests.conftest import DEVICES
from tests.dynamics.conftest import saturating_data
from tests.refusals import refused

DEVICE = DEVICES / "coarse_sphere_below_coil.toml"
RECIPE = f"""
format = 1
title = "The same as a map"
device = "{DEVICE}"
spacing_mm = 3.0
[iron]
model = "linear"
"""


STILL = {"kind": "constant"}
SETTINGS = {
    "duration_s": 0.05,
    "body.turning": "upright",
    "noise.off": True,
    "control.coupled": None,
    "control.z": {"kind": "pid", "Kc": 0.5, "Td_s": 0.02},
    "control.x": STILL,
    "control.y": STILL,
    "start.depth_mm": 18,
    "reference.0.at_s": 0.01,
    "reference.0.by_mm": 0.2,
}


def test_a_solved_device_runs_as_its_map_of_the_same_spacing(tmp_path):
    device = fm.read_device(DEVICE)
    solution = fm.solve_linear(device)
    # A solution has no reaction of the iron to magnets.
    (tmp_path / "recipe.toml").write_text(RECIPE + "reaction = false\n")
    fm.generate(tmp_path / "recipe.toml", tmp_path / "map.h5", accept_error=True)
    on_map = simulate("hold", SETTINGS | {"map": str(tmp_path / "map.h5")})
    on_solution = simulate("hold", SETTINGS, field_map=sampled_field(solution, 3e-3), device=device)
    assert on_map.event is None
    assert np.ptp(on_map.sensed[:, 2]) > 1e-5
    np.testing.assert_allclose(on_solution.rows, on_map.rows, rtol=1e-9, atol=1e-12)
    # Without a map: the solution is sampled every 5 mm by default.
    direct = simulate("hold", SETTINGS, field_map=solution, device=device)
    np.testing.assert_allclose(direct.sensed, on_map.sensed, atol=5e-5)


class Above(Field):
    """A dipole of 8 A m^2/A above the origin; its field saturates unless `proportional`."""

    coil_names = ("coil",)

    def __init__(self, proportional):
        self._proportional = proportional

    @property
    def proportional(self):
        return self._proportional

    def field(self, points, currents):
        r = np.atleast_2d(points) - [0.0, 0.0, 0.05]
        d, m = np.linalg.norm(r, axis=1)[:, None], np.array([0.0, 0.0, 8.0 * np.ravel(currents)[0]])
        return 1e-7 * (3 * (r @ m)[:, None] * r / d**5 - m / d**3)

    def gradient(self, points, currents):
        h = 1e-5 * np.eye(3)
        x = np.atleast_2d(points)
        slopes = [(self.field(x + s, currents) - self.field(x - s, currents)) / 2e-5 for s in h]
        return np.stack(slopes, axis=-1)


BOX = (np.array([-0.02, -0.02, -0.03]), np.array([0.02, 0.02, 0.01]))


def test_a_field_of_ones_own_is_sampled_over_its_box():
    own = as_field(Above(True), BOX)
    sampled = sampled_field(own, 4e-3)
    assert sampled.coil_names == ("coil",)
    np.testing.assert_allclose(sampled.lower, BOX[0])
    np.testing.assert_allclose(sampled.upper, BOX[1], rtol=1e-12)
    points = np.random.default_rng(3).uniform(*BOX, (20, 3))
    np.testing.assert_allclose(sampled.field(points, [1.5]), own.field(points, [1.5]), rtol=2e-3)
    assert sampled_field(sampled) is sampled


def test_cells_of_a_sampled_field_are_no_larger_than_asked_and_as_many_as_a_map_must_have():
    """40 mm at 9 mm give five cells of 8 mm; 12 mm would give two of 6 mm, but a map needs four."""
    thin = (BOX[0], BOX[0] + [0.04, 0.012, 0.016])
    (words,) = (
        one for one in sampled_field(as_field(Above(True), thin), 9e-3).assumptions if "sampled" in one
    )
    assert "8, 3, 4 mm" in words
    assert FEWEST_NODES == 1 + 4


@pytest.mark.parametrize(("field", "where"), [(as_field(Above(False), BOX), "field"), (Above(True), "Above")])
def test_what_cannot_be_sampled(field, where):
    with refused(InputError, where=where):
        sampled_field(field)


def test_a_saturating_field_is_refused_with_the_way_out():
    with refused(InputError, remedy="fieldmap map"):
        prepare(read_scenario("hold"), as_field(Above(False), BOX))


def test_a_device_in_the_place_of_a_map_is_that_of_the_scenario_unless_it_names_one(monkeypatch):
    taken = []

    def caught(scenario, field, device, controller):
        taken.append((field, None if device is None else device.name))
        raise FieldmapError(Problem("here", "must end", "", ""))

    monkeypatch.setattr("fieldmap.dynamics.scenario.batches.prepare", caught)
    monkeypatch.setattr("fieldmap.iron.solve_linear", lambda device, **options: "solved")
    for named in ([], ["--set", "device=drive_unit"]):
        assert main(["simulate", "hold", "--map", str(DEVICE), *named]) == 1
    assert taken == [("solved", "loop_and_coarse_sphere"), ("solved", None)]


def test_a_table_of_saturating_iron_has_the_background(saturating):
    """The background has the weight 1 in the table, inside and outside the division."""
    plain, data = saturating(), saturating_data()
    model, (*_, flux), (*_, slope) = data.reduced_model, data.flux_density, data.gradient
    data = replace(
        data,
        flux_density=np.concatenate([data.flux_density, [np.broadcast_to([1e-3, 2e-3, 3e-3], flux.shape)]]),
        gradient=np.concatenate([data.gradient, [np.zeros_like(slope)]]),
        reduced_model=replace(model, fixed=np.tile([1e-3, 2e-3, 3e-3], len(model.weights))),
        fixed_sources=("background",),
        constant_field=True,
    )
    opened = interpolate(data, outside_currents="evaluate", tabulate_currents=True)
    exact = interpolate(data, outside_currents="evaluate")
    inside = np.random.default_rng(4).uniform(plain.lower, plain.upper, (20, 3))
    for signals in ((1.5, 0.0, 0.0), (1.3, 0.2, -0.1), (2.6, 0.1, 0.0)):
        currents = divide_currents(*signals, 1.25)
        b = exact.field(inside, currents)
        assert opened.field(inside, currents) == pytest.approx(b, abs=2e-3 * np.abs(b).max())
        weights = np.empty(10)
        tabled(opened).table.weights(currents, weights)
        assert weights[9] == pytest.approx(1.0, abs=1e-13)
    # The background also magnetises the iron, so the iron's weights differ from those without background.
    currents = divide_currents(1.5, 0.0, 0.0, 1.25)
    difference = exact.field(inside, currents) - plain.field(inside, currents)
    assert np.abs(difference - [1e-3, 2e-3, 3e-3]).max() > 1e-6
