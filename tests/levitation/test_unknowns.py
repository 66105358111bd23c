"""Unknowns found from readings that are linear in them: every stated number has a closed form of linear algebra."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.levitation.unknowns import Unknown, find_unknowns

A, B = Unknown("a", 3.0), Unknown("b", -40.0, prior=(-45.0, 8.0), step=2.0)
# Slopes of the readings in two tables by the unknowns; the last table is predicted.
SLOPES = (np.array([[1.0, 0.1], [2.0, -0.3], [-1.0, 0.2], [0.5, 0.4]]), np.array([[1.0, 1.0], [3.0, -2.0]]))
READ = (np.array([1.2, 15.0, np.nan, -18.0]), np.array([-40.0, 90.0]))
DEVIATION = (np.array([0.5, 0.25, 1.0, 2.0]), 3.0)


def tables():
    return [
        SimpleNamespace(name=name, measured=read, deviation=deviation)
        for name, read, deviation in zip(("used", "other"), READ, DEVIATION, strict=True)
    ]


def compute(values, asked):
    x = np.array([values["a"], values["b"]])
    return [SLOPES[("used", "other").index(one.name)] @ x for one in asked]


def misfit(x, k):
    there = np.isfinite(READ[k])
    return np.sqrt(np.mean(((SLOPES[k] @ x - READ[k]) / DEVIATION[k])[there] ** 2))


def test_values_covariance_and_misfits_are_those_of_linear_algebra():
    told = []
    found = find_unknowns("here", [A, B], tables(), 1, compute, told.append)
    there = np.isfinite(READ[0])
    rows = np.vstack([(SLOPES[0] / DEVIATION[0][:, None])[there], [0.0, 1.0 / 8.0]])
    x = np.linalg.lstsq(rows, np.append((READ[0] / DEVIATION[0])[there], -45.0 / 8.0), rcond=None)[0]
    assert list(found.values) == ["a", "b"]
    np.testing.assert_allclose(list(found.values.values()), x, rtol=1e-6)
    covariance = np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6)
    begin = np.array([3.0, -40.0])
    assert (found.misfit, found.misfit_before) == pytest.approx((misfit(x, 0), misfit(begin, 0)), rel=1e-6)
    assert (found.indistinct, found.alike, found.notes) == ((), (), ())
    for k, one in enumerate(found.tables):
        known = np.isfinite(READ[k])
        assert (one.name, one.used) == (("used", "other")[k], k == 0)
        np.testing.assert_array_equal(one.measured, READ[k][known])
        np.testing.assert_allclose(one.before, (SLOPES[k] @ begin)[known])
        np.testing.assert_allclose(one.after, (SLOPES[k] @ x)[known], rtol=1e-6)
        spread = np.sqrt(np.einsum("nk,kl,nl->n", SLOPES[k], covariance, SLOPES[k]))
        np.testing.assert_allclose(one.uncertainty, spread[known], rtol=1e-6)
        expected = misfit(x, k), misfit(begin, k)
        assert (one.misfit, one.misfit_before) == pytest.approx(expected, rel=1e-6)
    assert found.solves == len(told)
    assert told[0] == {"a": 3.0, "b": -40.0}


def test_one_process_computes_all_tables_of_a_place_at_once_and_workers_each_by_itself():
    def counted(asked):
        def of(values, some):
            asked.append([one.name for one in some])
            return compute(values, some)

        return of

    one, many = [], []
    alone = find_unknowns("here", [A, B], tables(), 2, counted(one))
    spread = find_unknowns("here", [A, B], tables(), 2, counted(many), workers=lambda f, jobs: map(f, jobs))
    assert {tuple(names) for names in one} == {("used", "other")}
    assert {tuple(names) for names in many} == {("used",), ("other",)}
    assert (alone.solves, spread.solves) == (len(one), len(many)) == (len(one), 2 * len(one))
    assert alone.values == spread.values


@pytest.mark.parametrize(("end", "side"), [("upper", 1.0), ("lower", -1.0)])
def test_a_fit_that_ends_at_a_bound_says_so(end, side):
    """a = side 9 is measured and side 5 is allowed: there derivatives are taken to the inner side."""
    table = SimpleNamespace(name="used", measured=[9.0 * side], deviation=0.5)
    one = Unknown("a", 4.0 * side, **{end: 5.0 * side}, step=0.1)
    inside = []

    def stepped(values, asked):
        inside.append(side * values["a"])
        return [np.array([values["a"]])]

    found = find_unknowns("here", [one], [table], 1, stepped)
    assert found.values["a"] == pytest.approx(5.0 * side, rel=1e-6)
    assert [note.split()[-1] for note in found.notes] == ["a"]
    assert max(inside) <= 5.0
    assert found.covariance[0, 0] == pytest.approx(0.25, rel=1e-6)


def test_a_number_that_cannot_be_computed_turns_the_fit_back():
    table = SimpleNamespace(name="used", measured=[1.9**3, 1.0], deviation=0.01)

    def cubic(values, asked):
        a = values["a"]
        return [np.array([a**3 if a < 2.0 else np.nan, 1.0])]

    found = find_unknowns("here", [Unknown("a", 0.6)], [table], 1, cubic)
    assert found.values["a"] == pytest.approx(1.9, rel=1e-5)


@pytest.mark.parametrize(
    ("one", "difference"),
    [(Unknown("a", 4.0, step=0.5), 0.5), (Unknown("a", -4.0), 0.04), (Unknown("a", 0.0), 0.01)],
)
def test_the_step_of_a_derivative(one, difference):
    assert one.difference == pytest.approx(difference)


@pytest.mark.parametrize(("deviation", "indistinct"), [(1.8, ()), (2.2, (("a",),))])
def test_what_is_known_no_better_than_its_own_size_is_indistinct(deviation, indistinct):
    table = SimpleNamespace(name="used", measured=[2.0], deviation=deviation)
    found = find_unknowns("here", [Unknown("a", 2.0)], [table], 1, lambda v, _: [np.array([v["a"]])])
    assert found.indistinct == indistinct


@pytest.mark.parametrize(("part", "names"), [(0.19, ("b",)), (0.21, ("a", "b"))])
@pytest.mark.parametrize(("weak", "alike"), [(2e-6, False), (5e-7, True)])
def test_who_belongs_to_a_combination_that_is_not_held(part, names, weak, alike):
    """Two combinations of unknowns of size 10 and 0.1, in units of their sizes; one is hardly measured."""
    size, along = np.array([10.0, 0.1]), np.array([part, np.sqrt(1 - part**2)])
    across, truth = along[::-1] * [1, -1], np.array([10.0, 0.1])
    slopes = np.array([across, weak * along]) / size
    table = SimpleNamespace(name="used", measured=slopes @ truth, deviation=1e-3)
    unknowns = [Unknown("a", 10.0), Unknown("b", 0.1)]
    found = find_unknowns(
        "here", unknowns, [table], 1, lambda v, _: [slopes @ np.array([v["a"], v["b"]])], xtol=1e-12
    )
    assert found.indistinct == (names,)
    assert found.alike == (names if alike else ())


@pytest.mark.parametrize(
    ("unknowns", "deviation", "wrong"),
    [
        ([Unknown("a", 1.0, lower=1.0, upper=2.0)], 0.1, 0),
        ([Unknown("a", 2.0, lower=1.0, upper=2.0)], [0.1, 0.2], 0),
        ([Unknown("a", 0.999, lower=1.0, upper=2.0)], 0.1, 1),
        ([Unknown("a", 2.001, lower=1.0, upper=2.0)], 0.1, 1),
        ([Unknown("a", 1.0, lower=1.0, upper=1.0)], 0.1, 1),
        ([Unknown("a", np.inf)], 0.1, 1),
        ([Unknown("a", 1.0, prior=(1.0, 0.0))], 0.1, 1),
        ([Unknown("a", 1.0, prior=(np.nan, 1.0))], 0.1, 1),
        ([Unknown("a", 1.0, step=0.0)], 0.1, 1),
        ([Unknown("a", 1.0), Unknown("a", 1.0)], 0.1, 1),
        ([], 0.1, 1),
        ([Unknown("a", 1.0)], 0.0, 1),
        ([Unknown("a", 1.0)], [0.1, 0.0], 1),
        ([Unknown("a", 1.0)], [0.1, 0.1, 0.1], 1),
        ([Unknown("a", 1.0), Unknown("b", 1.0)], 0.1, 0),
        ([Unknown("a", 1.0), Unknown("b", 1.0), Unknown("c", 1.0)], 0.1, 1),
        ([Unknown("a", 1.0), Unknown("b", 1.0), Unknown("c", 1.0, prior=(1.0, 2.0))], 0.1, 0),
    ],
)
def test_mistakes_of_unknowns_and_tables(unknowns, deviation, wrong):
    table = SimpleNamespace(name="used", measured=[1.0, 2.0], deviation=deviation)

    def first_two(values, _):
        return [np.array([*values.values(), 0.0])[:2]]

    if not wrong:
        find_unknowns("here", unknowns, [table], 1, first_two)
        return
    with pytest.raises(InputError) as told:
        find_unknowns("here", unknowns, [table], 1, first_two)
    assert len(told.value.problems) == wrong
