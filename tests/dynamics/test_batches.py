"""Batches of runs: their number, the signals kept and the files written, against runs made one by one."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g as gravity

from fieldmap.dynamics import simulate, simulate_many
from fieldmap.dynamics.scenario import simulate_batches, write_simulation
from fieldmap.dynamics.scenario.batches import MOST_KEPT, Simulation
from fieldmap.errors import InputError
from fieldmap.lookup import open_map
from fieldmap.store import read_runs
from tests.refusals import refused

TEXT = (Path(__file__).parents[1] / "scenarios" / "step.toml").read_text()
SCENARIO = (
    TEXT[: TEXT.index("[[reference]]")].replace("duration_s = 1.0", "duration_s = 0.1")
    + "[noise]\nseed = 3\n"
)


@pytest.fixture(scope="module")
def scenario(six_coils, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "six.toml"
    path.write_text(SCENARIO.replace("six.h5", str(six_coils)))
    return path


def slope_of_six(z):
    """dBz/dz on the axis of six dipoles of 8 A m^2 at 1 A, 26 mm above the origin and 44 mm from the axis."""
    h = 0.026 - z
    r2 = 0.044**2 + h**2
    return 6 * 8e-7 * 3 * h * (5 * h**2 - 3 * r2) / r2**3.5


def test_one_batch_for_each_value_as_if_run_alone(scenario):
    found = simulate_batches(scenario, vary={"start.depth_mm": [10.0, 12.0]}, changes={"control.z.Kc": 0.4})
    assert [batch.label for batch in found.batches] == ["start.depth_mm = 10.0", "start.depth_mm = 12.0"]
    for batch, depth in zip(found.batches, (10.0, 12.0), strict=True):
        (one,) = batch.runs
        assert one.run is None
        alone = simulate(scenario, {"control.z.Kc": 0.4, "start.depth_mm": depth}, seed=3)
        assert one.metrics == alone.metrics
        # The sensor sees a point 15 mm above the magnet's centre.
        payload = batch.experiment.device.payload
        needed = payload.mass * gravity / (payload.moment * slope_of_six(-0.077 - 1e-3 * depth - 0.015))
        np.testing.assert_allclose(batch.experiment.operating_point.currents, needed, rtol=1e-3)
        assert batch.seconds >= 0
    assert not found.all_ended_early


def test_a_grid_of_two_varied_keys_as_if_each_were_run_alone(scenario):
    vary = {"control.z.Kc": [0.4, 0.6], "start.depth_mm": [10.0, 12.0]}
    found = simulate_batches(scenario, vary=vary, changes={"duration_s": 0.02})
    assert [tuple(batch.varied.values()) for batch in found.batches] == [
        (0.4, 10.0),
        (0.4, 12.0),
        (0.6, 10.0),
        (0.6, 12.0),
    ]
    assert found.batches[1].label == "control.z.Kc = 0.4, start.depth_mm = 12.0"
    for batch in found.batches:
        alone = simulate(scenario, {"duration_s": 0.02, **batch.varied}, seed=3)
        assert batch.runs[0].metrics == alone.metrics
    with refused(InputError, where="vary"):
        simulate_batches(scenario, vary={"control.z.Kc": []})


def test_runs_have_noise_of_their_own_that_the_seed_decides(scenario):
    def errors(**given):
        (batch,) = simulate_batches(scenario, runs=3, threads=1, **given).batches
        return [one.metrics.axes[2].rms_seen_mm for one in batch.runs]

    own = errors()
    assert len(set(own)) == 3
    assert errors() == errors(seed=3) == own
    assert set(errors(seed=4)).isdisjoint(own)


def test_signals_of_a_batch_are_kept_up_to_a_number(scenario):
    few = simulate_batches(scenario, runs=2, keep_signals=True, changes={"duration_s": 0.01})
    assert [one.run is None for one in few.batches[0].runs] == [False, False]
    many = simulate_batches(scenario, runs=MOST_KEPT + 1, keep_signals=True, changes={"duration_s": 0.01})
    assert {one.run is None for one in many.batches[0].runs} == {True}
    assert len(many.batches[0].runs) == MOST_KEPT + 1


def test_a_field_is_opened_once_for_all_batches(scenario, six_coils):
    opened = []

    def field():
        opened.append(open_map(six_coils))
        return opened[-1]

    found = simulate_batches(scenario, field=field, vary={"control.z.Kc": [0.4, 0.5, 0.6]})
    assert (len(opened), len(found.batches)) == (1, 3)
    assert found.batches[1].runs[0].metrics == simulate(scenario, seed=3).metrics


def test_progress_goes_from_batch_to_batch(scenario):
    told = []
    vary = {"control.z.Kc": [0.4, 0.6]}
    simulate_batches(scenario, vary=vary, runs=2, threads=1, progress=lambda *given: told.append(given))
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] < 0.5 < fractions[-1] <= 1
    assert all(message.startswith("control.z.Kc = 0.4") for message, fraction in told if fraction < 0.5)


def test_no_runs_are_refused(scenario):
    with pytest.raises(InputError) as error:
        simulate_batches(scenario, runs=0)
    assert (error.value.problems[0].where, error.value.problems[0].received) == ("runs", "0")


@pytest.mark.parametrize(
    ("events", "early"), [(("", "fell out"), False), (("fell out", "left the map"), True)]
)
def test_all_ended_early_only_if_none_came_to_its_end(events, early):
    batches = tuple(
        SimpleNamespace(runs=[SimpleNamespace(metrics=SimpleNamespace(event=event))]) for event in events
    )
    assert Simulation(batches).all_ended_early is early


def test_files_hold_the_signals_of_every_run(scenario, tmp_path):
    vary = {"control.z.Kc": [0.4, 0.6]}
    found = simulate_batches(scenario, vary=vary, runs=2, keep_signals=True)
    records, about = read_runs(write_simulation(tmp_path / "runs.h5", found))
    kept = [one.run for batch in found.batches for one in batch.runs]
    assert [record.about["value"] for record in records] == 2 * ["control.z.Kc = 0.4"] + 2 * [
        "control.z.Kc = 0.6"
    ]
    for record, run in zip(records, kept, strict=True):
        np.testing.assert_array_equal(record.arrays["sensed"][0], run.sensed)
    assert about["scenario"] == scenario.read_text()
    assert f'title = "{about["title"]}"' in TEXT
    single = simulate_batches(scenario, keep_signals=True)
    table = np.genfromtxt(write_simulation(tmp_path / "run.csv", single), delimiter=",", names=True)
    (one,) = single.batches[0].runs
    np.testing.assert_allclose(table["sensed_z_m"], one.run.sensed[:, 2], rtol=1e-8)


def test_as_plain_python(scenario):
    found = simulate_batches(scenario, vary={"control.z.Kc": [0.4]}, runs=2)
    plain = found.to_dict()
    assert plain["scenario"] == "six.toml"
    assert f'title = "{plain["title"]}"' in TEXT
    (batch,) = plain["batches"]
    assert batch["value"] == "control.z.Kc = 0.4"
    assert batch["varied"] == {"control.z.Kc": 0.4}
    assert [run["end_s"] for run in batch["runs"]] == [one.metrics.end_s for one in found.batches[0].runs]
    assert batch["rest"]["currents"] == found.first.operating_point.currents.tolist()
    assert plain["assumptions"] == list(found.first.machine.assumptions)


def test_one_thread_for_each_processor_unless_told(scenario, monkeypatch):
    seen = []

    def one_by_one(*given, threads, **more):
        seen.append(threads)
        return simulate_many(*given, threads=1, **more)

    monkeypatch.setattr("fieldmap.dynamics.scenario.batches.simulate_many", one_by_one)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    for given in ({}, {"threads": 2}):
        simulate_batches(scenario, runs=2, **given)
    assert seen == [3, 2]
