"""Currents and magnets of magpylib's kinds in air: against magpylib, differences, closed forms and energies."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.device.air_fields import (
    STEP,
    differenced,
    flux_density,
    flux_density_and_gradient,
    magpylib_object,
)
from fieldmap.device.air_sources import AirSource
from fieldmap.device.background import Background
from fieldmap.device.coils.magpylib import MagpylibCoil
from fieldmap.device.placement import Placement
from fieldmap.errors import InputError
from fieldmap.sources import CoilSet, unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.winding_rules import current_elements, current_elements_of, flux_elements

J = np.array([0.2, -0.3, 1.0])
CORNERS = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.012, 0], [0, 0, 0.009]])
ZIGZAG = np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0.005], [0, 0.02, 0], [0, 0, 0]])
STRIP = np.array([[0, 0, 0], [0, 0.01, 0], [0.01, 0, 0], [0.01, 0.01, 0.003], [0.02, 0, 0]])
FACES = np.array([[0, 1, 2], [1, 2, 3]])
OUTWARD = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""Faces of a tetrahedron of positive volume, seen from outside anticlockwise."""
BALL = np.random.default_rng(1).normal(size=(40, 3))
BALL = 0.006 * BALL / np.linalg.norm(BALL, axis=1, keepdims=True)
magnet, current, misc = magpylib.magnet, magpylib.current, magpylib.misc
OBJECTS = [
    current.Circle(current=3.0, diameter=0.02),
    current.Polyline(current=2.0, vertices=ZIGZAG),
    current.TriangleStrip(current=2.0, vertices=STRIP),
    current.TriangleSheet(current_densities=[(100, 30, 0), (50, -50, 0)], vertices=STRIP[:4], faces=FACES),
    magnet.Cuboid(polarization=J, dimension=(0.01, 0.012, 0.014)),
    magnet.Cylinder(polarization=(0, 0, 1), dimension=(0.01, 0.012)),
    magnet.Cylinder(polarization=J, dimension=(0.01, 0.012)),
    magnet.CylinderSegment(polarization=J, dimension=(0.004, 0.01, 0.012, 30, 140)),
    magnet.Sphere(polarization=J, diameter=0.01),
    magnet.Tetrahedron(polarization=J, vertices=CORNERS),
    magnet.Tetrahedron(polarization=J, vertices=CORNERS[[1, 0, 2, 3]]),
    magnet.TriangularMesh.from_ConvexHull(points=BALL, polarization=J),
    misc.Dipole(moment=(0.1, 0.2, 0.3)),
    misc.Triangle(polarization=J, vertices=CORNERS[:3]),
]
IDS = [type(one).__name__ for one in OBJECTS]
CURRENTS = OBJECTS[:4]
_DIFFERENCED = OBJECTS[6:8]
POSITION, TURN = np.array([0.002, -0.001, 0.003]), Rotation.from_rotvec([0.4, -0.3, 0.2])


def placed(thing):
    return thing.copy(position=POSITION, orientation=TURN)


def source(thing):
    return Background.from_magpylib(placed(thing)).sources[0]


@pytest.fixture(scope="module")
def everywhere():
    """Points inside and outside, as near as 0.1 mm to surfaces."""
    return np.random.default_rng(0).uniform(-0.03, 0.03, (300, 3))


@pytest.fixture(scope="module")
def around(everywhere):
    """Points about 5 mm or more from all sources."""
    return everywhere[np.linalg.norm(everywhere - POSITION, axis=1) > 0.027]


@pytest.mark.parametrize("thing", OBJECTS, ids=IDS)
def test_flux_density_is_that_of_magpylib(thing, everywhere):
    theirs = placed(thing).getB(everywhere)
    for ours in (
        flux_density(source(thing), everywhere),
        flux_density_and_gradient(source(thing), everywhere)[0],
    ):
        error = np.linalg.norm(ours - theirs, axis=1) / np.linalg.norm(theirs, axis=1)
        assert error.max() < 1e-9


