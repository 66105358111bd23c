"""Report of a run to a tolerance: the cost of a sufficient mesh for known powers, the share of each body in the error
for equal bodies, and the numbers in words."""

import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device.model import Background, Body, Box, Device, LinearMaterial, Part, WorkspaceBox, placed
from fieldmap.errors import InputError
from fieldmap.iron import Tolerance, generate_mesh
from fieldmap.iron.error import (
    BothForms,
    ErrorEstimate,
    ErrorShare,
    ExpectedCost,
    LargestError,
    MeshStep,
    ToleranceReport,
    estimate_error,
    expected_cost,
    faces_within,
    workspace_surface,
)
from fieldmap.iron.materials import body_properties
from fieldmap.iron.mesh.mesher import LocalSizes, MesherCells
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.report import Stages
from fieldmap.iron.solvers import to_tolerance
from fieldmap.iron.solvers.to_tolerance import Level
from tests.refusals import refused


def steps(power, *faces):
    """Meshes whose error over the tolerance is 4 at 1000 faces and falls with a power of their number."""
    return [
        SimpleNamespace(faces=n, excess=4.0 * (n / 1000.0) ** -power, seconds=2.0 * (n / 1000.0) ** 1.5)
        for n in faces
    ]


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_faces_at_which_the_error_is_the_tolerance(power):
    expected = 1000.0 * 4.0 ** (1.0 / power)
    assert faces_within(steps(power, 1000.0, 1500.0)) == pytest.approx(expected, rel=1e-9)
    assert faces_within(steps(power, 1000.0, 1500.0, 6000.0)) == pytest.approx(expected, rel=1e-9)


def test_nothing_is_said_of_what_hardly_falls():
    assert faces_within(steps(1.0, 1000.0)) is None
    assert faces_within(steps(1.0, 1000.0, 1100.0)) is None
    assert faces_within(steps(0.2, 1000.0, 4000.0)) is None
    # A forecast needs a fifth more faces and an exponent of a quarter; a mesh without an error estimate does not count.
    assert faces_within(steps(1.0, 1000.0, 1199.0)) is None
    assert faces_within(steps(1.0, 1000.0, 1201.0)) == pytest.approx(4000.0)
    assert faces_within(steps(0.249, 1000.0, 4000.0)) is None
    assert faces_within(steps(0.251, 1000.0, 4000.0)) == pytest.approx(1000.0 * 4.0 ** (1.0 / 0.251))
    first, second = steps(1.0, 1000.0, 2000.0)
    first.excess = None
    assert faces_within([first, second]) is None
    assert faces_within([first]) is None


def test_time_goes_with_the_power_that_was_measured():
    known = expected_cost(steps(1.0, 1000.0, 2000.0), 8000.0, 1.0, 1.0)
    assert known.seconds == pytest.approx(2.0 * 8.0**1.5, rel=1e-9)
    # The exponent is 2 for one mesh alone, and where the first mesh took no measurable time.
    first, second = steps(1.0, 1000.0, 3000.0)
    first.seconds, second.seconds = 0.0, 2.0
    assert expected_cost([first, second], 9000.0, 1.0, 1.0).seconds == pytest.approx(18.0, rel=1e-9)
    assert expected_cost(steps(1.0, 1000.0), 3000.0, 1.0, 1.0).seconds == pytest.approx(18.0, rel=1e-9)
    # The exponent is kept between 1 and 3, and is 2 for meshes that hardly differ.
    for last, power in ((2.5, 1.0), (100.0, 3.0)):
        known = [SimpleNamespace(faces=1000, seconds=2.0), SimpleNamespace(faces=2000, seconds=last)]
        assert expected_cost(known, 6000.0, 1.0, 1.0).seconds == pytest.approx(last * 3.0**power)
    for faces, power in ((1200, 2.0), (1201, 3.0)):
        known = [SimpleNamespace(faces=1000, seconds=2.0), SimpleNamespace(faces=faces, seconds=9.0)]
        assert expected_cost(known, 2.0 * faces, 1.0, 1.0).seconds == pytest.approx(9.0 * 2.0**power)
    cost = expected_cost(steps(1.0, 1000.0), 3000.4, 7000.6, 5.5)
    assert (cost.faces, cost.tetrahedra, cost.matrix_bytes) == (3000, 7001, 5.5)


