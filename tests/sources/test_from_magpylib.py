"""A magpylib model as a device: fields against magpylib's own, and the data as a file."""

import magpylib
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.sources import CoilSet

J = np.array([0.2, -0.3, 1.0])
CORNERS = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.012, 0], [0, 0, 0.009]])
BLOCK = [[x, y, z] for x in (0, 0.01) for y in (0, 0.01) for z in (0, 0.008)]
BALL = np.random.default_rng(3).normal(size=(40, 3))
BALL = 0.006 * BALL / np.linalg.norm(BALL, axis=1, keepdims=True)
magnet, current, misc = magpylib.magnet, magpylib.current, magpylib.misc
POINTS = np.random.default_rng(2).uniform([-0.06, -0.06, -0.06], [0.06, 0.06, -0.02], (100, 3))
SPACE = fm.WorkspaceBox([-0.02, -0.02, -0.05], [0.02, 0.02, -0.02])


def mixed():
    """Twenty sources and soft bodies in nested Collections, two of them moved on a path."""
    turns = [current.Circle(current=3.0, diameter=0.03, position=(0, 0, 0.03 + 0.002 * k)) for k in range(3)]
    winding = magpylib.Collection(*turns, style_label="winding")
    line = [[0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0], [0, 0, 0]]
    strip = [[0, 0, 0], [0, 0.01, 0], [0.01, 0, 0], [0.01, 0.01, 0.003], [0.02, 0, 0]]
    faces = [[0, 1, 2], [1, 2, 3]]
    currents = magpylib.Collection(
        current.Polyline(current=2.0, vertices=line, position=(0.03, 0.03, 0.03)),
        current.TriangleStrip(current=20.0, vertices=strip, position=(-0.05, 0, 0.03)),
        current.TriangleSheet(
            current_densities=[(1e3, 0, 5), (0, 500, 0)],
            vertices=strip[:4],
            faces=faces,
            position=(-0.05, 0.05, 0),
        ),
    )
    fixed = magpylib.Collection(
        magnet.Cuboid(polarization=J, dimension=(0.01, 0.012, 0.014), position=(0.05, 0, 0.03)),
        magnet.Cylinder(polarization=J, dimension=(0.01, 0.012), position=(0.05, 0.05, 0.03)),
        magnet.CylinderSegment(
            polarization=J, dimension=(0.004, 0.01, 0.012, 30, 140), position=(0, 0.05, 0.03)
        ),
        magnet.Sphere(polarization=J, diameter=0.01, position=(0, -0.05, 0.03)),
        magnet.Tetrahedron(polarization=J, vertices=CORNERS, position=(-0.05, -0.05, 0.03)),
        magnet.TriangularMesh.from_ConvexHull(points=BALL, polarization=J, position=(0.05, -0.05, 0.03)),
        misc.Dipole(moment=(0.1, 0.2, 0.3), position=(0, 0.07, 0.05)),
    ).rotate_from_angax(20, (1, 2, 3), anchor=(0, 0, 0.03))
    soft = magpylib.Collection(
        magnet.Cuboid(polarization=(0, 0, 0), dimension=(0.01, 0.012, 0.014), style_label="block"),
        magnet.Cylinder(polarization=(0, 0, 0), dimension=(0.01, 0.012), position=(0.022, 0, 0)),
        magnet.CylinderSegment(
            polarization=(0, 0, 0), dimension=(0.005, 0.01, 0.012, 30, 140), position=(0, 0.025, 0)
        ),
        magnet.Sphere(polarization=(0, 0, 0), diameter=0.01, position=(-0.02, 0, 0)),
        magnet.Tetrahedron(polarization=(0, 0, 0), vertices=CORNERS, position=(-0.02, -0.03, 0)),
        magnet.TriangularMesh.from_ConvexHull(points=BLOCK, polarization=(0, 0, 0), position=(0.02, 0.02, 0)),
    )
    soft.susceptibility = 499.0
    hard = magnet.Cuboid(polarization=(0, 0, 1.0), dimension=(0.008, 0.008, 0.008), position=(0.04, -0.02, 0))
    hard.susceptibility = 0.05
    hard.rotate_from_angax([10, 20, 30], "x", start=0)
    currents[0].move([[0, 0, 0], [0, 0, 0.01]], start=0)
    return magpylib.Collection(winding, magpylib.Collection(currents, fixed), soft, hard, magpylib.Sensor())


@pytest.fixture(scope="module")
def model():
    return mixed()


@pytest.fixture(scope="module")
def device(model):
    return fm.Device.from_magpylib(model, workspace=SPACE)


def at_the_end(things):
    """magpylib's field of sources at the last pose of their paths."""
    total = magpylib.getB(things, POINTS, sumup=True, squeeze=False)
    return total[0, -1, 0]


