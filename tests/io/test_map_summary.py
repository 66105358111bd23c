"""A summary of a map in numbers, against the polynomial field and against six dipoles."""

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import mu_0

from fieldmap.currents import CoilGroups, CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device.model import Driver
from fieldmap.errors import MissingExtraError, OutsideMapError
from fieldmap.io.map_summary import (
    ErrorShares,
    MapSummary,
    MiddleField,
    _sensors,
    middle_field,
    signal_names,
    summarise_map,
)
from fieldmap.lookup import interpolate
from fieldmap.store import FieldError, Grid, MapData, MapInfo, Provenance, StoredSensors, write_map
from tests.dynamics.conftest import saturating_data

BODY = """
[[body]]
name = "yoke"
material = "iron"
shape = "sphere"
radius_mm = 3
mesh_size_mm = 1.5
"""
LINEAR = '[material.iron]\nkind = "linear"\nmu_r = 50\n'
SATURATING = '[material.iron]\nkind = "froehlich"\nmu_r = 400\nsaturation_polarisation_T = 1.6\n'


class Opened:
    """A field with the interface of an opened map, with reference currents."""

    def __init__(self, field, reference=(1.0, 2.0), saturating=False):
        self.inner = field
        self.lower, self.upper = self.bounds = field.bounds
        self.info = SimpleNamespace(
            reference_current=np.array(reference), reduced_model="a model" if saturating else None
        )

    def __getattr__(self, name):
        return getattr(self.inner, name)


def test_the_middle_of_the_box(polynomial):
    middle = middle_field(Opened(polynomial.field))
    z = -0.06
    flux = polynomial.b0 + polynomial.b1 * z + 0.5 * polynomial.b2 * z**2
    np.testing.assert_allclose(middle.at, [0, 0, z], atol=1e-17)
    # Each coil alone, then all together.
    np.testing.assert_allclose(middle.Bz, flux * np.array([1.0, 0.5, 1.5]), rtol=1e-12)
    np.testing.assert_allclose(middle.dBz_dz, (polynomial.b1 + polynomial.b2 * z) * np.array([1, 0.5, 1.5]))
    saturating = middle_field(Opened(polynomial.field, saturating=True))
    np.testing.assert_allclose(saturating.Bz, [flux * (1.0 + 0.5 * 2.0)], rtol=1e-12)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("saturating", [True, False])
def test_what_no_current_drives_in_the_middle(polynomial, known, saturating):
    """B and its gradient with all components different; a map of saturating iron may not include zero current."""

    def off(values):
        def at(point):
            if not known:
                raise OutsideMapError.of("here", "must hold", "this", "that")
            np.testing.assert_allclose(point, [0, 0, -0.06], atol=1e-17)
            return np.array(values)

        return at

    opened = Opened(polynomial.field, saturating=saturating)
    opened.fixed_sources = ("magnet",)
    opened.constant_field, opened.constant_gradient = off([1.0, 2.0, 3.0]), off(np.arange(9.0).reshape(3, 3))
    found = middle_field(opened)
    assert found.without_currents == ((3.0, 8.0) if known else None)
    slope = polynomial.b1 - 0.06 * polynomial.b2
    np.testing.assert_allclose(found.dBz_dz, [2.0 * slope] if saturating else slope * np.array([1, 0.5, 1.5]))
    opened.fixed_sources = ()
    assert middle_field(opened).without_currents is None


def reported(**report):
    """The accuracy that a summary takes from a solver's report."""
    info = SimpleNamespace(
        provenance=SimpleNamespace(solver_report=report),
        interpolation_error=FieldError(1e-6, 2e-4),
        error_bounds={"harmonic": FieldError(3e-6, 4e-4)},
    )
    return MapSummary("a.h5", 1, info, None, None, (), "").accuracy


def test_each_kind_of_error_has_its_number_or_none():
    tried = {
        "at random": {"states": 20, "solved": 18, "flux_density_share": 0.002, "gradient_share": 0.003},
        "in corners": {"states": 8, "solved": 8, "flux_density_share": 0.001, "gradient_share": 0.004},
    }
    estimate = {"flux_density": 5e-4, "gradient": 6e-4, "gap": None}
    found = reported(tetrahedra=10, error=estimate, states_tried=tried)
    assert found.meshed
    assert (found.mesh, found.current_model) == (ErrorShares(5e-4, 6e-4), ErrorShares(0.002, 0.004))
    assert (found.interpolation, found.bound) == (FieldError(1e-6, 2e-4), FieldError(3e-6, 4e-4))
    assert [(one.kind, one.states, one.solved) for one in found.tried] == [
        ("at random", 20, 18),
        ("in corners", 8, 8),
    ]
    assert found.to_dict()["current_model"] == {"flux_density": 0.002, "gradient": 0.004}
    # Without an estimate, or without anything to mesh.
    assert reported(tetrahedra=10, error=None).mesh is None
    assert reported().current_model is None
    assert not reported(form="coils").meshed