def test_bodies_that_are_alike_share_the_error_alike():
    """Cubes left and right of the workspace in a field along z, and two cubes far away."""
    places = {"far": 0.3, "left": -0.03, "right": 0.03, "farther": -0.3}
    bodies = [
        Body(name, "iron", (Part(Box((0.02, 0.02, 0.02)), placed((x, 0.0, -0.01))),), 6e-3)
        for name, x in places.items()
    ]
    space = WorkspaceBox([-0.012, -0.004, -0.004], [0.012, 0.004, 0.004])
    laws = {"iron": LinearMaterial("iron", 1000.0)}
    device = Device(
        "d", "", (), bodies, laws, background=Background(np.array([0.0, 0.0, 0.01])), workspace=space
    )
    iron = assemble(generate_mesh(device, 1.0, symmetry="none"))
    asked = Tolerance(0.01)
    about = body_properties(device, None), workspace_surface(device), 1e-4, Stages(None), asked
    level = Level.solved(device, iron, *about)
    shares = {one.body: one for one in level.shares_of_bodies(level.next_sizes(4.0))}
    assert sum(one.share for one in shares.values()) == pytest.approx(1.0)
    body, below = iron.mesh.body, iron.topology.owner[iron.topology.surface, 0]
    own, inside = level.face_shares.across + level.face_shares.rest, level.element_shares
    whole = own.sum() + inside.sum()
    for number, name in enumerate(places):
        expected = (own[body[below] == number].sum() + inside[body == number].sum()) / whole
        assert shares[name].share == pytest.approx(expected, rel=1e-9)
    # The mesher makes no mirror images.
    assert 0.35 < shares["left"].share < 0.65
    assert shares["far"].share < 0.02
    assert shares["farther"].share < 0.02
    assert set(list(shares)[:2]) == {"left", "right"}
    for name, x in places.items():
        assert np.abs(np.array(shares[name].at) - [x, 0.0, 0.0]).max() < 0.01
        assert 2e-3 < shares[name].size < 2e-2
    # Most of the error is at the side of the workspace, where the next mesh is finer.
    assert shares["left"].at[0] > -0.03
    assert shares["right"].at[0] < 0.03
    assert all(shares[name].wanted < shares[name].size for name in ("left", "right"))
    assert all(one.wanted == one.size and one.layer is None for one in level.shares_of_bodies())


@pytest.mark.parametrize(
    ("asked", "allowed", "size"),
    [
        (Tolerance(0.01), [0.02, 0.005, 0.01], [2.0, 0.5, 1.0]),
        # At 4 A and 2 A, 8 mT are 2 and 4 mT per ampere: 0.1, 0.8 and 0.8 % of the fields of 1 A and of the magnets.
        (Tolerance(absolute_flux_density=8e-3, currents=(4.0, -2.0)), [2e-3, 4e-3, 8e-3], [2.0, 4.0, 8.0]),
        # A coil without current may have any error, and hardly counts.
        (Tolerance(absolute_flux_density=8e-3, currents=(0.0, 2.0)), [np.inf, 4e-3, 8e-3], [2e6, 0.5, 1.0]),
        (Tolerance(gradient=0.1), [np.inf] * 3, [2.0, 0.5, 1.0]),
    ],
)
def test_sources_count_by_what_is_allowed(asked, allowed, size):
    """The size of a source is its allowed error over the smallest ratio of an allowed error to its field."""
    fields = np.zeros((3, 4, 3))
    fields[0, 1], fields[1, :, 2], fields[2, 3] = [1.2, 0.0, -1.6], 0.5, [0.0, 1.0, 0.0]
    solution = SimpleNamespace(
        source_fields=lambda _: (fields, None),
        coils=("a", "b"),
        sources=("1 A in a", "1 A in b", "the magnets"),
    )
    level = Level(None, np.zeros((4, 3)), (), (solution,), asked)
    assert level._allowed == pytest.approx(np.array(allowed))
    assert level._size == pytest.approx(np.array(size))
    shares = replace(level, asked=asked)
    vars(shares)["face_shares"] = SimpleNamespace(totals=np.array([0.1, 0.2, 0.3]))
    assert shares.relative_shares == pytest.approx(np.array([0.1, 0.2, 0.3]) * size / [2.0, 0.5, 1.0])
    assert level.solution is solution
    assert level.complement is None


