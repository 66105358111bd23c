"""Frames: rotations and translations there and back, against scipy's rotations and the field of a dipole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.device.placement import rotation_angles, rotation_matrix
from fieldmap.instruments import SensorFrame
from fieldmap.sources import unit_flux_density

angles = st.one_of(
    st.floats(-360.0, 360.0), st.sampled_from([0.0, 45.0, 90.0, 135.0, 180.0, 270.0, -90.0, 30.0])
)
three = st.tuples(angles, angles, angles)
places = st.tuples(*[st.floats(-0.2, 0.2)] * 3).map(np.array)


def scipys(rotation_deg):
    """About the fixed x, then y, then z axis: lower-case letters are fixed axes in scipy."""
    return Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix()


@given(three)
def test_rotations_are_those_of_scipy(rotation_deg):
    found = rotation_matrix(rotation_deg)
    np.testing.assert_allclose(found, scipys(rotation_deg), atol=1e-14)
    # Angles from a matrix may differ from the original ones, but must give the same matrix.
    np.testing.assert_allclose(scipys(rotation_angles(found)), found, atol=2e-8)


@given(three, places, st.sampled_from("xyz"), angles, places)
def test_turned_there_and_back(rotation_deg, place, axis, angle, centre):
    coil = fm.CircularCoil("a", 0.02, 0.03, 0.01, 100, placement=fm.placed(place, rotation_deg))
    turned = coil.turned(axis, angle, centre)
    turn = Rotation.from_rotvec(np.deg2rad(angle) * np.eye(3)["xyz".index(axis)])
    np.testing.assert_allclose(turned.placement.position, turn.apply(place - centre) + centre, atol=1e-9)
    np.testing.assert_allclose(turned.placement.rotation, turn.as_matrix() @ scipys(rotation_deg), atol=1e-7)
    back = turned.turned(axis, -angle, centre).placement
    np.testing.assert_allclose(back.position, place, atol=1e-9)
    np.testing.assert_allclose(back.rotation, scipys(rotation_deg), atol=1e-7)


@given(three, places, st.sampled_from("xyz"), st.floats(-0.1, 0.1))
def test_mirrored_twice(rotation_deg, place, plane, at):
    """B is a pseudovector: mirroring keeps its component across the mirror plane, and reverses the others."""
    coil = fm.CircularCoil("a", 0.02, 0.03, 0.01, 100, placement=fm.placed(place, rotation_deg))
    image = coil.mirrored(plane, at, name="b")
    sign = np.ones(3)
    sign["xyz".index(plane)] = -1.0
    point = place + [0.05, -0.04, 0.03]
    shift = np.where(sign < 0, 2 * at, 0.0)
    field = unit_flux_density(coil, point[None])[0]
    there = unit_flux_density(image, (sign * point + shift)[None])[0]
    # The image's positive current makes the device symmetric, so that all of B may have either sign.
    scale = np.abs(field).max()
    assert min(np.abs(there - s * (-sign) * field).max() for s in (-1, 1)) < 1e-9 * scale
    back = image.mirrored(plane, at, name="c")
    np.testing.assert_allclose(back.placement.position, place, atol=1e-12)


@given(
    st.floats(-4.0, 4.0),
    st.floats(-0.05, 0.05),
    st.floats(0.0, 0.02),
    st.tuples(*[st.floats(-1e-3, 1e-3)] * 2),
    places,
)
def test_sensors_read_the_edge_of_a_round_body(angle, offset, radius, bias, place):
    """The reading is the projection of the body's centre on the sensor's turned axis, less the body's radius."""
    frame = SensorFrame(angle, offset, radius, bias)
    read = frame.to_local(place)
    axes = Rotation.from_euler("z", angle).as_matrix()
    exact = [(place - [*bias, 0.0]) @ axes[:, k] - radius + offset for k in (0, 1)]
    assert read == pytest.approx([*exact, place[2]], abs=1e-12)
    np.testing.assert_allclose(frame.to_global(read), place, atol=1e-12)


@given(three, places, places)
def test_a_machine_and_its_map_have_one_frame(rotation_deg, place, point):
    """The field of a moved and turned coil is the turned field of the coil at the point moved back."""
    still = fm.CircularCoil("a", 0.02, 0.03, 0.01, 100)
    moved = fm.CircularCoil("a", 0.02, 0.03, 0.01, 100, placement=fm.placed(place, rotation_deg))
    turn = scipys(rotation_deg)
    local = (point - place) @ turn
    if np.hypot(np.hypot(*local[:2]) - 0.025, local[2]) < 0.02:
        return  # inside the winding or close to it
    exact = turn @ unit_flux_density(still, local[None])[0]
    np.testing.assert_allclose(
        unit_flux_density(moved, point[None])[0], exact, atol=1e-9 * np.abs(exact).max() + 1e-14
    )