def test_beside_the_edge_of_a_sheet_the_field_grows_as_the_logarithm():
    """In the sheet's plane B_z is mu0 K / 2 pi times the logarithm of the distance, with K along the edge. At 1 nm
    magpylib 6.1 gives the other sign."""
    corners = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]])
    sheet = current.TriangleSheet(current_densities=[(0, 100, 0)], vertices=corners, faces=[[0, 1, 2]])
    one = Background.from_magpylib(sheet).sources[0]
    near, far = (np.array([[-d, 0.004, 0], [0.004, -d, 0], [0.005 + d, 0.005 + d, 0]]) for d in (1e-9, 1e-6))
    np.testing.assert_allclose(flux_density(one, far), sheet.getB(far), rtol=1e-6, atol=1e-12)
    along = np.array([100.0, 0.0, -100.0 / np.sqrt(2)])
    growth = flux_density(one, near) - flux_density(one, far)
    np.testing.assert_allclose(growth[:, 2], 2e-7 * along * np.log(1e3), rtol=1e-3, atol=1e-8)


R, H = 0.005, np.array([0.005, 0.006, 0.007])
SINGULAR = {
    "Circle": [[0.01, 0, 0], [0, -0.01, 0]],
    "Polyline": [*ZIGZAG, *(ZIGZAG[1:] + ZIGZAG[:-1]) / 2],
    "TriangleStrip": [*STRIP, STRIP[:3].mean(axis=0), (STRIP[3] + STRIP[4]) / 2],
    "TriangleSheet": [*STRIP[:4], STRIP[:3].mean(axis=0), [1e-9, 0.004, 0], (STRIP[0] + STRIP[1]) / 2],
    "Dipole": [[0, 0, 0]],
}
"""Where a source has no flux density; magnets have one everywhere, up to rounding."""
REGULAR = {
    "Circle": [[0, 0, 0], [0.01, 0, 1e-6], [0, 0, 0.01]],
    # On the line through a segment, beyond its ends.
    "Polyline": [[-0.005, 0, 0], [0.02, 0, 0], [0.01, 1e-6, 1e-6]],
    "TriangleStrip": [[-1e-6, 0.005, 0], [0.005, 0.005, -1e-6]],
    "TriangleSheet": [[-1e-6, 0.005, 0], [0.003, 0.003, -1e-6]],
    "Dipole": [[1e-6, 0, 0]],
}
EDGES = {
    "Cuboid": [H, H * [1, -1, 0], H * [1, 0, 1]],
    "Cylinder": [[R, 0, 0.006], [0, R, -0.006]],
    "Tetrahedron": [*CORNERS, (CORNERS[1] + CORNERS[2]) / 2],
    "TriangularMesh": [BALL[0], BALL[7]],
    "Triangle": [*CORNERS[:3], (CORNERS[1] + CORNERS[2]) / 2],
}


@pytest.mark.parametrize("thing", OBJECTS, ids=IDS)
def test_where_there_is_no_value_it_is_nan(thing):
    """On lines, sheets and dipoles; at edges of magnets B is a number. numpy's warnings are errors in the tests."""
    kind = type(thing).__name__
    one = Background.from_magpylib(thing).sources[0]
    none, some = (np.reshape(table.get(kind, []), (-1, 3)) for table in (SINGULAR, REGULAR))
    both = np.concatenate([none, some, [[0.0213, 0.0171, -0.0312]]])
    expected = np.arange(len(both)) < len(none)
    flux, slope = flux_density_and_gradient(one, both)
    for found in (flux_density(one, both), flux, slope.reshape(-1, 9)):
        np.testing.assert_array_equal(np.isnan(found), np.repeat(expected[:, None], found.shape[1], axis=1))
    edges = np.reshape(EDGES.get(kind, []), (-1, 3))
    assert np.isfinite(flux_density_and_gradient(one, edges)[0]).all()


