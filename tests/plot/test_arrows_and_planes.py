"""Every kind of arrow is slender and ends where its vector ends; planes are where the box has them."""

import numpy as np
import pytest
import pyvista as pv

import fieldmap
from fieldmap.plot import forces, live_window, scales
from fieldmap.plot.device_drawing import add_payload, arrows_at
from fieldmap.plot.places import box_grid, grid_points, plane_grids, plane_of
from fieldmap.plot.solids import current_arrow
from tests.plot.conftest import needs_opengl
from tests.plot.test_scenes import three_ways

ALONG = np.array([0.6, 0.0, 0.8])
# All these numbers and their midpoints differ.
LOWER, UPPER = np.array([-0.01, 0.02, -0.07]), np.array([0.03, 0.08, -0.03])


def measured(points, start, end):
    """Least and largest position of points along an arrow (0 to 1), and their largest distance from its line relative
    to its length."""
    way = np.subtract(end, start)
    off = np.asarray(points, float) - start
    share = off @ way / (way @ way)
    return (
        share.min(),
        share.max(),
        np.linalg.norm(off - share[:, None] * way, axis=1).max() / np.linalg.norm(way),
    )


def slender(points, start, end, widest=0.25):
    first, last, width = measured(points, start, end)
    assert (first, last) == pytest.approx((0.0, 1.0), abs=1e-5)
    assert 0.01 < width < widest


class Recorder:
    """A plotter that records its calls."""

    def __init__(self):
        self.meshes, self.labels = [], []

    def add_mesh(self, mesh, **_):
        self.meshes.append(mesh)

    def add_lines(self, lines, **_):
        self.lines = lines

    def add_point_labels(self, places, words, **_):
        self.labels += zip(words, places, strict=True)


def test_arrows_of_coils_end_at_their_forces():
    """All have one thickness at any length; names are a tenth beyond the tips."""
    found, scene = three_ways(), Recorder()
    size = float(np.ptp(1e3 * found.vertices, axis=0).max())
    forces._add_coils(scene, found, np.full(3, 1e3), size)
    start, ends = np.array([0.0, 0.0, 1.0]), [0.0, 0.0, 1.0] + 1e3 * found.per_ampere
    assert [name for name, _ in scene.labels] == ["a", "b", "c"]
    widths = []
    for arrow, (_, name_at), end in zip(scene.meshes, scene.labels, ends, strict=True):
        first, last, width = measured(arrow.points, start, end)
        assert (first, last) == pytest.approx((0.0, 1.0), abs=1e-5)
        widths.append(width * np.linalg.norm(end - start))
        beyond, _, beside = measured(name_at[None], start, end)
        assert 1.05 < beyond < 1.2
        assert beside < 1e-9
    assert widths == pytest.approx([widths[0]] * 3, rel=1e-3)
    assert 0.01 * size < widths[0] < 0.03 * size


def test_arrows_of_vectors_are_centred_and_as_long_as_these():
    places, vectors = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]), np.array([2.0 * ALONG, [0.0, -1.0, 0.0]])
    points = arrows_at(places, vectors, 10.0).points
    for middle, vector in zip(1e3 * places, 5.0 * vectors, strict=True):
        near = points[np.linalg.norm(points - middle, axis=1) < 20.0]
        slender(near, middle - 0.5 * vector, middle + 0.5 * vector)


def test_the_arrow_of_the_payload_stands_on_it_and_is_as_long():
    payload, scene, at = fieldmap.read_device("drive_unit").payload, Recorder(), np.array([1.0, 2.0, -90.0])
    add_payload(scene, payload, at)
    solid, arrow = scene.meshes[0], scene.meshes[-1]
    bottom, top = solid.bounds[4:]
    assert 0.5 * (bottom + top) == pytest.approx(at[2], abs=1e-4)
    slender(arrow.points, [*at[:2], top], [*at[:2], 2.0 * top - bottom])


def test_the_arrow_of_a_current_has_a_tip_wider_than_its_shaft():
    """The tip is a cone at the end of the path, 0.1 to 0.2 of the winding's height."""
    for coil in fieldmap.read_device("drive_unit").coils[:2]:
        height, arrow = 1e3 * coil.height, current_arrow(coil)
        middle = 1e3 * coil.placement.position[2]
        assert 0.1 * height < np.ptp(np.asarray(arrow.points)[:, 2]) < 0.2 * height
        assert np.abs(np.asarray(arrow.points)[:, 2] - middle).max() < 0.6 * height


def test_the_arrow_of_the_live_window_lies_along_its_vector():
    matrix = live_window._along(ALONG, 7.0, np.array([1.0, 2.0, 3.0]))
    slender(
        pv.Arrow().transform(matrix, inplace=False).points, [1.0, 2.0, 3.0], [1.0, 2.0, 3.0] + 7.0 * ALONG
    )
    turn = matrix[:3, :3] / 7.0
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_planes_lie_in_the_middle_of_a_box_and_on_its_floor():
    whole = 1e3 * np.column_stack([LOWER, UPPER])
    for count, floor in ((3, True), (2, False)):
        planes = plane_grids((LOWER, UPPER), points=5, floor=floor)
        assert len(planes) == count
        for plane, axis, at in zip(planes, range(3), (10.0, 50.0, -70.0), strict=False):
            expected = whole.copy()
            expected[axis] = at
            np.testing.assert_allclose(np.reshape(plane.bounds, (3, 2)), expected, atol=1e-9)
            assert plane.dimensions == tuple(1 if k == axis else 5 for k in range(3))


