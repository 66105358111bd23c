"""Optimisations, tolerances and fits with two workers of a scheduler give the numbers of one process."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.sources import CoilSet
from fieldmap.studies import (
    Carrying,
    FieldReadings,
    Uncertain,
    Unknown,
    Variable,
    analyse_tolerances,
    fit_machine,
)
from tests.conftest import DEVICES

pytest.importorskip("distributed")
LOOP, CARRIES = DEVICES / "thin_loop_with_driver.toml", Carrying([0, 0, -0.06])
POINTS = np.array([[0.0, 0.0, -0.02], [0.01, 0.0, -0.03]])


def tolerances(**how):
    uncertain = [Uncertain("coil.loop.turns", 10.0), Uncertain("payload.mass_g", 0.2)]
    found = analyse_tolerances(LOOP, uncertain, ["common_current"], currents=CARRIES, samples=5, **how)
    number = found["common_current"]
    return number.value, number.derivatives, number.sampled.mean, number.sampled.range


def optimum(**how):
    mass, turns = Variable("payload.mass_g", 5.0, 20.0), Variable("coil.loop.turns", 500, 2000)
    found = fm.optimise(LOOP, [mass, turns], "common_current", currents=CARRIES, tolerance=1e-3, **how)
    return found.values, [step.numbers for step in found.path]


def fit(**how):
    device = fm.read_device(LOOP)
    read = FieldReadings("table", POINTS, [1.0], CoilSet(device.coils).field(POINTS, [1.0]), 1e-7)
    unknowns = [
        Unknown(f"coil.loop.{key}", start) for key, start in (("turns", 900.0), ("position_mm.3", 1.0))
    ]
    found = fit_machine(LOOP, unknowns, [read], **how)
    return found.values, found.covariance.tolist()


@pytest.fixture(scope="module")
def scheduler():
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        yield cluster.scheduler_address


@pytest.mark.parametrize("work", [tolerances, optimum, fit])
def test_the_numbers_are_those_of_one_process(work, scheduler, monkeypatch):
    from fieldmap.parallel.pool import Pool

    alone, mapped, shared = work(), Pool.map, []

    def counting(self, function, items, common):
        shared.append(len(items))
        return mapped(self, function, items, common)

    monkeypatch.setattr(Pool, "map", counting)
    assert work(scheduler=scheduler) == alone
    # Both sides of a difference, or one design per unknown.
    assert max(shared) >= 2