def test_inside_a_flat_and_oblique_magnet_is_what_its_corners_surround():
    """B jumps by J at the surface; points are inside by their barycentric coordinates."""
    rng = np.random.default_rng(4)
    corners = np.array([[0, 0, 0], [0.05, 0.002, 0], [0.045, 0.01, 0.001], [0.003, 0.004, 0.012]])
    shares = rng.normal(size=(2000, 4)) ** 2 * rng.choice([1.0, -0.1], (2000, 4), p=[0.9, 0.1])
    shares /= shares.sum(axis=1, keepdims=True)
    points, within = shares @ corners, (shares > 0).all(axis=1)
    assert 500 < within.sum() < 1500
    found = flux_density(
        Background.from_magpylib(magnet.Tetrahedron(polarization=J, vertices=corners)).sources[0], points
    )
    normals = np.array([np.cross(corners[b] - corners[a], corners[c] - corners[a]) for a, b, c in OUTWARD])
    charged = sum(
        misc.Triangle(polarization=J, vertices=corners[list(face)]).getB(points) for face in OUTWARD
    )
    assert (np.einsum("fk,fk->f", normals, corners[[f[0] for f in OUTWARD]] - corners.mean(axis=0)) > 0).all()
    np.testing.assert_allclose(found - charged, within[:, None] * J, atol=1e-6)


@pytest.mark.parametrize("thing", OBJECTS, ids=IDS)
def test_gradient_is_the_derivative_and_that_of_a_field_in_air(thing, around):
    one = source(thing)
    gradient = flux_density_and_gradient(one, around)[1]
    expected = differenced(
        placed(thing).getB, around, STEP * float(one.extents.max()) * (0.7 if thing in _DIFFERENCED else 1.0)
    )
    size = np.abs(gradient).max(axis=(1, 2))
    error = np.abs(gradient - expected).max(axis=(1, 2)) / size
    assert np.median(error) < 1e-8
    assert error.max() < 2e-5  # magpylib's own B is off by 1e-9 at single points
    rounding = 2e-5 if thing in _DIFFERENCED else 1e-12
    assert (np.abs(np.trace(gradient, axis1=1, axis2=2)) < rounding * size).all()
    if not isinstance(thing, current.TriangleStrip | current.TriangleSheet):  # currents with ends
        assert (np.abs(gradient - gradient.transpose(0, 2, 1)).max(axis=(1, 2)) < rounding * size).all()


def test_differences_are_as_good_as_stated():
    """A tenth of the size from the faces of a cuboid, whose gradient is exact: 1e-6 of the gradient."""
    one = AirSource("Cuboid", dimension=np.array([0.01, 0.01, 0.01]), polarization=J)
    points = np.array(
        [[0.006, 0.0, 0.0], [0.002, 0.0061, 0.003], [0.0057, 0.0057, 0.001], [0.0, 0.0, -0.012]]
    )
    exact = flux_density_and_gradient(one, points)[1]
    found = differenced(lambda x: flux_density(one, x), points, STEP * float(one.extents.max()))
    assert (np.abs(found - exact).max(axis=(1, 2)) < 1e-6 * np.abs(exact).max(axis=(1, 2))).all()


@pytest.mark.parametrize("thing", OBJECTS, ids=IDS)
def test_there_and_back(thing):
    """The object made from the data has the field of the original object."""
    points = np.array([[0.02, 0.01, -0.02], [0.0, -0.03, 0.01]])
    again = placed(magpylib_object(source(thing)))
    assert type(again) is type(thing)
    assert again.getB(points) == pytest.approx(placed(thing).getB(points), rel=1e-12)


@pytest.mark.parametrize("thing", CURRENTS, ids=IDS[:4])
def test_a_coil_scales_its_currents_and_the_force_on_it_is_magpylibs(thing):
    """Against magpylib's getFT with a dipole as source; with turns, polarity and a placement of the coil."""
    place = Placement(np.array([0.01, 0.02, -0.01]), Rotation.from_rotvec([0.0, 0.5, 0.1]).as_matrix())
    coil = MagpylibCoil.from_magpylib("c", placed(thing), turns=3.0, polarity=-1, placement=place)
    nominal = getattr(thing, "current", None) or 1.0
    assert coil.nominal_current in (None, -nominal / 3)
    moved = placed(thing).rotate(Rotation.from_matrix(place.rotation), anchor=0).move(place.position)
    points = np.array([[0.05, 0.01, -0.02], [0.0, -0.05, 0.01]])
    assert -3 * moved.getB(points) / nominal == pytest.approx(unit_flux_density(coil, points), rel=1e-10)
    assert unit_flux_density_and_gradient(coil, points)[0] == pytest.approx(unit_flux_density(coil, points))
    dipole = magpylib.misc.Dipole(moment=(3.0, -1.0, 10.0), position=(0.06, 0.0, 0.05))
    force, torque = magpylib.getFT(dipole, moved, pivot=(0, 0, 0), meshing=4000)
    rule = current_elements(coil)
    pieces = np.cross(rule.vectors, dipole.getB(rule.points))
    assert -nominal / 3 * pieces.sum(axis=0) == pytest.approx(force, rel=1e-3, abs=1e-3 * np.abs(force).max())
    turning = np.cross(rule.points, pieces).sum(axis=0)
    assert -nominal / 3 * turning == pytest.approx(torque, rel=1e-3, abs=1e-3 * np.abs(torque).max())