def sorted_by_kind(model):
    flat = model.sources_all
    currents = [
        one for one in flat if isinstance(one, magpylib._src.obj_classes.class_BaseExcitations.BaseCurrent)
    ]
    currents += [one for one in flat if isinstance(one, current.TriangleSheet) and one not in currents]
    soft = [one for one in flat if hasattr(one, "susceptibility") or hasattr(one.parent, "susceptibility")]
    return currents, soft, [one for one in flat if one not in currents and one not in soft]


def relative(one, other):
    return np.abs(one - other).max() / np.abs(other).max()


def test_coils_and_magnets_have_magpylibs_field(model, device):
    currents, soft, fixed = sorted_by_kind(model)
    assert (len(currents), len(soft), len(fixed)) == (6, 7, 7)
    assert len(device.coils) == 6
    assert len(device.bodies) == 7
    assert relative(CoilSet(device.coils).field(POINTS, device.nominal_currents), at_the_end(currents)) < 1e-9
    assert relative(device.background.field(POINTS), at_the_end(fixed)) < 1e-9


def test_bodies_are_magpylibs_solids(model, device):
    """Volumes and centroids; a magnet's remanence turns with it, at the last pose of its path."""
    from fieldmap.iron.geometry.solids import body_solid

    _, soft, _ = sorted_by_kind(model)
    for thing, body in zip(soft, device.bodies, strict=True):
        solid = body_solid(body)
        assert 1e-9 * solid.mass == pytest.approx(thing.volume, rel=1e-6)
        place = np.atleast_2d(thing.centroid)[-1]
        if isinstance(thing, magnet.Tetrahedron | magnet.Cuboid | magnet.Cylinder | magnet.Sphere):
            assert np.array(list(solid.center)) * 1e-3 == pytest.approx(place, abs=1e-9)
    hard = device.materials[device.bodies[-1].material]
    turn = np.radians(30.0)
    assert hard.remanence == pytest.approx([0.0, -np.sin(turn), np.cos(turn)], abs=1e-12)
    assert hard.mu_r == 1.05
    assert {device.materials[body.material].initial_mu_r for body in device.bodies[:-1]} == {500.0}


@pytest.mark.parametrize(
    ("inner", "first", "last"),
    [
        (0, 30, 140),
        (0.005, 100, 112),
        (0.002, -150, -60),
        (0.002, -150, 200),
        (0.004, 80, 260),
        (0, -90, 270),
        (0.003, 0, 360),
    ],
)
def test_sectors_of_cylinders_and_rings_have_their_volume_and_centroid(inner, first, last):
    """Closed forms: area A = phi (b^2 - a^2) / 2, centroid (2 / 3) (b^3 - a^3) sin(phi / 2) / A off the axis."""
    from fieldmap.iron.geometry.solids import body_solid

    outer, height, angle = 0.01, 0.012, np.radians(last - first)
    sector = magnet.CylinderSegment(polarization=J, dimension=(inner, outer, height, first, last))
    sector.susceptibility = 99.0
    (body,) = fm.Device.from_magpylib([current.Circle(current=1.0, diameter=0.1), sector]).bodies
    solid = body_solid(body)
    area = 0.5 * angle * (outer**2 - inner**2)
    off = 2.0 / 3.0 * (outer**3 - inner**3) * np.sin(0.5 * angle) / area
    middle = np.radians(0.5 * (first + last))
    assert 1e-9 * solid.mass == pytest.approx(area * height, rel=1e-6)
    centre = [off * np.cos(middle), off * np.sin(middle), 0.0]
    assert 1e-3 * np.array(list(solid.center)) == pytest.approx(centre, abs=1e-8)


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 2, 1, 3]])
def test_corners_of_a_tetrahedron_may_come_in_any_order(order):
    """The volume is a sixth of the product of three orthogonal edges, and the surface faces outward."""
    tetrahedron = magnet.Tetrahedron(polarization=J, vertices=CORNERS[order])
    tetrahedron.susceptibility = 99.0
    (body,) = fm.Device.from_magpylib([current.Circle(current=1.0, diameter=0.1), tetrahedron]).bodies
    (part,) = body.parts
    a, b, c = np.moveaxis(part.shape.points[part.shape.triangles], 1, 0)
    assert np.einsum("ti,ti->", a, np.cross(b, c)) / 6 == pytest.approx(0.01 * 0.012 * 0.009 / 6, rel=1e-12)


