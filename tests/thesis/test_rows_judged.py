"""What rows of the thesis compute from the numbers below them, each compared with another way.

A stand-in for the unit has statics in closed form: six vertical dipoles on a ring, whose moments saturate with their
currents, mu(i) = MU i / (1 + i / KNEE).
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

from fieldmap import control
from fieldmap.currents import divide_currents
from fieldmap.device.model import Payload
from fieldmap.errors import OutsideMapError, Problem
from fieldmap.field import Field, coil_currents
from fieldmap.thesis import detail, equilibrium_shift, horizontal, statics, vertical
from fieldmap.thesis.coupled_runs import Readings
from fieldmap.thesis.equilibrium_shift import Shift
from fieldmap.thesis.force_formulas import added_error, fit_quadratic_force
from fieldmap.thesis.vertical_sensor import magnet_height
from tests.computed_parts import assert_drawn

MU, KNEE = 12.0, 4.0
MASS, MOMENT = 0.011186, 0.8126
RING = np.array(
    [
        [0.044 * np.cos(a), 0.044 * np.sin(a), 0.026]
        for a in np.deg2rad([240.0, 180.0, 120.0, 300.0, 0.0, 60.0])
    ]
)


def slope(point, currents):
    """dBz/dx_i (3,) of the ring: the derivative of B_z = 1e-7 mu (3 z^2 / d^5 - 1 / d^3) by complex steps."""
    moments = MU * currents / (1.0 + currents / KNEE)
    found = []
    for step in 1e-30j * np.eye(3):
        r = point + step - RING
        d2 = (r * r).sum(axis=1)
        found.append((1e-7 * moments * (3.0 * r[:, 2] ** 2 / d2**2.5 - d2**-1.5)).sum().imag / 1e-30)
    return np.array(found)


class SaturatingRing(Field):
    """A field with dB_z/dx_i only; the rows do not use the rest of the gradient."""

    coil_names, proportional = tuple("123456"), False
    bounds = (np.array([-0.025, -0.025, -0.13]), np.array([0.025, 0.025, -0.07]))

    def field(self, points, currents):
        return np.zeros((len(np.atleast_2d(points)), 3))

    def gradient(self, points, currents):
        i = coil_currents(currents, self.coil_names)
        r = np.atleast_2d(points)[:, None] - RING
        z, d2 = r[..., 2:], (r * r).sum(axis=-1, keepdims=True)
        along = 3.0 * r / d2**2.5 - 15.0 * z**2 * r / d2**3.5
        along[..., 2:] += 6.0 * z / d2**2.5
        out = np.zeros((len(r), 3, 3))
        out[:, 2] = 1e-7 * np.einsum("k,pki->pi", MU * i / (1.0 + i / KNEE), along)
        return out

    def second_gradient(self, points, currents):
        h = 1e-6
        p = np.atleast_2d(points)
        return np.stack(
            [
                (self.gradient(p + s, currents) - self.gradient(p - s, currents)) / (2 * h)
                for s in h * np.eye(3)
            ],
            axis=-1,
        )


@pytest.fixture
def ring(monkeypatch):
    """The ring in place of the unit; caches of the rows are cleared before and after."""
    field = SaturatingRing()
    carried = Payload(MASS, MOMENT)
    for module in (equilibrium_shift, statics):
        monkeypatch.setattr(module, "unit_rays", lambda: field)
        monkeypatch.setattr(module, "payload", lambda: carried)
    monkeypatch.setattr("fieldmap.thesis.drive_unit.payload", lambda: carried)
    equilibrium_shift._curve.cache_clear()
    yield field
    equilibrium_shift._curve.cache_clear()


def rest_along_x(level, signal, n, z_s, h):
    """x of the equilibrium, mm, where no force acts along x; the ring is symmetric about the x axis."""
    currents = divide_currents(level, signal, 0.0, n)
    height = magnet_height(z_s, 1e-3 * h)
    return 1e3 * brentq(lambda x: slope(np.array([x, 0.0, height]), currents)[0], 0.0, 0.024, xtol=1e-12)


def test_each_column_of_table_6_2_is_computed_with_its_own_n(ring):
    signals = np.array([0.05, 0.1, 0.2])
    inputs = {
        "map": ring,
        "offsets_mm": [15.0],
        "zero_mm": -0.088,
        "z_mm": 10.0,
        **{f"n{n}_signals": signals for n in (125, 150)},
        **{f"n{n}_measured_mm": np.ones(3) for n in (125, 150)},
    }
    numbers = equilibrium_shift.n_table(inputs).numbers
    level = 1.558
    for n, name in ((1.25, "n125"), (1.5, "n150")):
        expected = [rest_along_x(level, s, n, 10.0, 15.0) - 0.088 for s in signals]
        assert numbers[f"{name}_constant"][0] == pytest.approx(expected, rel=2e-3)
    apart = numbers["n150_constant"][0] / numbers["n125_constant"][0]
    assert np.abs(apart - 1.0).min() > 0.05


def test_own_current_is_the_level_that_is_asked_for(ring):
    signals = np.array([0.1, 0.2])
    inputs = {"map": ring, "signals": signals, "level_A": 3.0, "z_mm": 10.0, "zero_mm": 0.1}
    answers = equilibrium_shift.own_current(inputs)
    expected = [rest_along_x(3.0, s, 1.25, 10.0, 15.0) + 0.1 for s in signals]
    assert answers.numbers["x"] == pytest.approx(expected, rel=1e-5)
    lower = [rest_along_x(1.5, s, 1.25, 10.0, 15.0) + 0.1 for s in signals]
    assert np.abs(np.array(lower) / expected - 1.0).min() > 0.02


def test_relative_slope_of_the_lift_current(monkeypatch):
    """An exponential law with 1.7 % per mm."""
    monkeypatch.setattr(statics, "lift_current", lambda z_s, h: 1.5 * np.exp(0.017 * z_s))
    assert statics._relative_slope(10.0, 15.0) == pytest.approx(1.7, rel=1e-4)


def test_lift_current_of_the_ring(ring):
    """The lift of six equal coils equals the weight at I / (1 + I / KNEE) = weight / (lift of 1 A), by hand."""
    point = np.array([0.0, 0.0, magnet_height(8.0, 0.015)])
    unsaturated = MOMENT * slope(point, np.full(6, 1e-9))[2] / 1e-9
    share = MASS * 9.80665 / unsaturated
    statics.lift_current.cache_clear()
    found = statics.lift_current(8.0, 15.0)
    statics.lift_current.cache_clear()
    assert found == pytest.approx(share / (1.0 - share / KNEE), rel=1e-5)


@pytest.fixture
def shares(monkeypatch):
    """A lift over weight of current exp(-z_s / 20 mm) (1 + h / 100 mm), a third of it with linear iron, and an error
    beyond 5.2 A. The map's box ends 130 mm below the disk."""
    carried = SimpleNamespace(mass=0.01, moment=0.5)

    def lift_share(field, z_s, h, current):
        if np.mean(current) > 5.2 + 1e-9 and field == "rays":
            raise OutsideMapError(Problem("current", "must be less", "more", "less"))
        return np.mean(current) * np.exp(-z_s / 20) * (1 + h / 100) * (1 / 3 if field == "linear" else 1.0)

    field = SimpleNamespace(lower=np.array([-0.02, -0.02, -0.13]))
    maps = {("division", "evaluate"): field}
    monkeypatch.setattr(detail, "available_map", lambda name, outside_currents: maps[name, outside_currents])
    for name, one in (("lift_share", lift_share), ("payload", lambda: carried), ("unit_rays", lambda: "rays"),
                      ("linear_unit", lambda name: "linear")):  # fmt: skip
        monkeypatch.setattr(statics, name, one)
    statics.lift_current.cache_clear()
    yield field
    statics.lift_current.cache_clear()