def test_any_source_can_be_a_coil(everywhere):
    """A magnet and a user's own source: their field counts as the field of 1 A."""
    uniform = misc.CustomSource(field_func=lambda field, observers: np.array(observers) * [1.0, 1.0, -2.0])
    group = magpylib.Collection(OBJECTS[4].copy(), uniform)
    coil = MagpylibCoil.from_magpylib("both", group)
    assert coil.nominal_current is None
    assert unit_flux_density(coil, everywhere) == pytest.approx(group.getB(everywhere), rel=1e-9)
    gradient = unit_flux_density_and_gradient(MagpylibCoil.from_magpylib("own", uniform), everywhere)[1]
    assert gradient == pytest.approx(np.tile(np.diag([1.0, 1.0, -2.0]), (300, 1, 1)), abs=1e-9)


def test_currents_of_one_coil_keep_their_shares():
    one, two = (current.Circle(current=i, diameter=0.02, position=(0, 0, 0.01 * i)) for i in (2.0, -6.0))
    coil = MagpylibCoil.from_magpylib("pair", [one, two])
    assert [part.current for part in coil.sources] == [1.0, -3.0]
    point = np.array([[0.0, 0.003, 0.1]])
    both = one.getB(point) + two.getB(point)
    assert 2.0 * unit_flux_density(coil, point)[0] == pytest.approx(both, rel=1e-12)


def test_what_filaments_lack_is_told_by_name():
    coil = MagpylibCoil.from_magpylib("loop", OBJECTS[0])
    with pytest.raises(InputError) as caught:
        flux_elements(coil)
    assert caught.value.problems[0].where == "coil 'loop'"
    with pytest.raises(InputError) as caught:
        current_elements_of(source(OBJECTS[4]))
    assert caught.value.problems[0].received == "a Cuboid"
    with pytest.raises(InputError) as caught:
        MagpylibCoil.from_magpylib("nothing", [])
    assert caught.value.problems[0].where == "from_magpylib, model"
    assert isinstance(coil, MagpylibCoil)


def test_a_field_that_is_not_known_everywhere_is_told():
    nowhere = misc.CustomSource(field_func=lambda field, observers: np.full(np.shape(observers), np.nan))
    with pytest.raises(InputError) as caught:
        unit_flux_density(MagpylibCoil.from_magpylib("own", nowhere), np.zeros((2, 3)))
    assert caught.value.problems[0].where == "magpylib CustomSource"


@pytest.mark.parametrize("options", [{}, {"turns": 100.0}, {"turns": 50.0, "polarity": -1}])
def test_strands_at_the_nominal_current_have_the_field_of_the_model(options):
    """Two strands of 2 A and 3 A: ampere-turns, also if the coil has turns."""
    strands = [current.Circle(current=2.0, diameter=0.04), current.Circle(current=3.0, diameter=0.05)]
    coil = MagpylibCoil.from_magpylib("strands", strands, **options)
    at = np.array([[0.003, 0.002, 0.02]])
    found = CoilSet((coil,)).field(at, [coil.nominal_current])
    np.testing.assert_allclose(found[0], sum(strand.getB(at[0]) for strand in strands), rtol=1e-12)
    assert (
        MagpylibCoil.from_magpylib("strands", strands, nominal_current=7.0, turns=9.0).nominal_current == 7.0
    )