def test_shares_of_bodies_are_those_of_their_faces_and_elements():
    """Three bodies of two cells each; the first has most of its error at a sharp edge, the last none."""
    at_edge = np.array([True, False, True, False, True, True])
    shares = SimpleNamespace(
        across=np.array([4.0, 1.0, 0.5, 0.0, 0.0, 0.0]),
        rest=np.array([1.0, 1.0, 2.0, 1.5, 0, 0]),
        at_edge=at_edge,
    )
    cells = MesherCells(np.arange(6), np.arange(18.0).reshape(6, 3), 1e-3 * np.arange(1.0, 7.0))
    mesh = SimpleNamespace(cells=cells, body=np.array([0, 0, 1, 1, 2, 2]), body_names=("a", "b", "c"))
    about = {"_iron": SimpleNamespace(mesh=mesh), "_below": np.arange(6)}
    level = SimpleNamespace(face_shares=shares, element_shares=np.array([0, 0, 1.5, 7.5, 0, 0]), **about)
    places, layers = cells.centres[[0, 3]], np.array([2e-5, 3e-5])
    sizes = LocalSizes(cells.centres, 0.5 * cells.sizes, places, layers)
    # The sum is 20: 7 in the first body, 5 of them in one cell, and 13 in the second, 9 of them in one cell.
    second, first = Level.shares_of_bodies(level, sizes)
    assert first == ErrorShare("a", 0.35, (0.0, 1.0, 2.0), 1e-3, 5e-4, 2e-5)
    assert second == ErrorShare("b", 0.65, (9.0, 10.0, 11.0), 4e-3, 2e-3)
    # A layer is reported where more than half of a cell's share is at an edge.
    mesh.body = np.array([0, 0, 1, 2, 2, 2])
    (found,) = (one for one in Level.shares_of_bodies(level, sizes) if one.body == "b")
    assert (found.share, found.layer) == (0.2, 3e-5)
    level.element_shares[2] = 2.6
    (found,) = (one for one in Level.shares_of_bodies(level, sizes) if one.body == "b")
    assert found.layer is None
    assert [one.layer for one in Level.shares_of_bodies(level)] == [None, None, None]


@pytest.mark.parametrize(
    ("symmetry", "count"), [(None, 1), (SimpleNamespace(group=SimpleNamespace(order=12)), 12)]
)
def test_operations_are_those_of_the_symmetry(symmetry, count):
    level = SimpleNamespace(_iron=SimpleNamespace(mesh=SimpleNamespace(symmetry=symmetry)))
    assert Level.operations.fget(level) == count


@pytest.mark.parametrize(
    ("shares", "excess"), [([0.3, 0.2], 3.0), ([0.05, 0.02], 0.5), ([0.5, 0.1], 5.0), ([], 0.25)]
)
def test_one_mesh_alone_exceeds_by_its_shares_or_its_gap(monkeypatch, shares, excess):
    """The allowed errors are 0.2 T at fields of 2 T; the gap between the forms is 0.25 of the allowed error."""
    gap = ErrorEstimate(0.0, 0.0, None, None, by_source=(LargestError("B", "a", (0, 0, 0), 0.05, 2.0),))
    monkeypatch.setattr(to_tolerance, "estimate_error", lambda *_: gap)
    count = len(shares)
    level = SimpleNamespace(
        points=None, solution=SimpleNamespace(coils=("a",)), complement=None, asked=Tolerance(0.1),
        face_shares=SimpleNamespace(totals=np.array(shares)), _size=np.full(count, 2.0), _allowed=np.full(count, 0.2),
    )  # fmt: skip
    assert Level.own_excess.fget(level) == pytest.approx(excess)