def test_as_a_file_and_read_again(device, tmp_path):
    (tmp_path / "model.toml").write_text(device.to_toml())
    read = fm.read_device(tmp_path / "model.toml")
    currents = device.nominal_currents
    assert read.nominal_currents == currents
    assert (
        relative(CoilSet(read.coils).field(POINTS, currents), CoilSet(device.coils).field(POINTS, currents))
        < 1e-14
    )
    assert relative(read.background.field(POINTS), device.background.field(POINTS)) < 1e-10
    assert read.to_toml() == device.to_toml()
    assert fm.Device.from_magpylib(mixed(), workspace=SPACE).to_toml() == device.to_toml()


def test_solved_within_the_stated_error(device):
    """Against a finer mesh, in the workspace, each coil and the magnets."""
    quick = fm.Background(sources=[one for one in device.background.sources if one.kind != "CylinderSegment"])
    few = device.replace(
        bodies=device.bodies[:1] + device.bodies[-1:], coils=device.coils[2:4], background=quick
    )
    solved = fm.solve_to_tolerance(few, 0.05)
    finer = fm.solve_linear(few, refinement=1.3)
    lower, upper = SPACE.bounds
    points = lower + (upper - lower) * np.random.default_rng(0).random((50, 3))
    fields = zip(solved.source_fields(points)[0], finer.source_fields(points)[0], strict=True)
    for ours, exact in fields:
        error = np.linalg.norm(ours - exact, axis=1).max() / np.linalg.norm(exact, axis=1).max()
        assert error < 3 * solved.report.error.flux_density < 0.15


@pytest.mark.filterwarnings("ignore::fieldmap.errors.UnusualValueWarning")
def test_a_soft_sphere_in_the_field_of_a_loop_far_away():
    """In closed form a dipole of (mu_r - 1)/(mu_r + 2) of the field; one line of a magpylib user."""
    loop = current.Circle(current=1000.0, diameter=2.0)
    ball = magnet.Sphere(polarization=(0, 0, 0), diameter=0.02)
    ball.susceptibility = 999.0
    device = fm.Device.from_magpylib([loop, ball])
    assert device.bodies[0].mesh_size == pytest.approx(0.02 / 5)
    solved = fm.solve_linear(device)
    points = np.array([[0.0, 0.0, 0.02], [0.015, 0.01, 0.0]])
    applied = loop.getB([0.0, 0.0, 0.0])
    r = np.linalg.norm(points, axis=1)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    shape = (3 * points * points[:, 2:] / r**2 - up) / r**3
    exact = loop.getB(points) + 999 / 1002 * 0.01**3 * applied[2] * shape
    assert relative(solved.field(points, device.nominal_currents), exact) < 3e-3


def test_materials_by_label_curves_and_saturation():
    core = magnet.Cylinder(polarization=(0, 0, 0), dimension=(0.01, 0.02), style_label="core")
    plate = magnet.Cuboid(polarization=(0, 0, 0), dimension=(0.02, 0.02, 0.002), position=(0, 0, 0.02))

    class Curve:
        H = np.array([0.0, 200.0, 1000.0, 10000.0])
        B = np.array([0.0, 0.5, 1.2, 1.7])

    plate.susceptibility = Curve()
    loop = current.Circle(current=1.0, diameter=0.04)
    steel = fm.Froehlich("steel", 1000.0, 2.1)
    device = fm.Device.from_magpylib(
        [loop, core, plate], materials={"core": steel}, mesh_size={"core": 0.003}
    )
    assert device.materials[device.bodies[0].material].initial_mu_r == 1000.0
    # The plate's mesh size is its thickness, because this is less than a fifth of its side.
    assert [body.mesh_size for body in device.bodies] == [0.003, 0.002]
    table = device.materials[device.bodies[1].material]
    assert table.h.tolist() == [200.0, 1000.0, 10000.0]
    assert table.initial_mu_r == pytest.approx(0.5 / (magpylib.mu_0 * 200.0))


def test_bodies_of_one_permeability_share_a_material():
    def cube(k, susceptibility):
        made = magnet.Cuboid(polarization=(0, 0, 0), dimension=(0.01,) * 3, position=(0.02 * k, 0, 0))
        made.susceptibility = susceptibility
        return made

    device = fm.Device.from_magpylib([cube(k, value) for k, value in enumerate((99.0, 999.0, 99.0))])
    names = [body.material for body in device.bodies]
    assert [device.materials[name].initial_mu_r for name in names] == [100.0, 1000.0, 100.0]
    assert names[0] == names[2] != names[1]
    assert len(device.materials) == 2