@pytest.mark.parametrize(
    ("limit", "scaled", "deepest"),
    [
        (3.55, True, 10 + 20 * np.log(3.55 / 1.558)),
        (3.55, False, 20 * np.log(3.55 * 1.15)),
        (30.0, False, 130 - 77 - 15 - 0.01),
        (0.8, False, 0.0),
    ],
)
def test_deepest_place_that_the_limit_carries(shares, limit, scaled, deepest):
    """Scaled so that 1.558 A carry the weight at 10 mm, or unscaled; at most to the end of the map's box."""
    assert statics._deepest(15.0, limit, scaled) == pytest.approx(deepest, abs=1e-3)


def test_row_s12_and_its_figures(shares, monkeypatch):
    zs, hs = np.array([5.0, 10.0, 20.0, 28.0, 40.0]), np.array([10.0, 15.0, 20.0])
    inputs = {"map": None, "depths_mm": zs, "offsets_mm": hs, "offset_mm": 15.0, "middle_mm": 10.0}
    law = 1.215 + 0.0343 * zs
    jointed = SimpleNamespace(shares=0.1 * zs, relative_slope=2.5)
    monkeypatch.setattr(statics, "lift_law", lambda unit, at: jointed if at is zs else None)
    monkeypatch.setattr(statics, "shipped_unit", lambda: None)
    monkeypatch.setattr(statics, "about_the_joints", lambda: {"joints": 1})
    answers = statics.levitation_current(inputs)
    # At 40 mm more than 5.2 A would be needed.
    needed = np.where(zs < 40, np.exp(zs / 20) / 1.15, np.nan)
    lifts = np.array([law * np.exp(-zs / 20) * (1 + h / 100) for h in hs])
    expected = {
        "current": needed, "total": 6 * np.exp(0.5) / 1.15, "current_over_h": np.exp(0.5) / (1 + hs / 100),
        "current_linear": 3 * np.exp(zs / 20) / 1.15,
        "relative_slope": np.full(2, 100 * np.sinh(0.05)), "lift_over_weight": lifts, "lift_with_joints": 0.1 * zs,
        "slope_with_joints": 2.5,
    }  # fmt: skip
    assert answers.numbers.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(answers.numbers[name], value, rtol=1e-5, err_msg=name)
    facts = {
        "refinement": 0.5, "least_share": lifts.min(), "largest_share": lifts.max(), "deepest_mm": 40.0, "joints": 1,
        "spread": np.ptp(lifts[0]) / lifts[0].mean(),
    }  # fmt: skip
    # The spread is equal for every h, up to rounding.
    best = {"best_h_mm": answers.facts["best_h_mm"]}
    facts |= best | {"factor": 1 / (law * np.exp(-zs / 20)).mean() / (1 + best["best_h_mm"] / 100)}
    assert answers.facts == pytest.approx(facts)
    lines = [("measured, (7-18)", "measured", zs, law), ("ours, saturating, h = 15 mm", "ours", zs, needed)]
    for h in hs:
        scale = np.exp(0.5) / (1.558 * (1 + h / 100))
        scaled = np.where(zs < 40, np.exp(zs / 20) / (1 + h / 100) / scale, np.nan)
        lines.append((f"ours, force scaled by {scale:.2f}, h = {h:g} mm", "ours", zs, scaled))
    current, lift = answers.curves
    assert_drawn(current, ("sensor depth z_s (mm)", "current in each coil (A)"), lines, rtol=1e-5)
    shown = [(f"h = {h:g} mm", "ours", zs, row) for h, row in zip(hs, lifts, strict=True)]
    assert_drawn(lift, ("sensor depth z_s (mm)", "lift over weight"), shown)