PLACES = np.array([[0.0, 0, 0], [0.02, 0, 0], [0, 0.04, 0.04]])
MIDDLE = np.array([0.01, 0.02, 0.02])
SOURCES = ("1 A in a", "the magnets")


def fields_of(flux, slope):
    """A solution with B (c, 4, 3) and gradient (c, 4, 3, 3) at three places and in the middle of these."""

    def at(points):
        np.testing.assert_allclose(points, [*PLACES, MIDDLE])
        return np.array(flux), np.array(slope)

    iron = MIDDLE + [[0.0, 0.0, -0.05], [0.2, 0.0, 0.0]]
    return SimpleNamespace(source_fields=at, sources=SOURCES, iron_points=iron)


FLUX, SLOPE = np.zeros((2, 4, 3)), np.zeros((2, 4, 3, 3))
FLUX[0, :, 2], FLUX[1, :, 0] = [3.0, 4.0, 1.0, 2.0], [-0.5, 0.25, 0.0, -0.4]
SLOPE[0, :, 2, 2], SLOPE[1, 1, 0, 1] = [10.0, 0.0, 5.0, 1.0], 40.0


def moved(source, place, by, gradient=0.0):
    """The same fields with an error of one source at one place."""
    flux, slope = FLUX.copy(), SLOPE.copy()
    flux[source, place, 1] += by
    slope[source, place, 0, 2] += gradient
    return fields_of(flux, slope)


def test_an_estimate_is_the_largest_error_over_the_size_of_each_source():
    """Sizes of B are 4 T and 0.5 T; sizes of the gradient are 80 T/m (4 T over 50 mm to the iron) and 40 T/m."""
    here = fields_of(FLUX, SLOPE)
    alone = estimate_error(PLACES, here, None, None)
    assert (alone.flux_density, alone.gradient, alone.change, alone.gap) == (0.0, 0.0, None, None)
    assert alone.length == pytest.approx(0.05)
    changed = estimate_error(PLACES, here, moved(1, 2, 0.06, 7.0), None)
    assert (changed.flux_density, changed.gradient) == pytest.approx((0.12, 7.0 / 40.0))
    assert changed.change == pytest.approx((0.12, 0.175))
    assert (changed.gap, changed.both_forms, changed.shares) == (None, None, None)
    told = [(one.quantity, one.source, one.error, one.size) for one in changed.by_source]
    assert told == [
        ("B", SOURCES[0], 0.0, 4.0),
        ("B", SOURCES[1], pytest.approx(0.06), 0.5),
        ("gradient", SOURCES[0], 0.0, pytest.approx(80.0)),
        ("gradient", SOURCES[1], 7.0, pytest.approx(40.0)),
    ]
    assert changed.by_source[1].at == tuple(PLACES[2])
    assert changed.worst("B") is changed.by_source[1]
    assert changed.worst("gradient").relative == pytest.approx(0.175)
    # The estimate is half of the difference of two forms; their largest component of B in the middle is reported.
    other = moved(0, 3, 0.5, 8.0)
    between = estimate_error(PLACES, here, None, other)
    assert between.gap == pytest.approx((0.125, 0.1))
    assert (between.flux_density, between.gradient) == pytest.approx((0.0625, 0.05))
    forms = between.both_forms
    assert (forms.what, forms.source, forms.at) == ("Bz", SOURCES[0], tuple(MIDDLE))
    assert (forms.solution, forms.complement) == (2.0, 2.0)
    both = estimate_error(PLACES, here, moved(1, 2, 0.06), other)
    assert (both.flux_density, both.gradient) == pytest.approx((0.12, 0.05))
    apart = estimate_error(PLACES, here, None, moved(1, 3, 0.3)).both_forms
    assert (apart.what, apart.source, apart.solution) == ("Bx", SOURCES[1], -0.4)