@pytest.mark.parametrize(
    ("normal", "axes", "middle"), [("x", (1, 2), 0.01), ("y", (0, 2), 0.05), ("z", (0, 1), -0.05)]
)
def test_points_of_a_plane_are_middles_of_its_cells(normal, axes, middle):
    across = "xyz".index(normal)
    for at in (None, -0.2):
        points, found = plane_of((LOWER, UPPER), normal, at, (4, 2))
        assert found == axes
        np.testing.assert_allclose(points[:, across], middle if at is None else at, atol=1e-15)
        for axis, n, column in zip(axes, (4, 2), points[:, axes].T, strict=True):
            shares = (np.unique(column.round(12)) - LOWER[axis]) / (UPPER - LOWER)[axis]
            np.testing.assert_allclose(shares, (np.arange(n) + 0.5) / n, atol=1e-9)
        # The first axis varies slowest.
        assert (np.diff(points[:, axes[0]]) >= 0.0).all()


def test_a_grid_fills_its_box_and_its_points_lie_a_hair_inside():
    """One point along an axis is at the lower end; a map would refuse points that rounding puts outside."""
    assert [plane.dimensions for plane in plane_grids((LOWER, UPPER))] == [
        (1, 61, 61),
        (61, 1, 61),
        (61, 61, 1),
    ]
    for counts in ((2, 3, 4), (4, 1, 2)):
        grid = box_grid((LOWER, UPPER), counts)
        points, asked = np.asarray(grid.points, float), grid_points(grid, (LOWER, UPPER))
        assert grid.dimensions == counts
        for axis, count in enumerate(counts):
            expected = 1e3 * np.linspace(LOWER[axis], UPPER[axis], count)
            np.testing.assert_allclose(np.unique(points[:, axis].round(9)), expected, atol=1e-9)
        np.testing.assert_allclose(asked, 1e-3 * points, atol=1e-9)
        assert (asked > LOWER).all()
        assert (asked < UPPER).all()


def test_numbers_of_rulers_stand_at_their_places_and_titles_beside_the_middle(monkeypatch):
    """Each number is at its coordinate; titles of x and y at the middle of a side, the title of z above its end."""
    sides, scene = 1e3 * np.column_stack([LOWER, UPPER]), Recorder()
    monkeypatch.setattr(scales, "extent", lambda _: sides)
    scales.add_rulers(scene)
    titles = {words: place for words, place in scene.labels if words in scales.MILLIMETRES}
    x, y, z = (titles[words] for words in scales.MILLIMETRES)
    middle, size = sides.mean(axis=1), np.ptp(sides, axis=1).max()
    assert (x[0], y[1]) == pytest.approx((middle[0], middle[1]), abs=0.2 * size)
    assert sides[2, 1] < z[2] < sides[2, 1] + 0.2 * size
    # Below the lower front edge, below and right of the lower right edge, left of the left front edge.
    assert x[2] < sides[2, 0]
    assert y[2] < sides[2, 0]
    assert y[0] > sides[0, 1]
    assert z[0] < sides[0, 0]
    axis, numbers = 0, {0: [], 1: [], 2: []}
    for words, place in scene.labels:
        if words in titles:
            axis += 1
        else:
            numbers[axis].append((float(words), place[axis]))
    for axis, (value, place) in ((axis, np.array(pairs).T) for axis, pairs in numbers.items()):
        off = place - value
        assert np.ptp(off) == pytest.approx(0.0, abs=1e-9)
        assert abs(off[0]) < 0.05 * size
        assert len(value) > 2
        assert sides[axis, 0] - 0.05 * size < value[0] < value[-1] < sides[axis, 1] + 0.05 * size


@needs_opengl
def test_words_and_tubes_of_sliders_keep_apart(harmonic_map):
    """Heights are shares of the window's height: the title above the tube and the number below it fit within the
    distance to the next slider, and are legible."""
    field_map = harmonic_map(left=(0.0, 0.04, 1.0, (0.0, 0.0)), right=(0.0, 0.02, 0.5, (0.0, 0.0)))
    payload = fieldmap.read_device("drive_unit").payload
    window = live_window.LiveWindow(field_map, payload, 5.0, off_screen=True, window=(420, 300))
    shapes = [slider.GetRepresentation() for slider in window.sliders]
    window.scene.close()
    ends = [
        (one.GetPoint1Coordinate().GetValue()[:2], one.GetPoint2Coordinate().GetValue()[:2]) for one in shapes
    ]
    heights = [left[1] for left, _ in ends]
    assert len(shapes) == 3
    for one, (left, right) in zip(shapes, ends, strict=True):
        words = one.GetTitleHeight(), one.GetLabelHeight()
        assert all(0.01 < height < 0.03 for height in words)
        assert sum(words) + one.GetTubeWidth() + one.GetSliderWidth() < -np.diff(heights).max()
        assert left[1] == right[1]
        assert 0.5 < left[0] < right[0] < 1.0
        assert 0.0 < left[1] < 1.0