def test_signals_are_named_and_have_their_ranges():
    lift = CurrentDomain(LiftAndDirections(1.25), np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3]))
    each = CurrentDomain(IndependentCurrents(2), np.array([0.5, -1.0]), np.array([2.0, 3.0]))
    assert signal_names(lift, tuple("123456")) == ("u", "x", "y")
    assert signal_names(each, ("left", "right")) == ("left", "right")
    groups = CurrentDomain(CoilGroups(((0, 1), (2,))), np.zeros(2), np.ones(2))
    assert signal_names(groups, ("a", "b", "c")) == groups.parametrisation.signal_names != ("a", "b", "c")
    info = SimpleNamespace(coil_names=("left", "right"), reduced_model=SimpleNamespace(domain=each))
    summary = MapSummary("a.h5", 1, info, None, None, (), "")
    assert summary.signal_ranges() == {"left": (0.5, 2.0), "right": (-1.0, 3.0)}
    assert summary.saturation == ""
    linear = MapSummary("a.h5", 1, SimpleNamespace(reduced_model=None), None, None, (), "")
    assert linear.signal_ranges() == {}


LIFT = CurrentDomain(LiftAndDirections(1.25, 4.0), np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3]))
EACH = CurrentDomain(IndependentCurrents(2), np.array([0.5, -1.0]), np.array([2.0, 3.0]))


@pytest.mark.parametrize(
    ("domain", "told"),
    [
        (
            LIFT,
            {
                "division_exponent": 1.25,
                "ranges": {"u": [1.0, 2.2], "x": [-0.4, 0.4], "y": [-0.3, 0.3]},
                "parametrisation": LiftAndDirections(1.25).name,
                "limit": 4.0,
            },
        ),
        (
            EACH,
            {
                "division_exponent": None,
                "ranges": {"left": [0.5, 2.0], "right": [-1.0, 3.0]},
                "parametrisation": "independent",
                "limit": None,
            },
        ),
        (None, None),
    ],
)
def test_the_summary_as_plain_python(polynomial, domain, told):
    tried = {"at random": {"states": 20, "solved": 18, "flux_density_share": 0.02, "gradient_share": 0.03}}
    info = MapInfo(
        Grid([-0.01, 0.02, -0.1], [0.001, 0.002, 0.005], (3, 4, 5)),
        ("left", "right"),
        [0.5, 2.0],
        Provenance(
            "A map", "rig", created="now", assumptions=("none",), solver_report={"states_tried": tried}
        ),
        FieldError(1e-6, 2e-4),
        {"harmonic": FieldError(3e-6, 4e-4)},
        current_error=FieldError(5e-6, 6e-4),
        fixed_sources=("magnet",),
    )
    if domain is not None:
        object.__setattr__(info, "reduced_model", SimpleNamespace(domain=domain))
    device = SimpleNamespace(payload=polynomial.payload, driver=Driver(0.355, 3.5))
    middle = MiddleField(np.array([0.1, 0.2, 0.3]), (4.0,), (5.0,), (6.0, 7.0))
    plain = MapSummary(
        Path("a.h5"), 123, info, device, middle, (), "a source", lift_missing="scipy"
    ).to_dict()
    assert plain.pop("payload")["mass"] == 0.010
    accuracy = {"meshed": False, "mesh": None, "interpolation": {"flux_density": 1e-6, "gradient": 2e-4}}
    accuracy |= {"bound": {"flux_density": 3e-6, "gradient": 4e-4}}
    accuracy |= {"current_model": {"flux_density": 0.02, "gradient": 0.03}}
    largest = {"flux_density": 0.02, "gradient": 0.03}
    accuracy |= {"tried": [{"kind": "at random", "states": 20, "solved": 18, "largest": largest}]}
    assert plain == {
        "path": "a.h5",
        "size": 123,
        "title": "A map",
        "device": "rig",
        "created": "now",
        "coil_names": ["left", "right"],
        "fixed_sources": ["magnet"],
        "solver": {"states_tried": tried},
        "grid": {
            "lower": [-0.01, 0.02, -0.1],
            "upper": pytest.approx([-0.008, 0.026, -0.08]),
            "spacing": [0.001, 0.002, 0.005],
            "shape": [3, 4, 5],
        },
        "reference_current": [0.5, 2.0],
        "interpolation_error": {"flux_density": 1e-6, "gradient": 2e-4},
        "error_bounds": {"harmonic": {"flux_density": 3e-6, "gradient": 4e-4}},
        "current_error": {"flux_density": 5e-6, "gradient": 6e-4},
        "accuracy": accuracy,
        "missed_accuracy": None,
        "current_domain": told,
        "current_limit": 3.5,
        "middle": {"at": [0.1, 0.2, 0.3], "Bz": [4.0], "dBz_dz": [5.0], "without_currents": [6.0, 7.0]},
        "assumptions": ["none"],
        "lift": [],
        "force_fit": None,
        "shifts": [],
        "lift_missing": "scipy",
        "lift_assumptions": [],
        "saturation": "",
        "reaction": None,
        "sensors": [],
    }