def test_best_offset_is_that_of_the_least_spread(shares, monkeypatch):
    """The larger h, the less the lift changes with depth."""
    monkeypatch.setattr(statics, "lift_share", lambda field, z, h, current: 0.5 + z / h**2)
    monkeypatch.setattr(statics, "lift_law", lambda *_: SimpleNamespace(shares=0, relative_slope=0))
    for name in ("shipped_unit", "about_the_joints"):
        monkeypatch.setattr(statics, name, dict)
    inputs = {
        "depths_mm": np.array([10.0, 20.0]),
        "offsets_mm": [10.0, 30.0, 20.0],
        "offset_mm": 15.0,
        "middle_mm": 10.0,
    }
    facts = statics.levitation_current(inputs).facts
    lifts = 0.5 + np.array([10.0, 20.0]) / 900
    assert (facts["best_h_mm"], facts["factor"]) == (30.0, pytest.approx(1 / lifts.mean()))
    assert facts["spread"] == pytest.approx(np.diff(lifts)[0] / lifts.mean())


def test_row_s11_and_its_figures(shares, monkeypatch):
    """Self-inductances of coil k of k mH, mutual ones of 20 mH; dBz/dz of k + x T/m per ampere of coil k; B_z of
    0.5 + 3 z T per ampere, and with saturation 0.5 + 6 z T."""

    class Unit:
        coil_names, coils = tuple("123456"), ("coils",)

        def __init__(self, name, lift=1.0):
            self.name, self.lift = name, lift

        def inductance(self):
            return 1e-3 * (np.diag(np.arange(1.0, 7.0)) + 20 * (1 - np.eye(6)))

        def unit_fields(self, points):
            assert_line(points, 33, 16, [0.0, 0.0, -77e-3 - 10e-3 - 15e-3])
            slopes = np.zeros((6, len(points), 3, 3))
            slopes[..., 2, 2] = np.arange(1.0, 7.0)[:, None] + points[:, 0]
            return None, slopes

        def field(self, points, currents):
            return (0.5 + points[:, 2:] * [1, 2, 3]) * np.mean(currents)

        def gradient(self, points, currents):
            return (points[:, 2] * currents.mean() * self.lift)[:, None, None] * np.arange(1.0, 10.0).reshape(
                3, 3
            )

    class Rays(Unit):
        def field(self, points, currents):
            return 0.5 + points[:, 2:] * [4, 5, 6]

    def assert_line(points, count, half, middle):
        x = np.linspace(-half, half, count) * 1e-3
        np.testing.assert_allclose(points, middle + np.outer(x, [1, 0, 0]), atol=1e-12)

    units = {name: Unit(name, k) for k, name in enumerate(statics.VARIANTS, 1)}
    monkeypatch.setattr(statics, "linear_unit", units.get)
    monkeypatch.setattr(statics, "unit_states", lambda: "states")
    monkeypatch.setattr(statics, "unit_rays", lambda: Rays("rays"))
    monkeypatch.setattr(
        statics, "bare_inductance", lambda coils: np.diag(np.arange(11.0, 17.0)) if coils else None
    )
    monkeypatch.setattr(statics, "_on_its_core", lambda: np.arange(21.0, 27.0))
    # Lift at 1 A in all coils: 0.8 and 0.5; at 1 A in coil 5 alone: 0.4 and 0.1.
    known = {("states", 6): 0.8, ("drive_unit", 6): 0.5, ("states", 1): 0.4, ("drive_unit", 1): 0.1}

    def lift_share(field, z_s, h, amperes):
        full = np.full(6, amperes)
        assert (z_s, h, full.max(), full[4]) == (10.0, 15.0, 1.0, 1.0)
        return known[getattr(field, "name", field), np.count_nonzero(full)]

    monkeypatch.setattr(statics, "lift_share", lift_share)
    answers = statics.coils({})
    expected = {
        "on_its_core": 1e3 * np.arange(21, 27),
        "in_the_unit": np.arange(1, 7),
        "without_iron": 1e3 * np.arange(11, 17),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(answers.numbers[name], value)
    assert answers.facts == pytest.approx({"refinement": 0.5, "share_of_all": 1.6, "share_of_one": 4.0})
    x, z = np.linspace(-16, 16, 33), np.linspace(-0.130, -0.085, 46)
    each, flux, lift = answers.curves
    assert_drawn(
        each, ("x (mm)", "dBz/dz (T/m/A)"), [(f"coil {k}", "ours", x, k + 1e-3 * x) for k in range(1, 7)]
    )
    lines = [("linear iron", "ours", -1e3 * z, 1e3 * (0.5 + 3 * z))]
    lines += [
        (f"saturating, {i} A", "ours", -1e3 * z, 1e3 * (0.5 + 6 * z) / float(i))
        for i in ("1", "1.558", "2.2", "3.6")
    ]
    assert_drawn(flux, ("depth below the disk (mm)", "Bz (mT/A)"), lines)
    words = ("as it levitated", "without centre core", "Appendix A-3: 120 mm gap, 1350 turns", "disk and six cores",
             "disk, six cores and upper plate")  # fmt: skip
    lines = []
    for k, name in enumerate(words, 1):
        # The gap of A-3 ends 2 mm above a depth of 120 mm.
        inside = z[z > -0.118] if k == 3 else z
        lines.append((name, "ours", -1e3 * inside, 0.5 / (0.01 * 9.80665) * 9 * k * inside))
    assert_drawn(lift, ("depth below the disk (mm)", "lift over weight (1/A)"), lines)


def test_each_core_is_taken_with_its_own_winding(monkeypatch):
    """The stand-in accepts one core with one coil, and returns the coil's number plus a half."""

    def solve(device, mu_r=None, refinement=1.0):
        (core,), (coil,) = device.bodies, device.coils
        assert (core.name, device.sections) == (f"core {coil.name}", ())
        return SimpleNamespace(inductance=lambda: np.array([[int(coil.name) + 0.5]]))

    monkeypatch.setattr(statics, "solve_linear", solve)
    assert statics._on_its_core.__wrapped__() == pytest.approx([1.5, 2.5, 3.5, 4.5, 5.5, 6.5])


def test_ranges_are_of_both_sides_and_end_at_the_limits(monkeypatch):
    """A unit that moves 20 mm per unit signal along x, 30 along -x, 10 along y, less with depth and h, and whose
    largest current is 1.5 A + 5 A per unit signal."""
    sides = {("x", 1.0): 0.02, ("x", -1.0): 0.03, ("y", 1.0): 0.01}
    unstable = set()

    def along(axis, way, z_s, h):
        return sides[axis, way] * (1 - 0.01 * z_s) * (1 - 0.001 * h)

    def followed(axis, way, z_s, h):
        signals = way * np.array([0.1, 0.2, 0.3, 0.4, 0.5])
        places = np.zeros((5, 2))
        places[:, "xy".index(axis)] = along(axis, way, z_s, h) * signals
        stable = (axis, way, z_s, h) not in unstable
        return Shift(signals, places, np.zeros(2), np.full(5, 1.5), 1.5 + 5.0 * np.abs(signals), stable)

    monkeypatch.setattr(statics, "_followed", followed)
    monkeypatch.setattr(statics, "_deepest", lambda h, limit, scaled: h + 100 * limit + 1000 * scaled)
    monkeypatch.setattr(statics, "_checked_at_half", lambda: 0.25)
    monkeypatch.setattr(statics, "about_the_joints", lambda: {"joints": 1})
    ends = {"x": 0.45, "y": 0.3}

    def joint_range(axis, z_s, limit, largest):
        """The range with joints: 4 mm per ampere of the limit, less a tenth of the depth."""
        assert largest == ends[axis]
        return 4.0 * limit - 0.1 * z_s

    monkeypatch.setattr(statics, "joint_range", joint_range)
    inputs = {
        "current_limit_A": 3.25,  # a signal of 0.35
        "offsets_mm": [15.0, 20.0],
        "depths_mm": [11.5, 18.0],
        "largest_y_signal": 0.3,
    }

    def size(z_s, *hs):
        return np.array([(1 - 0.01 * z_s) * (1 - 0.001 * h) for h in hs])

    answers = statics.ranges(inputs)
    numbers = answers.numbers
    for name, z_s in (("upper", 11.5), ("lower", 18.0)):
        assert numbers[f"x_range_{name}"] == pytest.approx(0.35 * (20.0 + 30.0) * size(z_s, 15.0, 20.0))
        assert numbers[f"y_range_{name}"] == pytest.approx(2 * 0.3 * 10.0 * size(z_s, 15.0, 20.0))
        assert (
            numbers[f"x_range_{name}_joints"]
            == numbers[f"y_range_{name}_joints"]
            == pytest.approx(13.0 - 0.1 * z_s)
        )
    assert numbers["vertical_range"] == [1340.0, 1345.0]
    assert numbers["vertical_range_unscaled"] == [340.0, 345.0]
    facts = {"stability": "stable sideways", "off_mm": 0.25, "joints": 1}
    assert answers.facts == facts
    largest = 1.5 + 5.0 * np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    for figure, z_s in zip(answers.curves, (11.5, 18.0), strict=True):
        assert figure.title == f"Reach against the largest coil current, z_s = {z_s:g} mm, h = 15 mm"
        lines = [
            (name, "ours", largest, per * (largest - 1.5) / 5.0 * size(z_s, 15.0)[0])
            for name, per in (("x", 20.0), ("-x", 30.0), ("y", 10.0))
        ]
        assert_drawn(figure, ("largest coil current (A)", "distance from the origin (mm)"), lines)
    numbers = statics.ranges(inputs | {"current_limit_A": 2.5}).numbers
    assert numbers["y_range_upper"] == pytest.approx(2 * 0.2 * 10.0 * size(11.5, 15.0, 20.0))
    unstable.add(("y", 1.0, 18.0, 15.0))
    assert statics.ranges(inputs).facts["stability"] == "not stable sideways"


def test_a_side_is_followed_as_far_as_the_box_goes(shares, monkeypatch):
    """Signals from 0.05 to 0.55 on the map; the last one is dropped until all are inside."""
    tried = []

    def shift(fields, signals, axis, z_s, h, far):
        tried.append(len(signals))
        assert (fields, axis, z_s, h, far) == ((shares,), "y", 18.0, 20.0, np.inf)
        if np.abs(signals).max() > 0.47:
            raise OutsideMapError(Problem("current", "must be less", "more", "less"))
        return signals

    monkeypatch.setattr(statics, "shift", shift)
    found = statics._followed.__wrapped__("y", -1.0, 18.0, 20.0)
    np.testing.assert_allclose(found, -np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45]))
    assert tried == [11, 10, 9]


