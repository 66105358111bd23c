"""The contents of a valid file after reading: SI units, frames, names, read-only arrays."""

import dataclasses
import hashlib

import numpy as np
import pytest

from fieldmap.device import model, read_device
from fieldmap.device.placement import rotation_matrix
from fieldmap.device.reader import recorded_device
from fieldmap.errors import DeviceFileError
from fieldmap.lookup import magnetic_body


@pytest.fixture
def device(valid_text, tmp_path) -> model.Device:
    path = tmp_path / "device.toml"
    path.write_text(valid_text)
    return read_device(path)


def test_names_order_and_record(device, valid_text, tmp_path):
    assert device.coil_names == ("round", "race", "path")
    assert [body.name for body in device.bodies] == ["disk", "collar", "wedge", "spindle", "bracket"]
    assert device.text == valid_text
    # Windows line ends and a byte order mark are not part of the text.
    (tmp_path / "other.toml").write_bytes(b"\xef\xbb\xbf" + valid_text.replace("\n", "\r\n").encode())
    assert read_device(str(tmp_path / "other.toml")).text == valid_text
    assert device.source == tmp_path / "device.toml"
    assert device.provenance["coil.*.turns"] == "an example"


def test_shapes_in_metres(device):
    disk, collar, wedge, spindle, bracket = (body.parts for body in device.bodies)
    assert disk[0].shape == model.Cylinder(radius=0.066, height=0.006)
    assert collar[0].shape == model.Ring(inner_radius=0.07, outer_radius=0.075, height=0.004)
    np.testing.assert_allclose(
        wedge[0].shape.points, [[0, 0], [0.01, 0], [0.01, 0.005], [0, 0.005]], rtol=1e-15
    )
    assert spindle[0].shape.points.max() == pytest.approx(0.01, rel=1e-15)
    assert [part.operation for part in bracket] == ["add", "cut"]
    assert bracket[0].shape == model.Box((0.02, 0.02, 0.01))
    assert bracket[1].shape == model.Sphere(0.004)
    np.testing.assert_allclose(bracket[1].placement.position, [0, -0.2, 0], rtol=1e-15)
    assert (device.bodies[0].mesh_size, device.bodies[0].edge_size) == (0.008, 0.001)
    assert device.bodies[1].edge_size is None


def test_clockwise_polygons_are_turned_round(valid_text, tmp_path):
    text = valid_text.replace("[[0, 0], [10, 0], [10, 5], [0, 5]]", "[[0, 5], [10, 5], [10, 0], [0, 0]]")
    (tmp_path / "device.toml").write_text(text)
    points = read_device(tmp_path / "device.toml").bodies[2].parts[0].shape.points
    x, y = points.T
    assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2 == pytest.approx(
        50e-6
    )  # 10 mm x 5 mm, positive


def test_materials(device):
    steel, iron, barrier, magnet = (device.materials[k] for k in ("steel", "iron", "barrier", "magnet"))
    assert steel.initial_mu_r == pytest.approx(0.70 / (4e-7 * np.pi * 355), rel=1e-9)
    assert steel.h.tolist() == [355, 405, 470]
    assert (steel.below, steel.above) == ("straight line to the origin", "slope mu0")
    assert iron == model.LinearMaterial("iron", 4000)
    assert barrier == model.FluxBarrier("barrier")
    assert magnet.remanence.tolist() == [0, 0, 1.3]
    assert magnet.mu_r == 1.05


def test_coils_in_si(device):
    round_coil, race, path = device.coils
    assert (round_coil.inner_radius, round_coil.outer_radius, round_coil.height) == (0.011, 0.021, 0.039)
    assert (round_coil.turns, round_coil.polarity) == (840, 1)
    assert (round_coil.resistance, round_coil.inductance) == (4.25, 0.029)
    assert (race.half_width_x, race.half_width_y, race.corner_radius) == (0.016, 0.02, 0.015)
    assert (race.thickness, race.polarity, race.resistance) == (0.01, -1, None)
    np.testing.assert_allclose(path.corners, [[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03]], rtol=1e-15)


def test_payload_driver_workspace_and_references(device):
    payload = device.payload
    assert payload.mass == pytest.approx(0.01119)
    assert payload.moment == pytest.approx(np.pi * 0.005**2 * 0.01 * 1.3 / (4e-7 * np.pi), rel=1e-9)
    assert payload.magnet == model.MagnetCylinder(0.01, 0.01, 1.3)
    assert payload.magnet_offset == 0.015
    assert payload.inertia == pytest.approx((3e-7, 3e-7, 2e-7))
    assert device.driver == model.Driver(0.355, 3.55, 40)
    np.testing.assert_allclose(device.workspace.upper, [0.02, 0.02, -0.076], rtol=1e-15)
    field, gradient = device.references
    assert (field.quantity, field.value, field.mu_r) == ("Bz", 1e-4, None)
    assert (gradient.quantity, gradient.value, gradient.mu_r, gradient.tolerance) == (
        "dBz/dz",
        1e-3,
        4000,
        1e-3,
    )
    np.testing.assert_allclose(gradient.at, [0, 0, -0.087], rtol=1e-15)


@pytest.mark.parametrize(
    ("magnet", "volume"),
    [('shape = "sphere"\ndiameter_mm = 2', np.pi / 6 * 8e-9), ('shape = "block"\nsize_mm = [1, 2, 3]', 6e-9)],
)
def test_other_magnets(magnet, volume, valid_text, tmp_path):
    old = 'shape = "cylinder"\ndiameter_mm = 10\nheight_mm = 10'
    (tmp_path / "device.toml").write_text(valid_text.replace(old, magnet))
    payload = read_device(tmp_path / "device.toml").payload
    assert payload.moment == pytest.approx(volume * 1.3 / (4e-7 * np.pi), rel=1e-9)