@pytest.mark.parametrize(
    ("growth", "shares", "factor"),
    # Where the number of faces doubles or more, the change counts as it is.
    [(1.0, None, 1.0), (2.0, None, 1.0), (0.25, None, 4.0), (1e-9, None, 1000.0)]
    # Twice the sum of the shares is the other estimate; the smaller of the two counts, for B only.
    + [(1.0, [0.5, 0.07], 1.0), (1.0, [0.5, 0.05], 0.1 / 0.12), (0.25, [0.0, 0.1], 0.2 / 0.12)],
)
def test_a_change_counts_more_where_the_mesh_hardly_grew_and_no_more_than_twice_the_shares(
    growth, shares, factor
):
    given = None if shares is None else np.array(shares)
    found = estimate_error(PLACES, fields_of(FLUX, SLOPE), moved(1, 2, 0.06, 4.0), None, given, growth)
    assert found.flux_density == pytest.approx(0.12 * factor)
    assert found.gradient == pytest.approx(0.1 * max(1.0, 1.0 / max(growth, 1e-3)))
    assert found.change == pytest.approx((0.12, 0.1))
    assert found.shares == (None if shares is None else max(shares))


def test_a_source_without_a_field_has_no_relative_error():
    none = fields_of(0 * FLUX, 0 * SLOPE)
    found = estimate_error(PLACES, none, moved(0, 1, 0.1), moved(0, 1, 0.1))
    assert (found.flux_density, found.gradient, found.gap) == (0.0, 0.0, (0.0, 0.0))
    assert [one.relative for one in found.by_source] == [0.0] * 4
    assert ErrorEstimate(0.0, 0.0, None, None).worst("B") is None


def test_the_surface_of_a_workspace_has_five_points_to_an_edge():
    space = WorkspaceBox([-0.01, 0.0, 0.02], [0.03, 0.01, 0.04])
    around = {"background": Background(np.array([0.0, 0.0, 0.01]))}
    points = workspace_surface(Device("d", "", (), (), {}, workspace=space, **around))
    assert len(points) == 5**3 - 3**3
    share = (points - space.lower) / (space.upper - space.lower)
    assert set(share.round(9).ravel()) == {0.0, 0.25, 0.5, 0.75, 1.0}
    assert ((share < 1e-9) | (share > 1 - 1e-9)).any(axis=1).all()
    with refused(InputError, where="device 'd'"):
        workspace_surface(Device("d", "", (), (), {}, **around))


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        ({"flux_density": 0.999}, []),
        ({"flux_density": 1.0}, ["Tolerance, flux_density"]),
        ({"flux_density": 0.0}, ["Tolerance, flux_density"]),
        ({"gradient": 5.0}, []),
        ({"gradient": np.inf}, ["Tolerance, gradient"]),
        (
            {"gradient": 0.0, "absolute_gradient": 0.0},
            ["Tolerance, gradient", "Tolerance, absolute_gradient"],
        ),
        ({"absolute_flux_density": 1e-9}, []),
        ({"absolute_flux_density": np.inf}, ["Tolerance, absolute_flux_density"]),
        ({"absolute_gradient": np.nan}, ["Tolerance, absolute_gradient"]),
        ({}, ["Tolerance, flux_density"]),
        ({"flux_density": 0.1, "currents": (1, 0)}, []),
        ({"flux_density": 0.1, "currents": (1.0, np.nan)}, ["Tolerance, currents"]),
    ],
)
def test_tolerances_that_cannot_be(given, wrong):
    if not wrong:
        assert Tolerance(**given).currents == given.get("currents")
        return
    with pytest.raises(InputError) as caught:
        Tolerance(**given)
    assert [problem.where for problem in caught.value.problems] == wrong