def test_how_far_the_map_is_off_at_half_the_signal(shares, monkeypatch):
    """u = 2.2 A, y = 0.5, n = 1.25, z_s = 11.5 mm, h = 15 mm; within 5 mm along x and to the map's end along y."""
    places = {True: np.array([1e-3, 9e-3]), False: np.array([4e-3, 5e-3])}

    def stationary_points(field, currents, payload, height, window, samples):
        np.testing.assert_allclose(currents, divide_currents(2.2, 0.0, 0.5, 1.25))
        assert (height, samples) == (pytest.approx(-0.1035), 8)
        np.testing.assert_allclose(window, [[-5e-3, 0.0], [5e-3, 15.9e-3]])
        return SimpleNamespace(points=[SimpleNamespace(position=places[field == "states"])])

    monkeypatch.setattr(statics, "stationary_points", stationary_points)
    monkeypatch.setattr(statics, "unit_states", lambda: "states")
    assert statics._checked_at_half() == pytest.approx(5.0)


def test_time_to_reference_of_a_ramp():
    """After a step at 1 s the position moves from 10 to 11 mm in 0.37 s, and further."""
    time = np.arange(0.0, 3.0, 1e-3)
    wanted = np.where(time < 1.0, 10.0, 11.0)
    for way in (1.0, -1.0):
        true = way * (10.0 + np.clip((time - 1.0) / 0.37, 0.0, 1.2))
        run = Readings(None, time, true[:, None], true[:, None], way * wanted[:, None])
        assert run.time_to_reference(0, 1.0) == pytest.approx(0.37, abs=1.01e-3)


