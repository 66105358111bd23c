"""Data gathered for a picture: the height of a shift, and the set that currents within a limit reach."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.device.payload import PayloadPiece, SoftSphere
from fieldmap.errors import InputError
from fieldmap.field import FieldAtCurrents
from fieldmap.io import FieldSource, find_source
from fieldmap.levitation import EquilibriumSurface, reachable
from fieldmap.plot import gather
from fieldmap.plot.gather import (
    DEFAULT_LIMIT,
    FieldDifference,
    floating_height,
    shown_device,
    shown_field,
    shown_mesh,
    shown_run,
)
from fieldmap.plot.shown import Shown
from fieldmap.store import RunRecord, write_runs
from tests.conftest import DEVICES
from tests.plot.conftest import Crooked, crooked_device, harmonic
from tests.refusals import refused


def source_of(field):
    about = ("a.h5", "", "map", field.coil_names, field.bounds, Payload(0.010, 0.8), None, None)
    return FieldSource(*about, make=lambda: field)


def test_the_shift_is_shown_where_the_magnet_floats(harmonic_map):
    """dBz/dz = b + c z per ampere on the axis: the force equals the weight at one height."""
    b, c = 0.04, 1.0
    source = source_of(harmonic_map(coil=(0.0, b, c, (0.0, 0.0))))
    height, why = floating_height(source, np.array([3.0]))
    assert height == pytest.approx((0.010 * 9.80665 / (0.8 * 3.0) - b) / c, abs=1e-8)
    assert "nowhere" not in why
    middle = -0.02 + 0.5 * 4 * 0.01
    height, why = floating_height(source, np.array([0.1]))
    assert height == pytest.approx(middle, abs=1e-12)
    assert "nowhere" in why


def test_the_shift_of_a_map_of_four_coils(harmonic_map):
    """Coil k: Bz = 0.1 z + 2 (z^2 - (r - r_k)^2 / 2) per ampere, r_k in the corners of a square of 40 mm.

    The magnet rests at the centroid of the currents, and a signal s along x or y moves it by s times 20 mm.
    """
    corners = 0.02 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    field = harmonic_map(**{name: (0.0, 0.1, 4.0, at) for name, at in zip("abcd", corners, strict=True)})
    shown = shown_field(source_of(field), np.full(4, 2.0), "shift", height=-0.01)
    x, y = np.meshgrid(shown.surface.x_signals, shown.surface.y_signals, indexing="ij")
    np.testing.assert_allclose(shown.surface.positions[..., 0], 0.02 * x, atol=1e-8)
    np.testing.assert_allclose(shown.surface.positions[..., 1], 0.02 * y, atol=1e-8)


def test_a_difference_is_that_of_both_fields_in_the_box_they_share(harmonic_map):
    first, second, points = (0.0, 0.0, 6.0), (1.0, 0.0, 0.0), np.array([[0.005, 0.0, -0.002]])
    one, other = (source_of(harmonic_map(coil=(*abc, (0.0, 0.0)))) for abc in (first, second))
    low, high = one.bounds
    other = replace(other, bounds=(low + 0.01, high + 0.01))
    shown = shown_field(one, np.array([2.0]), "difference", other)
    np.testing.assert_allclose((shown.lower, shown.upper), (low + 0.01, high))
    found = shown.state.field(points), shown.state.gradient(points)
    for of_both, of_one, of_other in zip(
        found, harmonic(points, *first), harmonic(points, *second), strict=True
    ):
        np.testing.assert_allclose(of_both, 2.0 * (of_one - of_other), atol=1e-12)
    for changed in ({"bounds": (high, high + 0.01)}, {"coil_names": ("other",)}):
        with refused(InputError, where="show, --minus"):
            shown_field(one, np.array([2.0]), "difference", replace(other, **changed))


@pytest.fixture
def six(dipole_map, circle_of_six, valid_text, tmp_path):
    """The map of six dipoles, of a device with all tables."""
    return find_source(dipole_map(circle_of_six, tmp_path / "six.h5", valid_text))


def test_what_a_map_reaches_is_within_the_limit_of_its_driver(six):
    assert six.driver.current_limit != DEFAULT_LIMIT
    found = shown_field(six, np.zeros(6), "reachable", kind="B").reachable
    middle = 0.5 * (six.bounds[0] + six.bounds[1])
    expected = reachable(six.field, middle, six.driver.current_limit)
    assert found.largest_along([0, 0, 1]) == pytest.approx(expected.largest_along([0, 0, 1]), rel=1e-12)


def test_reachable_forces_on_soft_iron_are_searched(six):
    """Within the limit, which some current reaches; the assumptions name the search."""
    bead = Payload(1e-4, pieces=(PayloadPiece(SoftSphere(1e-3, mu_r=100.0)),))
    one = shown_field(replace(six, payload=bead), np.zeros(6), "reachable", kind="force", limit=0.02)
    assert not one.reachable.exact
    assert one.reachable.moment.soft
    assert any("134 directions" in text for text in one.assumptions)
    assert np.abs(one.reachable.currents).max() == pytest.approx(0.02, rel=1e-9)
    assert np.shape(one.to_dict()["reachable"]["values"]) == (134, 3)


# Middle of the box of `Crooked`: (0.5, -2, -20) mm.
MIDDLE = np.array([0.0005, -0.002, -0.02])


@pytest.fixture
def crooked():
    """A field of the crooked device, with its payload of 10 g and 0.12 A m^2."""
    return replace(
        source_of(Crooked()),
        kind="device, linear iron",
        device=crooked_device(),
        payload=crooked_device().payload,
    )


def told(monkeypatch, *texts):
    monkeypatch.setattr(
        FieldSource, "assumptions", lambda self, currents=None: (*texts, str(np.asarray(currents).tolist()))
    )


def test_what_is_shown_of_a_device_and_of_its_mesh(monkeypatch):
    device, asked = crooked_device(), []
    shown = shown_device(device)
    assert (shown.title, shown.device, shown.payload, shown.field) == (
        "A crooked machine",
        device,
        device.payload,
        None,
    )
    mesh = SimpleNamespace(tets=np.zeros((7, 4)))
    monkeypatch.setattr("fieldmap.iron.generate_mesh", lambda *given: asked.append(given) or mesh)
    for options, refinement in (((), 1.0), ((0.5,), 0.5)):
        shown = shown_mesh(device, *options)
        assert (shown.title, shown.mesh, shown.device) == ("crooked: 7 tetrahedra", mesh, device)
        assert asked.pop() == (device, refinement)


@pytest.mark.parametrize("what", ["iron", "lines", "slices", "surfaces", "forces", "equilibrium", "other"])
def test_a_field_is_shown_at_its_currents(crooked, monkeypatch, capsys, what):
    told(monkeypatch, "warning: beyond saturation", "a note")
    monkeypatch.setattr(
        gather, "find_equilibrium", lambda *given: SimpleNamespace(position=MIDDLE + given[1][0])
    )
    shown = shown_field(crooked, np.array([1.5, -0.5]), what)
    assert shown.title == "a.h5 (device, linear iron), ring: 1.5 A, frame: -0.5 A"
    np.testing.assert_array_equal((shown.lower, shown.upper), (Crooked.lower, Crooked.upper))
    assert (shown.device, shown.payload, shown.everywhere, shown.mesh) == (
        crooked.device,
        crooked.payload,
        False,
        None,
    )
    if what == "other":
        assert (shown.field, shown.assumptions, capsys.readouterr().err) == (None, (), "")
        return
    np.testing.assert_allclose(
        shown.flux_density_at(MIDDLE[None]), Crooked().field(MIDDLE[None], [1.5, -0.5])
    )
    assert (shown.equilibrium is not None) == (what == "equilibrium")
    if what == "equilibrium":
        np.testing.assert_allclose(shown.equilibrium, MIDDLE + 1.5)
    assert shown.assumptions == ("warning: beyond saturation", "a note", "[1.5, -0.5]")
    assert capsys.readouterr().err == "warning: beyond saturation\n"


def test_a_solution_is_shown_everywhere_with_its_iron(crooked, monkeypatch):
    class Solved(FieldAtCurrents):
        mesh, element_flux_density, currents, coil_names = (
            "mesh",
            "flux",
            np.array([1.0, 2.0]),
            Crooked.coil_names,
        )

        def field(self, points):
            return points

        gradient = field

    told(monkeypatch)
    monkeypatch.setattr("fieldmap.iron.SolvedState", Solved)
    source = replace(crooked, bounds=None, make=lambda: SimpleNamespace(at=lambda currents: Solved()))
    shown = shown_field(source, np.array([1.0, 2.0]), "lines")
    assert (shown.everywhere, shown.mesh, shown.flux_density, shown.lower) == (True, "mesh", "flux", None)
    monkeypatch.setattr(Solved, "mesh", None)
    shown = shown_field(source, np.array([1.0, 2.0]), "lines")
    assert (shown.everywhere, shown.mesh, shown.flux_density) == (True, None, None)


def test_what_is_reachable_in_words(crooked, monkeypatch):
    """Of an affine field: at the middle within 3 A by default, or at a given place and limit."""
    told(monkeypatch, "a note")
    moment = crooked.payload.moment
    reach = 3.0 * np.abs(moment * Crooked.SLOPES[:, 2]).sum(axis=0)
    shown = shown_field(crooked, np.ones(2), "reachable")
    first, second = shown.title.split("\n")
    assert first == "a.h5, at (0.5, -2, -20) mm, each current within 3 A"
    lift = reach[2] / (0.01 * 9.80665)
    x, y, z = (f"{value:.3g}" for value in reach)
    assert second == (
        f"reaches, in N, {x} along x, {y} along y, {z} along z; lift up to {lift:.2f} times the weight; "
        "arrows: one coil alone at its limit"
    )
    assert shown.reachable.quantity == "force"
    assert shown.assumptions == ("a note", "[1.0, 1.0]")
    np.testing.assert_allclose(shown.reachable.position, MIDDLE)
    place = np.array([0.001, 0.0, -0.015])
    shown = shown_field(crooked, np.ones(2), "reachable", place=place, limit=0.5, kind="B")
    first, second = shown.title.split("\n")
    assert first == "a.h5, at (1, 0, -15) mm, each current within 0.5 A"
    flux = 1e3 * 0.5 * np.abs(Crooked.SLOPES @ place + Crooked.FLUX).sum(axis=0)
    x, y, z = (f"{value:.3g}" for value in flux)
    assert (
        second
        == f"reaches, in mT, {x} along x, {y} along y, {z} along z; arrows: one coil alone at its limit"
    )
    assert shown.reachable.quantity == "field"
    driven = replace(crooked, driver=SimpleNamespace(current_limit=0.25))
    for limit, words in ((None, "0.25"), (2.0, "2")):
        assert (
            f"within {words} A\n" in shown_field(driven, np.ones(2), "reachable", kind="B", limit=limit).title
        )
    # Flux density needs no payload, force does.
    bare = replace(crooked, payload=None)
    assert "times the weight" not in shown_field(bare, np.ones(2), "reachable", kind="B").title
    with refused(InputError, where="a.h5 (device, linear iron), 1 A in each of 2 coils"):
        shown_field(bare, np.ones(2), "reachable")


def test_a_difference_says_of_what(harmonic_map, monkeypatch, capsys):
    told(monkeypatch, "warning: one")
    one = source_of(harmonic_map(coil=(0.0, 0.0, 6.0, (0.0, 0.0))))
    shown = shown_field(one, np.array([2.0]), "difference", replace(one, name="b.h5"))
    assert (shown.title, shown.payload) == ("a.h5 less b.h5, 2 A in the coil", one.payload)
    assert capsys.readouterr().err == "warning: one\n" * 2
    assert isinstance(shown.field, FieldDifference)
    assert (shown.field.coil_names, shown.field.currents.tolist()) == (("coil",), [2.0])
    with refused(InputError, where="--what difference"):
        shown_field(one, np.array([2.0]), "difference")
    # Boxes that share only a face have no common volume.
    low, high = one.bounds
    beside = replace(one, bounds=(low + [high[0] - low[0], 0.0, 0.0], high + 0.1))
    with refused(InputError, where="show, --minus"):
        shown_field(one, np.array([2.0]), "difference", beside)


def test_a_shift_says_where_at_what_current_and_how_many_are_missing(crooked, monkeypatch):
    told(monkeypatch, "a note")
    asked = []
    levels = np.full((13, 13), 2.0)

    def surface(field, payload, x, y, level, height, shares):
        asked.append((level, height, None if shares is None else shares.tolist()))
        np.testing.assert_allclose((x, y), np.tile(np.linspace(-0.3, 0.3, 13), (2, 1)))
        return EquilibriumSurface(x, y, np.zeros((13, 13, 3)), levels, np.ones((13, 13), bool), 1.0, ())

    monkeypatch.setattr(gather, "equilibrium_surface", surface)
    monkeypatch.setattr(gather, "floating_height", lambda *_: (-0.0215, ", where it floats"))
    shown = shown_field(crooked, np.array([1.5, 1.5]), "shift")
    assert shown.title == "a.h5: where the magnet rests at z = -21.5 mm, where it floats, 1.5 A at signals 0"
    assert shown.assumptions == ("a note", "[1.5, 1.5]")
    levels[0, :3] = np.nan
    shown = shown_field(crooked, np.array([-1.0, 3.0]), "shift", height=-0.0123456)
    assert (
        shown.title
        == "a.h5: where the magnet rests at z = -12.35 mm, 2 A at signals 0, none for 3 of 169 pairs"
    )
    assert asked == [(1.5, -0.0215, None), (2.0, -0.0123456, [-0.5, 1.5])]


def run_signals(count=3, **changed):
    """A run of three samples, whose sensed point is (0.001, 0, 0.005) m from its centre of mass."""
    time = np.linspace(1.0, 2.0, count)
    position = np.column_stack([0.1 * time, 0.2 * time, -0.3 * time])
    arrays = {
        "time": time,
        "position": position,
        "sensed": position + [0.001, 0.0, 0.005],
        "reference": position + [0.003, 0.002, 0.0],
        "quaternion": np.tile([0.5, 0.5, -0.5, 0.5], (count, 1)),
        "currents": time[:, None],
    } | changed
    return {name: (values, "1", name) for name, values in arrays.items() if values is not None}


def run_file(path, arrays, event="fell", **texts):
    about = {"title": "A run", "scenario": "", "device": (DEVICES / "thin_loop.toml").read_text()} | texts
    return write_runs(path, [RunRecord(arrays, {"event": event})], about)


@pytest.mark.parametrize(
    ("scenario", "body"),
    [
        ("[body]\nradius_mm = 3\nheight_mm = 4.5\n", (0.003, 0.0045)),
        ("[body]\nradius_mm = 3\n", None),
        ("[body]\nradius_mm = 3\nheight_mm = 'tall'\n", None),
        ("body = 3\n", None),
        ("", None),
    ],
)
def test_a_recorded_run_is_read_as_it_was(tmp_path, scenario, body):
    shown = shown_run(run_file(tmp_path / "run.h5", run_signals(), scenario=scenario))
    run = shown.run
    assert (shown.title, run.title, run.event, run.device.coil_names) == ("A run", "A run", "fell", ("loop",))
    assert run.body == (None if body is None else pytest.approx(body))
    arrays = {name: values for name, (values, *_) in run_signals().items()}
    for name in ("time", "position", "quaternion", "currents"):
        np.testing.assert_array_equal(getattr(run, name), arrays[name])
    # The reference of the centre of mass, below the reference of the sensed point.
    np.testing.assert_allclose(run.wanted, arrays["position"] + [0.002, 0.002, -0.005])


@pytest.mark.parametrize("name", ["position", "quaternion", "sensed", "reference", "currents"])
def test_a_run_with_a_signal_of_another_shape_is_refused(tmp_path, name):
    (values, *_) = run_signals()[name]
    for wrong in (None, values[:, :-1] if values.shape[1] > 1 else values[:, [0, 0]], values[:-1]):
        path = run_file(tmp_path / "run.h5", run_signals(**{name: wrong}))
        with refused(InputError, where=str(path), must_hold=name):
            shown_run(path)
        path.unlink()


@pytest.mark.parametrize("missing", ["samples", "device"])
def test_a_run_without_samples_or_device_is_refused(tmp_path, missing):
    arrays = run_signals(0) if missing == "samples" else run_signals()
    path = run_file(tmp_path / "run.h5", arrays)
    if missing == "device":
        path = write_runs(
            tmp_path / "other.h5", [RunRecord(arrays, {})], {"title": "", "scenario": "device = 'none'"}
        )
    with refused(InputError, where=str(path)):
        shown_run(path)


def test_what_is_shown_in_numbers(crooked):
    """Without keys for missing results; for a run its duration and end."""
    run = SimpleNamespace(
        time=np.array([1.0, 2.5, 4.0]),
        position=np.array([[0.0] * 3, [1.0] * 3, [1.0, 2.0, 3.0]]),
        event="fell",
    )
    surface = EquilibriumSurface(
        np.array([0.0]),
        np.array([0.1]),
        np.zeros((1, 1, 3)),
        np.ones((1, 1)),
        np.ones((1, 1), bool),
        2.5,
        ("of the surface",),
    )
    shown = Shown(
        "a title", run=run, surface=surface, mesh=SimpleNamespace(tets=np.zeros((5, 4))), assumptions=("own",)
    )
    told_ = shown.to_dict()
    expected = {"title", "assumptions", "tetrahedra", "event", "duration", "last_position"}
    assert set(told_) == expected | {"x_signals", "y_signals", "positions", "levels", "stable", "field_scale"}
    assert (told_["duration"], told_["last_position"], told_["event"]) == (3.0, [1.0, 2.0, 3.0], "fell")
    assert (told_["tetrahedra"], list(told_["assumptions"]), told_["field_scale"]) == (
        5,
        ["own", "of the surface"],
        2.5,
    )
    bare = Shown("t", currents=np.array([1.0]), lower=MIDDLE, upper=MIDDLE, equilibrium=MIDDLE).to_dict()
    assert set(bare) == {"title", "currents", "lower", "upper", "equilibrium"}
    for name in ("device", "field", "lower", "mesh", "payload", "equilibrium", "surface", "reachable", "run"):
        with refused(InputError, where="t"):
            Shown("t").need(name)
    Shown("t", run=run).need("run")


def test_a_field_is_taken_at_the_currents_that_are_shown():
    shown = Shown(
        "t", field=Crooked(), currents=np.array([1.5, -0.5]), lower=Crooked.lower, upper=Crooked.upper
    )
    np.testing.assert_allclose(
        shown.flux_density_at(MIDDLE[None]), Crooked().field(MIDDLE[None], [1.5, -0.5])
    )
    np.testing.assert_allclose(shown.gradient_at(MIDDLE[None]), Crooked().gradient(MIDDLE[None], [1.5, -0.5]))
    np.testing.assert_array_equal(shown.box, (Crooked.lower, Crooked.upper))
    assert Shown("t", field=Crooked().at([1.0, 2.0]), currents=np.array([1.0, 2.0])).currents.tolist() == [
        1.0,
        2.0,
    ]
    assert isinstance(Shown("t", field=Crooked()).field, Crooked)
