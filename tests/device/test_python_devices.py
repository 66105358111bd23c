"""Machines made in Python: the text of their files, patterns, shipped materials, and maps without a recipe file."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.placement import cosine_and_sine, rotation_matrix
from fieldmap.errors import InputError, RecipeError
from fieldmap.iron.symmetry import find_symmetry
from fieldmap.maps import recipe_for
from fieldmap.shipped import shipped_names
from fieldmap.sources import CoilSet
from tests.test_records import same

DEVICES = [name for name in shipped_names("geometry") if not name.startswith("planar")]
PARTS = ("coils", "bodies", "payload", "driver", "workspace", "sections", "sensors", "references")


def equal(one, other):
    return all(same(getattr(one, name), getattr(other, name)) for name in PARTS) and same(
        dict(one.materials), dict(other.materials)
    )


@pytest.mark.parametrize("name", DEVICES)
def test_the_text_of_a_shipped_device_is_read_as_the_same_bits(name, tmp_path):
    device = fm.read_device(name)
    path = tmp_path / "again.toml"
    path.write_text(device.to_toml())
    again = fm.read_device(path)
    assert equal(again, device)
    assert equal(fm.read_device(device.to_toml()), device)
    assert equal(device.replace(title="Another"), device)
    assert again.to_toml() == device.to_toml()
    assert set(again.provenance) <= set(device.provenance)


def core():
    return fm.Body("core {k}", "steel", fm.Cylinder(0.01, 0.04), mesh_size=5e-3).moved([0.044, 0.0, 0.006])


def test_copies_about_an_axis_keep_the_symmetry_of_the_circle():
    ring = core().around("z", 6)
    assert [body.name for body in ring] == [f"core {k}" for k in range(1, 7)]
    at = np.array([body.parts[0].placement.position for body in ring])
    angles = np.deg2rad(60.0 * np.arange(6))
    expected = np.column_stack([0.044 * np.cos(angles), 0.044 * np.sin(angles), np.full(6, 0.006)])
    assert at == pytest.approx(expected, abs=1e-15)
    # Under x -> -x, y -> -y, and at half the radius, the places are images to the last bit.
    assert at[1, 0] == 0.022
    assert np.array_equal(at[1] * [-1, 1, 1], at[2])
    assert np.array_equal(at[1] * [1, -1, 1], at[5])
    steel = {"steel": fm.material("steel_a3")}
    disk = fm.Body("disk", "steel", fm.Cylinder(0.066, 0.006), mesh_size=0.01)
    group = find_symmetry(fm.Device("ring", "", (), (disk, *ring), steel))
    assert group.order == find_symmetry(fm.read_device("disk_six_cores")).order == 12


@pytest.mark.parametrize("angle", [0.0, 7.3, 30.0, 45.0, 60.0, 88.0, 90.0, 135.0, 200.0, 270.0, 315.0, -45.0])
def test_cosine_and_sine_have_the_symmetry_of_the_circle(angle):
    cos, sin = cosine_and_sine(angle)
    assert (cos, sin) == pytest.approx((np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))), abs=4e-16)
    if angle.is_integer():  # otherwise the difference is rounded
        assert cosine_and_sine(180.0 - angle) == (-cos + 0.0, sin)
        assert cosine_and_sine(90.0 - angle) == (sin, cos)
    assert cosine_and_sine(angle + 360.0) == pytest.approx((cos, sin), abs=1e-15)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("rotation", [[0, 0, 0], [0, 135, 45], [10, 20, 30], [0, 90, 0]])
def test_turned_and_mirrored_against_matrices(axis, rotation):
    place = fm.placed([0.01, 0.02, 0.03], rotation)
    k = "xyz".index(axis)
    coil = fm.CircularCoil("a", 0.02, 0.03, 0.01, 100, placement=place)
    centre = np.array([0.005, -0.01, 0.02])
    turn = rotation_matrix([37.0 if j == k else 0.0 for j in range(3)])
    moved = coil.turned(axis, 37.0, centre).placement
    assert moved.position == pytest.approx(turn @ (place.position - centre) + centre, abs=1e-15)
    assert moved.rotation == pytest.approx(turn @ place.rotation, abs=1e-14)
    mirror = np.diag([-1.0 if j == k else 1.0 for j in range(3)])
    image = coil.mirrored(axis, at=0.007, name="b").placement
    assert image.position == pytest.approx(mirror @ place.position + 0.014 * np.eye(3)[k], abs=1e-15)
    assert image.rotation[:, 2] == pytest.approx(mirror @ place.rotation[:, 2], abs=1e-14)
    assert np.linalg.det(image.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("plane", ["x", "y", "z"])
def test_a_mirrored_winding_has_the_mirrored_field(plane):
    """A mirrored magnet's field is mirrored like a vector, and changes sign with its axis: B'(Mx) = M B(x) if the axis
    is mirrored and currents run counter-clockwise about it."""
    corners = [[-0.03, -0.03], [0.03, -0.03], [0.03, 0.02]]
    coil = fm.PathCoil(
        "a", corners, 0.006, 0.008, 0.01, 20, placement=fm.placed([0.05, 0.02, 0.01], [10, 20, 30])
    )
    mirror = np.diag([-1.0 if axis == plane else 1.0 for axis in "xyz"])
    points = np.random.default_rng(1).uniform(-0.05, 0.05, (7, 3)) + [0.0, 0.0, 0.2]
    there = CoilSet([coil]).field(points, 1.0)
    image = CoilSet([coil.mirrored(plane)]).field(points @ mirror, 1.0)
    assert image == pytest.approx(there @ mirror, rel=1e-9, abs=1e-15)


def test_a_mirrored_body_is_the_mirror_image():
    wedge = fm.Body(
        "w", "iron", fm.ExtrudedPolygon([[0, 0], [0.01, 0], [0.01, 0.005]], 0.003), mesh_size=0.002
    )
    image = wedge.moved([0.02, 0, 0]).mirrored("x", name="image")
    part = image.parts[0]
    corners = np.column_stack([part.shape.points, np.zeros(3)]) @ part.placement.rotation.T
    found = {tuple(np.round(corner, 12)) for corner in corners + part.placement.position}
    assert found == {(-0.02, 0.0, 0.0), (-0.03, 0.0, 0.0), (-0.03, 0.005, 0.0)}


def test_copies_in_a_row_and_names():
    coil = fm.CircularCoil("{k}", 0.02, 0.03, 0.01, 100)
    row = coil.along([0.0, 0.0, 0.0131], 3, names=["a", "b", "c"])
    assert [one.placement.position[2] for one in row] == pytest.approx([0.0, 0.0131, 0.0262], abs=1e-18)
    assert [one.name for one in coil.around("z", 2)] == ["1", "2"]
    for wrong in (lambda: coil.around("w", 2), lambda: coil.around("z", 0), lambda: coil.along([1, 2], 3)):
        with pytest.raises(InputError):
            wrong()
    for names in (["a"], "same"):
        with pytest.raises(InputError):
            coil.along([0, 0, 1], 3, names=names)


@dataclass(frozen=True, repr=False)
class HexagonalCoil(fm.Coil):
    """A coil class without keys in files."""

    kind = "hexagonal"

    name: str
    radius: float
    turns: float = 10.0
    height: float = 0.01
    polarity: int = 1
    placement: fm.Placement = field(default_factory=fm.Placement)
    resistance: float | None = None
    inductance: float | None = None

    def winding(self):
        return fm.CircularCoil("", 0.9 * self.radius, self.radius, self.height, 1.0).winding()


def test_coils_of_a_class_of_ones_own_need_no_keys():
    device = fm.Device("own", "", [HexagonalCoil("a", 0.02).moved([0, 0, 0.1]), HexagonalCoil("b", 0.03)])
    assert CoilSet(device.coils).field([0.0, 0.0, 0.1], 1.0)[2] > 0
    assert device.text == ""
    with pytest.raises(InputError) as caught:
        device.to_toml()
    assert "a, b" in caught.value.problems[0].received


def test_replaced_values_are_checked_and_their_sources_go():
    device = fm.read_device("disk_six_cores")
    bare = device.replace(bodies=device.bodies[:1])
    assert len(bare.bodies) == 1
    assert not any("core" in path for path in bare.provenance)
    assert tomllib.loads(bare.to_toml())["body"][0]["name"] == "disk"
    with pytest.raises(InputError):
        device.replace(coils=(*device.coils, device.coils[0]))


def test_a_map_of_a_device_is_that_of_its_file(tmp_path):
    loop = fm.CircularCoil("loop", 0.02, 0.022, 0.002, 100, placement=fm.placed([0, 0, 0.03]))
    device = fm.Device("loop", "A loop in air", coils=loop.around("z", 1))
    box = ([-0.01, -0.01, -0.01], [0.01, 0.01, 0.01])
    ours = fm.open_map(fm.generate(device, tmp_path / "ours.h5", box=box, spacing=4e-3))
    (tmp_path / "loop.toml").write_text(device.to_toml())
    recipe = 'format = 1\ntitle = "x"\ndevice = "loop.toml"\nspacing_mm = 4.0\n'
    recipe += "[box]\nlower_mm = [-10, -10, -10]\nupper_mm = [10, 10, 10]\n"
    (tmp_path / "recipe.toml").write_text(recipe)
    theirs = fm.open_map(fm.generate(tmp_path / "recipe.toml", tmp_path / "theirs.h5"))
    points = np.random.default_rng(0).uniform(*map(np.array, box), (50, 3))
    assert np.array_equal(ours.gradient(points, 1.5), theirs.gradient(points, 1.5))
    assert ours.error_bound == theirs.error_bound
    assert ours.info.provenance.device_text == theirs.info.provenance.device_text
    # The recorded text makes the device again.
    (tmp_path / "again.toml").write_text(
        ours.info.provenance.recipe_text.replace('device = "loop"', 'device = "loop.toml"')
    )
    again = fm.open_map(fm.generate(tmp_path / "again.toml", tmp_path / "again.h5"))
    assert np.array_equal(ours.field(points, 1.5), again.field(points, 1.5))


def test_what_a_map_of_a_device_needs():
    device = fm.read_device("disk_six_cores")
    for given, key in (
        ({}, "spacing"),
        ({"spacing": -1.0}, "spacing_mm"),
        ({"spacing": 4e-3, "currents": (2.0, 1.0)}, "currents"),
        ({"spacing": 4e-3, "iron": {"mu": 3.0}}, "iron.mu"),
        ({"spacing": 4e-3, "box": ([0, 0, 0], [0, 1, 1])}, "box.upper_mm"),
    ):
        with pytest.raises(RecipeError) as caught:
            fm.generate(device, **given)
        assert key in caught.value.problems[0].where
    with pytest.raises(RecipeError):
        fm.generate("quick", spacing=4e-3)
    with pytest.raises(RecipeError):
        fm.generate(3)
    recipe = recipe_for(device, 4e-3, currents={"lower_A": 0.5, "upper_A": np.full(6, 2.0), "states": 20})
    assert recipe.currents.states == 20
    assert recipe.spacing.tolist() == [4e-3] * 3


def test_what_is_no_map_file_and_what_is_a_field():
    coils = CoilSet(fm.read_device("disk_six_cores").coils)
    for given, word in ((coils, "already"), (fm.read_device("disk_six_cores"), "generate"), (3, "path")):
        with pytest.raises(InputError) as caught:
            fm.open_map(given)
        assert word in caught.value.problems[0].remedy
    assert fm.open_field(coils) is coils
    air = fm.Device("air", "", [fm.CircularCoil("a", 0.02, 0.03, 0.01, 100)])
    assert fm.open_field(air).field([0.0, 0.0, 0.0], 1.0)[2] > 0
    for wrong in (3, coils):
        with pytest.raises(InputError):
            fm.solve_linear(wrong)
    assert fm.design_figures("loop_and_sphere", 1.0).windings[0].coil == "loop"
    assert isinstance(Path(fm.read_device("disk_six_cores").source), Path)
