"""The benchmark runs, and the compared programs agree; their speed is not tested."""

import re

import numpy as np
import pytest


@pytest.fixture
def disk(program):
    return program("benchmarks.iron_disk")


def test_benchmark_prints_a_row_per_kernel(benchmark):
    rows = benchmark("kernels")["rows"]
    assert [row["kernel"].split(" (")[0] for row in rows] == [
        "circular loop",
        "cylindrical sheet",
        "charged triangle",
        "circular coil",
        "rounded square coil",
    ]
    for row in rows:
        assert row["difference"] < 1e-6
        assert row["field_ns"] > 0
        assert row["ratio"] > 0


def test_fields_as_magpylib_sources(benchmark):
    section = benchmark("magpylib")
    assert len(section["kinds"]) == 10
    assert max(row["difference"] for row in section["kinds"]) < 1e-6
    rows = section["rows"]
    assert [row["field"] for row in rows] == ["coils alone", "linear iron", "saturating iron"]
    for row in rows:
        assert row["difference"] < 1e-12
        assert row["moved"] < 1e-12
        assert row["force"] < 1e-3
        assert row["ratio"] > 0


def test_traffic_of_a_shared_object_does_not_grow_with_the_pieces(benchmark):
    pytest.importorskip("distributed")
    section = benchmark("traffic")
    passed = {(row["pieces"], row["way"]): row["bytes"] for row in section["rows"]}
    for pieces in (20, 40):
        # For each piece the client writes the object, the scheduler reads it, and the scheduler writes it to a worker.
        assert passed[pieces, "in each task"] > 3 * pieces * section["size"]
        assert passed[pieces, "fieldmap"] < 0.1 * passed[pieces, "in each task"]
    more = passed[40, "fieldmap"] - passed[20, "fieldmap"]
    assert more < section["size"]


def test_disk_against_finite_elements(disk):
    """mu_r 4000: the errors fall with the mesh size, at least with a power of 1.5, to the bounds."""
    coarse, middle, fine = (disk.fieldmap_row(refinement) for refinement in (0.5, 0.7, 1.0))
    assert fine.field_error < 0.35 * coarse.field_error
    assert fine.field_error < middle.field_error < 1.3e-3
    assert middle.gradient_error < 2e-3
    assert fine.field_error < 5e-4
    assert fine.gradient_error < 1e-3


def test_other_solver_sees_the_same_problem(disk):
    """Magnets only, with the coil's field applied at their centres: within 15 % with few cells."""
    pytest.importorskip("magpylib_material_response")
    row = disk.material_response_row(12, 2)
    assert row.unknowns == 3 * 2 * 112
    assert row.field_error < 0.15


@pytest.fixture
def peers(program):
    return program("benchmarks.peer_cases")


def test_cases_of_others(peers):
    """The reference values fit the points; coarse meshes come near them, and the cube's value is the published one."""
    for case in peers.CASES:
        exact = peers.truth(case.name)
        assert exact.shape == case.points.shape
        assert peers.relative_error(peers.our_field(case, 0.5, 0.1)[0], exact) < 1e-2
    polarizability, faces = peers.our_cube(0.4, 0.03)
    assert polarizability == pytest.approx(peers.POLARIZABILITY, rel=3e-3)
    assert faces > 500


def test_other_solver_comes_near_the_same_truth(peers):
    pytest.importorskip("magpylib_material_response")
    for case in peers.CASES:
        assert peers.relative_error(peers.their_field(case, 64)[0], peers.truth(case.name)) < 3e-2
        assert peers.relative_error(peers.finite_elements(case), peers.truth(case.name)) < 1e-2
    assert peers.their_cube(8)[0] == pytest.approx(peers.POLARIZABILITY, rel=3e-2)


def row(disk, seconds, error):
    return disk.Row("", "", 1, seconds, 2 * seconds, 0.0, error, None)


def test_times_are_compared_at_equal_error(disk):
    """Errors of 1/seconds for us and 100/seconds for them: a hundred times less time wherever both have measured."""
    ours = [row(disk, t, 1 / t) for t in (100.0, 400.0, 4000.0)]
    theirs = [row(disk, t, 100 / t) for t in (20_000.0, 80_000.0)]
    assert disk.seconds_at(ours, 2e-3) == pytest.approx((500.0, 1000.0))
    assert disk.slope(theirs) == pytest.approx(1.0)
    lines = disk.comparison(ours, theirs)
    assert all(re.findall(r"\b(\d+) times", line)[:2] == ["100", "100"] for line in lines[:2])
    assert "0.001" in lines[2]
    assert len(lines) == 3


def test_extrapolation_is_called_one(disk):
    ours = [row(disk, t, 1 / t) for t in (100.0, 4000.0)]
    theirs = [row(disk, t, 10 / t**0.5) for t in (1e4, 4e4, 9e4)]
    last = disk.comparison(ours, theirs)[-1]
    assert last.startswith("EXTRAPOLATED")
    assert re.findall(r"\b(\d+) times", last) == ["100000"]


def test_generation_is_compared_with_magpylib_on_the_same_coils(benchmark):
    rows = benchmark("generation")["rows"]
    assert all(row["rate"] > 0 for row in rows)
    differences = [row["difference"] for row in rows if row["difference"] is not None]
    # The magpylib model converges to our field with more shells.
    assert differences[0] > 10 * differences[1]
    assert differences[-1] < 1e-6
    assert sum("map of" in row["what"] for row in rows) == 1


def test_benchmark_of_dynamics_prints_a_row_per_machine(benchmark):
    result = benchmark("dynamics")
    assert len(result["rows"]) == 4
    assert all(row["times_real_time"] > 1 for row in result["rows"])
    assert result["many"]["runs"] == 10


def test_calls_on_two_threads_are_sorted_by_what_the_processors_were_worth(program):
    two_threads = program("benchmarks.two_threads")
    calls = np.array([[0.5, 1.9, 2.0], [0.52, 1.85, 1.9], [0.5, 1.0, 1.9], [0.9, 1.0, 1.1]])
    found = two_threads.gains(1.0, calls)
    assert {kind: gain["calls"] for kind, gain in found.items()} == {"all": 4, "own": 2, "one": 1}
    assert found["own"]["gain"] == pytest.approx(1 / 0.51)
    assert found["one"]["gain"] == pytest.approx(1 / 0.9)
    assert two_threads.gains(1.0, calls[:3])["one"] == {"calls": 0, "gain": None}
    (sentence,) = two_threads.sentences({"threads": found})
    fast, calls = re.search(r"(\d\.\d+) times as fast \((\d) calls\) with both", sentence).groups()
    assert (fast, calls) == ("1.96", "2")