def test_moment_alone_and_cylindrical_workspace(valid_text, tmp_path):
    start, end = valid_text.index("[payload.magnet]"), valid_text.index("[driver]")
    text = valid_text[:start] + valid_text[end:]
    text = text.replace("mass_g = 11.19", "mass_g = 11.19\nmoment_A_m2 = 0.8")
    box = 'shape = "box"\nlower_mm = [-20, -20, -140]\nupper_mm = [20, 20, -76]'
    text = text.replace(box, 'shape = "cylinder"\nbase_mm = [0, 0, -140]\nradius_mm = 20\nheight_mm = 64')
    (tmp_path / "device.toml").write_text(text)
    device = read_device(tmp_path / "device.toml")
    assert device.payload.moment == 0.8
    assert device.payload.magnet is None
    assert (device.workspace.radius, device.workspace.height) == (0.02, 0.064)
    np.testing.assert_allclose(device.workspace.base, [0, 0, -0.14], rtol=1e-15)


@pytest.mark.parametrize(
    ("written", "direction", "turning", "sign", "held"),
    [
        ("", "up", None, 1.0, "moment up, fixed"),
        ('direction = "up"\nturning = "fixed"', "up", "fixed", 1.0, "moment up, fixed"),
        ('direction = "down"', "down", None, -1.0, "moment down, fixed"),
        ('direction = "down"\nturning = "free"', "down", "free", -1.0, "moment down, free to turn"),
    ],
)
def test_which_way_a_moment_points(valid_text, written, direction, turning, sign, held):
    """In the file, in its text, in the record of a map, and in the magnetic body."""
    device = read_device(valid_text.replace("mass_g = 11.19", f"mass_g = 11.19\n{written}"))
    for payload in (
        device.payload,
        read_device(device.to_toml()).payload,
        recorded_device(device.text).payload,
    ):
        assert (payload.direction, payload.turning, payload.held()) == (direction, turning, held)
        np.testing.assert_array_equal(payload.moment_vector, [0.0, 0.0, sign * payload.moment])
        for level in (1, 2):
            body = magnetic_body(payload, level)
            np.testing.assert_allclose(
                body.moments.sum(axis=0), payload.moment_vector, rtol=1e-12, atol=1e-15
            )


@pytest.mark.parametrize(("key", "value"), [("direction", "sideways"), ("turning", "upright")])
def test_a_direction_that_is_none(valid_text, key, value):
    with pytest.raises(DeviceFileError) as caught:
        read_device(valid_text.replace("mass_g = 11.19", f'mass_g = 11.19\n{key} = "{value}"'))
    (problem,) = caught.value.problems
    assert (problem.where.split()[-1], problem.received) == (f"payload.{key}", f'"{value}"')


def test_turns_are_about_fixed_axes_in_the_order_x_y_z():
    # x first takes y to z; then y takes that z to x: a body-fixed order would leave it on z.
    np.testing.assert_allclose(rotation_matrix([90, 90, 0]) @ [0, 1, 0], [1, 0, 0], atol=1e-15)
    from_scipy = pytest.importorskip("scipy.spatial.transform").Rotation
    angles = [20.0, -75.0, 310.0]
    expected = from_scipy.from_euler("xyz", angles, degrees=True).as_matrix()  # lower case: fixed axes
    np.testing.assert_allclose(rotation_matrix(angles), expected, atol=1e-15)
    for angle in (-360, -270, -180, -90, 90, 180, 270, 360):  # quarter turns are exact
        for turn in angle * np.eye(3):
            assert set(np.abs(rotation_matrix(turn)).ravel()) <= {0.0, 1.0}


def test_everything_is_frozen(device):
    arrays = [device.materials["steel"].h, device.workspace.lower, device.coils[2].corners]
    arrays += [
        device.coils[0].placement.position,
        device.coils[0].placement.rotation,
        device.references[0].at,
    ]
    for array in arrays:
        assert array.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(TypeError):
        device.materials["steel"] = None
    with pytest.raises(dataclasses.FrozenInstanceError):
        device.name = "other"


def test_step_files_are_found_beside_the_device_file(valid_text, tmp_path):
    (tmp_path / "cad").mkdir()
    (tmp_path / "cad" / "spindle.step").write_bytes(b"ISO-10303-21;")
    old = 'shape = "revolved_profile"\npoints_mm = [[0, 0], [4, 0], [2, 10], [0, 10]]'
    text = valid_text.replace(old, 'shape = "step_file"\nfile = "cad/spindle.step"\nunit_mm = 25.4')
    (tmp_path / "device.toml").write_text(text)
    device = read_device(tmp_path / "device.toml")
    assert device.bodies[3].parts[0].shape == model.StepFile(tmp_path / "cad" / "spindle.step", 0.0254)
    digest = hashlib.sha256(b"ISO-10303-21;").hexdigest()
    assert device.included == {"cad/spindle.step": f"sha256:{digest}"}


def test_a_material_file_is_read_from_beside_the_device_file_first(valid_text, tmp_path):
    curve = 'format = 1\nname = "own"\ntitle = "own curve"\nH_A_per_m = [100, 200]\nB_T = [0.5, 0.6]\n'
    (tmp_path / "materials").mkdir()
    (tmp_path / "materials" / "steel_a3.toml").write_text(curve)
    table = "H_A_per_m = [355, 405, 470]\nB_T = [0.70, 0.80, 0.90]"
    (tmp_path / "device.toml").write_text(valid_text.replace(table, 'file = "materials/steel_a3.toml"'))
    device = read_device(tmp_path / "device.toml")
    assert device.materials["steel"].b.tolist() == [0.5, 0.6]
    assert device.included == {"materials/steel_a3.toml": curve}