def test_rest_voltage_of_the_regulator_is_that_of_its_model():
    """b / (s^2 + c s - k) is at rest at -k / b volts per unit of position."""
    model = control.controller_form([-250.0], [1.0, 45.0, -500.0])
    _, regulator = vertical.design_of(model, np.diag([1.0, 1.0, 1.0]), 1e-3, (1e-4, 1e-4), 2e-3)
    assert regulator.equilibrium == pytest.approx((0.0, 2.0), rel=1e-9)


def test_gains_of_the_regulator_follow_the_ratios_of_its_weights():
    """Scaling all weights leaves the optimum; a larger control weight or sensor noise makes the gains smaller."""
    model = control.controller_form([-250.0], [1.0, 45.0, -500.0])

    def gains(cost, R, noise):
        _, regulator = vertical.design_of(model, cost * np.diag([1.0, 2.0, 3e4]), R, noise, 2e-3)
        return regulator.k, regulator.estimator.D_est

    once, sensed = gains(1.0, 1e-3, (10.0, 1e-4))
    twice, scaled = gains(2.0, 2e-3, (30.0, 3e-4))
    dear, worse = gains(1.0, 1e-1, (10.0, 1.0))
    np.testing.assert_allclose(twice, once, rtol=1e-6)
    np.testing.assert_allclose(scaled, sensed, rtol=1e-6, atol=1e-15)
    assert np.abs(dear).sum() < 0.9 * np.abs(once).sum()
    assert np.abs(worse).sum() < 0.5 * np.abs(sensed).sum()