def test_sensors_have_the_readings_of_currents_and_payload(tmp_path):
    """T, of the coils at 1 A and of the magnets; mu0 m / (2 pi d^3) of a dipole 20 mm below on its axis."""
    grid, shape = Grid([-0.002, -0.002, -0.012], [0.001, 0.001, 0.001], (5, 5, 5)), (3, 5, 5, 5, 3)
    places, axes = (
        np.array([[0.0, 0.0, 0.01], [0.01, 0.0, 0.0]]),
        np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    )
    shares = np.array([[0.03, -0.01, 2e-4], [0.005, 0.02, -5e-5]])
    data = MapData(
        grid,
        ("a", "b"),
        [1.0, 1.0],
        fixed_sources=("background",),
        constant_field=True,
        flux_density=np.zeros(shape),
        gradient=np.zeros((*shape, 3)),
        sensors=StoredSensors(("up", "out"), places, axes, shares),
    )
    write_map(tmp_path / "sensors.h5", data)
    up, out = summarise_map(tmp_path / "sensors.h5").sensors
    assert (up.name, out.name, up.of_payload) == ("up", "out", None)
    assert (up.of_currents, out.of_currents) == pytest.approx((0.0202, 0.02495), rel=1e-12)
    assert out.axis.tolist() == [1.0, 0.0, 0.0]
    up, _ = _sensors(interpolate(data), SimpleNamespace(moment=0.8))
    assert up.of_payload == pytest.approx(mu_0 * 0.8 / (2 * np.pi * 0.02**3), rel=1e-9)
    assert up.of_currents == pytest.approx(0.0202, rel=1e-12)


def test_a_map_without_a_device_or_a_driver():
    bare = MapSummary("a.h5", 1, None, None, None, (), "")
    assert (bare.payload, bare.current_limit, bare.lift_missing, bare.force_fit) == (None, None, "", None)
    device = SimpleNamespace(payload=None, driver=None)
    found = MapSummary("a.h5", 1, None, device, None, (), "")
    assert (found.payload, found.current_limit) == (None, None)


@pytest.mark.parametrize("saturating", [True, False])
@pytest.mark.parametrize("name", ["drive_unit", "rig"])
def test_what_is_computed_beside_measurements(tmp_path, monkeypatch, valid_text, saturating, name):
    """Shifts need a map with saturation, of a machine on which they were measured."""
    asked = {}
    for step in ("lift_by_height", "shifts_beside_measured", "fit_force"):
        monkeypatch.setattr(
            f"fieldmap.levitation.comparison.{step}",
            lambda *given, _step=step: asked.update({_step: given}) or (_step,),
        )
    coil = valid_text[valid_text.index("[[coil]]") :]
    coil = coil[: coil.index("[[coil]]", 1)]
    text = f'format = 1\nname = "{name}"\ntitle = "t"\n{coil}[payload]\nmass_g = 10.0\nmoment_A_m2 = 0.8\n'
    data = saturating_data()
    if not saturating:
        part = {"flux_density": data.flux_density[:6], "gradient": data.gradient[:6]}
        data = replace(data, reduced_model=None, **part)
    path = write_map(
        tmp_path / "m.h5", replace(data, provenance=Provenance(device_name=name, device_text=text))
    )
    found = summarise_map(path)
    measured = name == "drive_unit"
    _, payload, machine, largest = asked["lift_by_height"]
    assert (payload.mass, machine is not None) == (0.010, measured)
    # u is the current of all coils at x = y = 0.
    assert largest == (pytest.approx(2.2) if saturating else None)
    assert asked["fit_force"][1:] == (payload, ("lift_by_height",))
    assert (found.lift, found.force_fit) == (("lift_by_height",), ("fit_force",))
    assert found.shifts == (("shifts_beside_measured",) if measured and saturating else ())
    assert ("shifts_beside_measured" in asked) == (measured and saturating)
    assert found.lift_source == (machine.lift_source if measured else "")
    assert (found.domain is not None) == saturating