def test_coils_of_collections_and_one_source():
    pair = magpylib.Collection(
        *(current.Circle(current=2.0, diameter=0.04, position=(0, 0, z)) for z in (0.0, 0.02))
    )
    pair.style.label = "the pair"
    device = fm.Device.from_magpylib(magpylib.Collection(pair), coils="collections")
    assert device.nominal_currents == {"the_pair": 2.0}
    assert relative(CoilSet(device.coils).field(POINTS, 2.0), pair.getB(POINTS)) < 1e-12
    assert fm.Device.from_magpylib(pair[0]).coil_names == ("Circle_1",)


@pytest.mark.parametrize("nested", [False, True])
def test_magnets_alone_are_a_device(nested):
    """Without coils and bodies, from one Collection or a nested one: the device has magpylib's field."""
    magnets = [
        magnet.Cuboid(polarization=J, dimension=(0.01, 0.012, 0.014)),
        magnet.Cylinder(polarization=J, dimension=(0.01, 0.012), position=(0.03, 0, 0)),
    ]
    model = magpylib.Collection(magpylib.Collection(*magnets) if nested else magnets)
    exact = magpylib.getB(model, POINTS)
    device = fm.Device.from_magpylib(model, workspace=SPACE)
    assert (device.coil_names, device.fixed_sources) == ((), ("background",))
    for one in (device, fm.read_device(device.to_toml())):
        found = fm.solve_linear(one).field(POINTS, [])
        assert np.abs(found - exact).max() < 1e-11 * np.abs(exact).max()


def test_a_solution_can_be_a_source_of_the_next_device():
    """The result of `as_magpylib` is a magpylib source: a field that no current of the new device drives."""
    unit = fm.solve_linear("loop_and_sphere")
    ball = magnet.Sphere(polarization=(0, 0, 0), diameter=0.002, position=(0, 0, 0.05))
    ball.susceptibility = 10.0
    device = fm.Device.from_magpylib([unit.as_magpylib([1.0]), ball])
    places = np.array([[0.0, 0.0, -0.03], [0.02, 0.0, 0.03]])
    field, gradient = device.background.field_and_gradient(places)
    assert relative(field, unit.field(places, [1.0])) < 1e-12
    assert relative(gradient, unit.gradient(places, [1.0])) < 1e-5
    solved = fm.solve_linear(device)
    assert relative(solved.as_magpylib([]).getB(places), solved.field(places, [])) < 1e-12
    with pytest.raises(InputError) as caught:
        device.to_toml()
    assert caught.value.problems[0].received == "background"


@pytest.mark.parametrize(
    ("thing", "susceptibility", "where"),
    [
        (
            magnet.Cuboid(polarization=(0, 0, 0), dimension=(1, 1, 1)),
            (1.0, 2.0, 3.0),
            "from_magpylib, Cuboid",
        ),
        (magnet.Cuboid(polarization=(0, 0, 0), dimension=(1, 1, 1)), -1.0, "from_magpylib, Cuboid"),
        (magnet.Cuboid(polarization=(0, 0, 0), dimension=(1, 1, 1)), "steel", "from_magpylib, Cuboid"),
        (magnet.Cuboid(polarization=(0, 0, 0)), 5.0, "from_magpylib, Cuboid"),
        (
            magnet.Cuboid(polarization=(0, 0, 1), dimension=(1, 1, 1)),
            fm.Froehlich("a", 9.0, 2.0),
            "from_magpylib, Cuboid",
        ),
        (misc.Dipole(moment=(1, 0, 0)), 5.0, "from_magpylib, Dipole"),
    ],
)
def test_what_cannot_be_taken_is_told_by_name(thing, susceptibility, where):
    thing = thing.copy()
    thing.style.label = None
    thing.susceptibility = susceptibility
    with pytest.raises(InputError) as caught:
        fm.Device.from_magpylib(thing)
    assert [problem.where for problem in caught.value.problems] == [where]


def test_all_mistakes_at_once():
    loop = current.Circle(diameter=0.04)
    with pytest.raises(InputError) as caught:
        fm.Device.from_magpylib([loop, current.Polyline(current=1.0)], materials={"core": 9.0})
    assert [problem.where for problem in caught.value.problems] == [
        "from_magpylib, Circle",
        "from_magpylib, Polyline",
        "from_magpylib, materials",
    ]
    with pytest.raises(InputError) as caught:
        fm.Device.from_magpylib("a loop")
    assert caught.value.problems[0].where == "from_magpylib, model"


def test_attributes_are_those_at_the_end_of_a_path():
    loop = current.Circle(current=[1.0, 2.0, 5.0], diameter=[0.01, 0.02, 0.04])
    device = fm.Device.from_magpylib(loop)
    assert device.nominal_currents == {"Circle_1": 5.0}
    last = current.Circle(current=5.0, diameter=0.04)
    assert relative(CoilSet(device.coils).field(POINTS, 5.0), last.getB(POINTS)) < 1e-12
