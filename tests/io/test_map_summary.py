"""What a map holds, in numbers: against the polynomial field and against six dipoles."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g as gravity

from fieldmap.currents import CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device.measured import measured_machine
from fieldmap.io.map_summary import (
    LiftAtHeight,
    MapSummary,
    lift_by_height,
    middle_field,
    signal_names,
    summarise_map,
)

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
    """A field as an opened map, with reference currents."""

    def __init__(self, field, reference=(1.0, 2.0), saturating=False, x=(-0.01, 0.01), z=(-0.1, -0.02)):
        self.inner = field
        self.lower, self.upper = self.bounds = (np.array([x[0], -0.01, z[0]]), np.array([x[1], 0.01, z[1]]))
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
    # Each coil alone, then all.
    np.testing.assert_allclose(middle.Bz, flux * np.array([1.0, 0.5, 1.5]), rtol=1e-12)
    np.testing.assert_allclose(middle.dBz_dz, (polynomial.b1 + polynomial.b2 * z) * np.array([1, 0.5, 1.5]))
    saturating = middle_field(Opened(polynomial.field, saturating=True))
    np.testing.assert_allclose(saturating.Bz, [flux * (1.0 + 0.5 * 2.0)], rtol=1e-12)


def test_lift_at_heights_that_divide_the_box(polynomial):
    rows = lift_by_height(Opened(polynomial.field), polynomial.payload)
    np.testing.assert_allclose([row.height for row in rows], np.linspace(-0.02, -0.1, 6)[1:-1])
    for row in rows:
        pull = 0.8 * 1.5 * (polynomial.b1 + polynomial.b2 * row.height)
        assert row.current == pytest.approx(0.010 * gravity / pull, rel=1e-9)
        assert (row.sensor_mm, row.measured, row.ratio) == (None, None, None)


def test_lift_at_the_readings_of_a_machine_that_lie_in_the_box(polynomial):
    # A magnet's centre lies 77 + 15 mm below the zero, so of 10, 20, ... mm none is above -100 mm.
    machine = measured_machine("drive_unit")
    assert lift_by_height(Opened(polynomial.field), polynomial.payload, machine) == ()
    rows = lift_by_height(Opened(polynomial.field, z=(-0.115, -0.02)), polynomial.payload, machine)
    assert [row.sensor_mm for row in rows] == [10.0, 20.0]
    np.testing.assert_allclose([row.height for row in rows], [-0.102, -0.112])
    np.testing.assert_allclose([row.measured for row in rows], [1.558, 1.901])


def test_no_lift_off_the_axis_or_without_pull(polynomial):
    assert lift_by_height(Opened(polynomial.field, x=(0.005, 0.01)), polynomial.payload) == ()

    class Uniform(type(polynomial.field)):
        def gradient(self, points, currents):
            return np.zeros((len(np.atleast_2d(points)), 3, 3))

    assert lift_by_height(Opened(Uniform()), polynomial.payload) == ()


def test_a_row_beside_the_measured_current():
    row = LiftAtHeight(-0.1, 3.0, 10.0, 1.5)
    assert row.ratio == 2.0
    assert row.to_dict() == {"sensor_mm": 10.0, "height": -0.1, "current": 3.0, "thesis": 1.5, "ratio": 2.0}
    assert LiftAtHeight(-0.1, None, 10.0, 1.5).ratio is None


def test_signals_are_named_and_have_their_ranges():
    lift = CurrentDomain(LiftAndDirections(1.25), np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3]))
    each = CurrentDomain(IndependentCurrents(2), np.array([0.5, -1.0]), np.array([2.0, 3.0]))
    assert signal_names(lift, tuple("123456")) == ("u", "x", "y")
    assert signal_names(each, ("left", "right")) == ("left", "right")
    info = SimpleNamespace(coil_names=("left", "right"), reduced_model=SimpleNamespace(domain=each))
    summary = MapSummary("a.h5", 1, info, None, None, (), "")
    assert summary.signal_ranges() == {"left": (0.5, 2.0), "right": (-1.0, 3.0)}
    assert summary.saturation == ""
    linear = MapSummary("a.h5", 1, SimpleNamespace(reduced_model=None), None, None, (), "")
    assert linear.signal_ranges() == {}


@pytest.mark.parametrize(("material", "warned"), [(SATURATING, True), (LINEAR, False)])
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
    # Six dipoles of 8 A m^2 per ampere at depth h and 44 mm aside: dBz/dz on the axis.
    for row in summary.lift:
        h, r2 = 0.026 - row.height, 0.044**2 + (0.026 - row.height) ** 2
        slope = 6 * 8e-7 * (3 * h * (5 * h**2 - 3 * r2) / r2**3.5)
        assert row.current == pytest.approx(0.010 * gravity / (0.8 * slope), rel=2e-3)
    plain = summary.to_dict()
    assert (plain["title"], plain["device"], plain["current_domain"]) == ("Dipoles", "rig", None)
    assert plain["grid"]["shape"] == [9, 9, 13]
    np.testing.assert_allclose(plain["grid"]["spacing"], [0.005, 0.005, 0.064 / 12])
    assert len(plain["lift"]) == 4
    h = 0.026 + 0.108
    exact = 6 * 2e-7 * 8 * (h**2 - 0.044**2 / 2) / (h**2 + 0.044**2) ** 2.5
    assert plain["middle"]["Bz"] == pytest.approx([exact / 6] * 6 + [exact], rel=1e-4)