def test_what_lift_currents_need_is_told(monkeypatch, dipole_map, circle_of_six, tmp_path, valid_text):
    class Missing(ModuleType):
        def __getattr__(self, name):
            raise MissingExtraError.of("here", "needs scipy", "none", "install it")

    monkeypatch.setitem(sys.modules, "fieldmap.levitation.comparison", Missing("comparison"))
    coil = valid_text[valid_text.index("[[coil]]") :]
    coil = coil[: coil.index("[[coil]]", 1)]
    text = f'format = 1\nname = "rig"\ntitle = "t"\n{coil}'
    payload = "[payload]\nmass_g = 10.0\nmoment_A_m2 = 0.8\n"
    found = summarise_map(dipole_map(circle_of_six, tmp_path / "a.h5", text + payload))
    assert (found.lift_missing, found.lift, found.force_fit) == ("needs scipy: install it", (), None)
    # Nothing is needed without a payload, nor without a device.
    for device in (text, ""):
        bare = summarise_map(dipole_map(circle_of_six, tmp_path / "b.h5", device))
        assert (bare.lift_missing, bare.lift, bare.payload) == ("", (), None)
        assert (bare.device is None) == (device == "")


BOTH = SATURATING.replace("iron", "core") + LINEAR


@pytest.mark.parametrize(
    ("material", "warned"),
    [(SATURATING, True), (LINEAR, False), (BOTH, True), (LINEAR + SATURATING.replace("iron", "core"), True)],
)
def test_a_map_file(circle_of_six, dipole_map, tmp_path, valid_text, material, warned):
    head = 'format = 1\nname = "rig"\ntitle = "Six dipoles"\n'
    coil = valid_text[valid_text.index("[[coil]]") :]
    coil = coil[: coil.index("[[coil]]", 1)]
    device = f"{head}{material}{BODY}{coil}[payload]\nmass_g = 10.0\nmoment_A_m2 = 0.8\n"
    path = dipole_map(circle_of_six, tmp_path / "six.h5", device, title="Dipoles", device_name="rig")
    summary = summarise_map(path)
    assert summary.size == path.stat().st_size
    assert bool(summary.saturation) is warned
    assert summary.payload.mass == 0.010
    assert (summary.lift_source, summary.domain) == ("", None)
    # Six dipoles of 8 A m^2 per ampere, a height h above and 44 mm off the axis: dBz/dz on the axis.
    for row in summary.lift:
        h, r2 = 0.026 - row.height, 0.044**2 + (0.026 - row.height) ** 2
        slope = 6 * 8e-7 * (3 * h * (5 * h**2 - 3 * r2) / r2**3.5)
        assert row.current == pytest.approx(0.010 * gravity / (0.8 * slope), rel=2e-3)
    plain = summary.to_dict()
    assert (plain["title"], plain["device"], plain["current_domain"]) == ("Dipoles", "rig", None)
    assert plain["grid"]["shape"] == [9, 9, 13]
    np.testing.assert_allclose(plain["grid"]["spacing"], [0.005, 0.005, 0.064 / 12])
    assert len(plain["lift"]) == 4
    # There are no measurements of this rig.
    assert (plain["force_fit"], plain["shifts"]) == (None, [])
    h = 0.026 + 0.108
    exact = 6 * 2e-7 * 8 * (h**2 - 0.044**2 / 2) / (h**2 + 0.044**2) ** 2.5
    assert plain["middle"]["Bz"] == pytest.approx([exact / 6] * 6 + [exact], rel=1e-4)


def test_a_map_of_a_measured_machine(circle_of_six, dipole_map, tmp_path, valid_text):
    """Recognised by the drive unit's name; the map is linear, so it has no shift."""
    coil = valid_text[valid_text.index("[[coil]]") :]
    coil = coil[: coil.index("[[coil]]", 1)]
    head = 'format = 1\nname = "drive_unit"\ntitle = "Six dipoles"\n'
    payload = "[payload]\nmass_g = 10.0\nmoment_A_m2 = 0.8\nmagnet_offset_mm = 15\n"
    path = dipole_map(circle_of_six, tmp_path / "six.h5", head + coil + payload, device_name="drive_unit")
    plain = summarise_map(path).to_dict()
    assert [row["sensor_mm"] for row in plain["lift"]] == [0.0, 10.0, 20.0, 30.0]
    # In a linear map the lifted share of the weight is the measured current over ours.
    shares = np.array([row["measured"] / row["current"] for row in plain["lift"]])
    np.testing.assert_allclose([row["lift_share"] for row in plain["lift"]], shares, rtol=1e-9)
    factor = np.linalg.lstsq(shares[:, None], np.ones(4), rcond=None)[0][0]
    assert plain["force_fit"]["factor"] == pytest.approx(factor, rel=1e-9)
    assert plain["shifts"] == []