def test_the_worst_error_is_the_largest_multiple_of_what_is_allowed():
    errors = [
        LargestError(quantity, source, (0, 0, 0), error, size)
        for quantity, source, error, size in (
            ("B", "a", 0.02, 2.0),
            ("B", "magnets", 0.3, 3.0),
            ("gradient", "a", 5.0, 10.0),
            ("gradient", "magnets", 1.0, 10.0),
        )
    ]
    estimate = ErrorEstimate(0.1, 0.5, None, None, by_source=tuple(errors))
    # The magnets' B has 10 times the allowed error of 1 %; at 2 A the coil's gradient has 8 times the allowed 1.25 T/m.
    assert Tolerance(0.01).worst(estimate, 1) == (errors[1], pytest.approx(10.0))
    asked = Tolerance(absolute_gradient=1.25, currents=(2.0,))
    assert asked.worst(estimate, 1) == (errors[2], pytest.approx(8.0))
    assert asked.excess(estimate, 1) == pytest.approx(8.0)
    assert Tolerance(0.01).excess(ErrorEstimate(0.0, 0.0, None, None), 1) == 0.0
    # The larger of the relative and the absolute part is allowed.
    either = Tolerance(0.01, absolute_flux_density=0.5)
    assert [either.allowed(one, 0, 1) for one in errors[:2]] == [0.5, 0.5]
    assert Tolerance(0.3, absolute_flux_density=0.5).allowed(errors[1], 1, 1) == pytest.approx(0.9)


def test_numbers_in_words():
    """Lengths in mm, fields in mT, gradients in T/m, shares in %; what does not apply is left out."""
    numbers = partial(re.findall, r"-?\d[\d,.e-]*")
    share = ErrorShare("pole", 0.625, (0.0125, -0.002, 0.03), 2.5e-3, 1.2e-3)
    assert numbers(str(share)) == ["62", "12.5,", "-2,", "30", "2.5", "1.2"]
    assert numbers(str(replace(share, wanted=2.5e-3))) == ["62", "12.5,", "-2,", "30", "2.5"]
    assert numbers(str(replace(share, layer=7e-5)))[-1] == "0.07"
    cost = ExpectedCost(12345, 67890, 2.34e9, 56.4)
    assert str(cost) == "12,345 surface faces, 67,890 tetrahedra, 2.3 GB, 56 s"
    worst = LargestError("B", "coil 'a'", (0.001, 0.002, -0.0035), 2.5e-5, 2e-3)
    assert str(worst) == "B of coil 'a' at (1, 2, -3.5) mm: 0.025 mT, 1.2 % of 2 mT"
    slope = LargestError("gradient", "the magnets", (0.0, 0.0, 0.01), 0.012, 0.4)
    assert str(slope) == "gradient of the magnets at (0, 0, 10) mm: 0.012 T/m, 3 % of 0.4 T/m"
    asked = Tolerance(0.015, absolute_flux_density=2e-6, absolute_gradient=1e-3)
    assert str(asked) == "1.5 % or 2e-06 T of B, 0.001 T/m of its gradient"
    step = MeshStep(100, 300, 80000, 1.5)
    report = ToleranceReport(asked, "meshes", (step, step), worst, (share,), cost, replace(cost, faces=40000))
    said = (str(asked), "2 meshes", str(worst), str(share), str(cost), str(report.whole))
    assert [words in str(report) for words in said] == [True] * 6
    reached = replace(report, ended="reached", steps=(step,))
    assert (reached.reached, report.reached) == (True, False)
    assert [words in str(reached) for words in said] == [True, False, True, False, False, False]
    forms = BothForms("Bz", (0.0, 0.001, 0.02), "coil 'a'", -0.012, -0.0125)
    assert re.findall(r"-?[\d.]+", str(forms)) == ["0", "1", "20", "-12", "-12.5", "4"]
    assert "between" not in str(forms)
    error = ErrorEstimate(0.013, 0.025, (0.011, 0.02), (0.006, 0.01), forms, 0.0042)
    assert re.findall(r"([\d.]+) %", str(error)) == ["1.3", "2.5", "1.1", "0.42", "0.6", "4"]


def test_what_a_single_number_asks_for():
    """The gradient may err three times as much as B. Each mesh is solved to the smallest relative part, and to 1e-3 at
    most where an absolute part may be the one that counts."""
    plain = Tolerance.of(0.01)
    assert (plain.flux_density, plain.gradient, plain.solving) == (0.01, pytest.approx(0.03), 0.01)
    assert (Tolerance.of(0.01, 0.002).solving, Tolerance.of(0.01, np.inf).gradient) == (0.002, None)
    assert [Tolerance(of, absolute_gradient=1e-3).solving for of in (0.01, 1e-4)] == [1e-3, 1e-4]
    assert Tolerance.of(plain) is plain