def test_mean_and_standard_deviation_over_records():
    """Divided by n - 1, because the mean comes from the same records: (9 + 1 + 1 + 9) / 3."""
    answers = vertical.over_records({"poles": np.array([[1.0, 10.0], [3.0, 10.0], [5.0, 10.0], [7.0, 10.0]])})
    assert answers.numbers["poles"] == pytest.approx([4.0, 10.0])
    assert answers.facts["poles_spread"] == pytest.approx([np.sqrt(20.0 / 3.0), 0.0])


def test_errors_of_added_formulas():
    """Errors 3, 4, 0 of forces 5, 12, 0; the first two places are in the middle."""
    found = added_error(
        (1.0, 0.0), np.array([8.0, 8.0, 0.0]), np.array([5.0, 12.0, 0.0]), np.array([True, True, False])
    )
    assert found.currents == (1.0,)
    assert (found.rms, found.rms_mN) == pytest.approx((np.sqrt(25 / 3), 1e3 * np.sqrt(25 / 3)))
    assert (found.whole, found.middle) == pytest.approx((5 / 13, 5 / 13))
    found = added_error(
        (1.0,), np.array([8.0, 8.0, 1.0]), np.array([5.0, 12.0, 2.0]), np.array([True, False, False])
    )
    assert (found.whole, found.middle) == pytest.approx((np.sqrt(26 / 173), 3 / 5))


def test_largest_and_root_mean_square_error_of_a_fit():
    """A parabola leaves the part along (-1, 3, -3, 1), of squared norm 20, of values at four equidistant places."""
    found = fit_quadratic_force([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 20.0])
    assert found.largest == pytest.approx(3.0)
    assert found.rms == pytest.approx(np.sqrt(5.0))


def test_departure_is_the_largest_and_rms_the_root_mean_square():
    seen = np.array([[10.0, 10.1, 9.7, 10.2]]).T
    run = Readings(None, np.arange(4.0), seen, seen, np.full((4, 1), 10.0))
    assert run.departure(0, 1.0) == pytest.approx(0.3)
    assert run.rms(0, 1.0) == pytest.approx(np.sqrt(0.14 / 3))
    assert run.rms(0, 1.0, 3.0) == pytest.approx(np.sqrt(0.05))
    assert run.mean(0, 1.0, 3.0) == pytest.approx(9.9)


def test_integral_time_of_a_model_is_found_in_its_own_step():
    """The step of a first-order loop with an integral time of 0.2 s, from a start at x = 3 mm."""
    plant, wanted = control.transfer_function([0.02], [1.0, -0.99]), np.full(3000, 3.0)
    time = 2e-3 * np.arange(3000)
    wanted[time >= 2.0] += 0.1
    under = horizontal.Control(0.5, 9.0, 0.001)
    seen = 3.0 + control.simulate_loop(plant, under.pid(2e-3, 0.2), wanted[time >= 2.0] - 3.0).y[0]
    seen = np.append(np.full(np.sum(time < 2.0), 3.0), seen)
    # The reference is relative to the start of the run.
    run = Readings(None, time, seen[:, None], seen[:, None] - 3.0, wanted[:, None])
    assert horizontal._fitted_time({"Ts_s": 2e-3}, plant, under, run) == pytest.approx(0.2, rel=1e-3)
