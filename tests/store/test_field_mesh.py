"""Fields of other programs: every attribute has its own number, and other files are refused."""

import h5py
import numpy as np
import pytest

from fieldmap.errors import MapFileError
from fieldmap.store import field_mesh
from fieldmap.store.field_mesh import is_hdf5, read_field_mesh
from tests.refusals import refused

SHAPE = (2, 3, 4)
NUMBERS = np.arange(24.0).reshape(SHAPE)


def written(path, place="/ExternalFieldPath/1", root="/ExternalFieldPath/%T/", **changes):
    """An openPMD file: Bx as stored, By complex and in mT, Bz constant."""
    attributes = {
        "gridGeometry": np.bytes_(b"rectangular"),
        "axisLabels": np.array([b"x", b"y", b"z"]),
        "gridOriginOffset": [0.1, -0.2, 0.3],
        "gridSpacing": [0.01, 0.02, 0.05],
        "gridSize": SHAPE,
        "harmonic": 0,
        "fieldScale": 3.0,
    }
    with h5py.File(path, "w") as file:
        if root:
            file.attrs["externalFieldPath"] = root
        group = file.create_group(place)
        for name, value in (attributes | changes).items():
            if value is not None:
                group.attrs[name] = value
        group["magneticField/x"] = NUMBERS
        group["magneticField/y"] = 100 * NUMBERS + 7j
        group["magneticField/y"].attrs["unitSI"] = 1e-3
        constant = group.create_group("magneticField/z")
        constant.attrs.update(value=0.25, unitSI=2.0, shape=SHAPE)
    return path


@pytest.mark.parametrize(
    ("place", "root"),
    [
        ("/ExternalFieldPath/1", "/ExternalFieldPath/%T/"),
        ("/field/here", "/field/here"),
        ("/mesh", ""),
        ("/mesh", np.bytes_(b"/mesh")),
    ],
)
def test_points_and_field_in_si_units(tmp_path, place, root):
    points, flux = read_field_mesh(written(tmp_path / "mesh.h5", place, root))
    for n, (i, j, k) in enumerate(np.ndindex(SHAPE)):
        np.testing.assert_allclose(points[n], [0.1 + 0.01 * i, -0.2 + 0.02 * j, 0.3 + 0.05 * k], rtol=1e-14)
        np.testing.assert_allclose(flux[n], 3.0 * np.array([NUMBERS[i, j, k], 0.1 * NUMBERS[i, j, k], 0.5]))
    assert (points.shape, flux.shape, flux.dtype) == ((24, 3), (24, 3), np.float64)


def test_what_is_not_said_is_not_scaled(tmp_path):
    _, flux = read_field_mesh(written(tmp_path / "mesh.h5", fieldScale=None, harmonic=None))
    np.testing.assert_array_equal(flux[:, 0], NUMBERS.ravel())


@pytest.mark.parametrize(
    ("changes", "received"),
    [
        ({"gridGeometry": "cylindrical"}, "cylindrical geometry, axes ['x', 'y', 'z'], harmonic 0"),
        ({"gridGeometry": "spherical"}, "spherical geometry, axes ['x', 'y', 'z'], harmonic 0"),
        ({"gridGeometry": None}, "no geometry, axes ['x', 'y', 'z'], harmonic 0"),
        ({"harmonic": 1}, "rectangular geometry, axes ['x', 'y', 'z'], harmonic 1"),
        ({"harmonic": -1}, "rectangular geometry, axes ['x', 'y', 'z'], harmonic -1"),
        ({"axisLabels": None}, "rectangular geometry, axes [], harmonic 0"),
        ({"axisLabels": [b"x", b"y"]}, "rectangular geometry, axes ['x', 'y'], harmonic 0"),
        ({"axisLabels": [b"z", b"y", b"x"]}, "rectangular geometry, axes ['z', 'y', 'x'], harmonic 0"),
        ({"gridSize": (2, 3, 5)}, "a component of shape (2, 3, 4) on a grid of (2, 3, 5)"),
        ({"gridSize": (2, 3, 3)}, "a component of shape (2, 3, 4) on a grid of (2, 3, 3)"),
        ({"gridSpacing": [0.1, 0.2]}, "is shorter than argument 1"),
        ({"gridSize": (0, 3, 4)}, "[0, 3, 4]"),
        ({"gridSize": (-1, 3, 4)}, "[-1, 3, 4]"),
        ({"gridSize": (10**6, 10**6, 10**9)}, "[1000000, 1000000, 1000000000]"),
    ],
)
def test_other_fields_are_refused(tmp_path, changes, received):
    path = written(tmp_path / "mesh.h5", **changes)
    with refused(MapFileError, where=str(path), received=received):
        read_field_mesh(path)


def test_a_single_node(tmp_path):
    path = written(tmp_path / "mesh.h5", gridSize=(1, 1, 1))
    with h5py.File(path, "r+") as file:
        for name, value in (("x", [[[2.0]]]), ("y", [[[5.0]]])):
            del file["/ExternalFieldPath/1/magneticField"][name]
            file["/ExternalFieldPath/1/magneticField"][name] = value
    points, flux = read_field_mesh(path)
    np.testing.assert_array_equal(points, [[0.1, -0.2, 0.3]])
    np.testing.assert_array_equal(flux, [[6.0, 15.0, 1.5]])


@pytest.mark.parametrize(("most", "taken"), [(24, True), (23, False)])
def test_as_many_nodes_as_are_allowed(tmp_path, monkeypatch, most, taken):
    assert field_mesh.MOST_NODES == 5_000_000
    monkeypatch.setattr(field_mesh, "MOST_NODES", most)
    path = written(tmp_path / "mesh.h5")
    if taken:
        read_field_mesh(path)
    else:
        with refused(MapFileError, must_hold="at most 23 nodes"):
            read_field_mesh(path)


def test_one_field_in_an_undamaged_file(tmp_path):
    path = written(tmp_path / "mesh.h5")
    with h5py.File(path, "r+") as file:
        file.copy("/ExternalFieldPath/1", "/ExternalFieldPath/2")
    with refused(MapFileError, received="2 fields"):
        read_field_mesh(path)
    with h5py.File(path, "r+") as file:
        del file["/ExternalFieldPath/1"], file["/ExternalFieldPath/2"]
    with refused(MapFileError, received="0 fields"):
        read_field_mesh(path)
    missing = tmp_path / "none.h5"
    with refused(MapFileError, where=str(missing), must_hold="undamaged") as caught:
        read_field_mesh(missing)
    assert "no such file" in caught.value.problems[0].received.lower()


@pytest.mark.parametrize(
    ("content", "known"),
    [
        (b"\x89HDF\r\n\x1a\n more", True),
        (b"\x89HDF\r\n\x1a\n", True),
        (b"\x89HDF\r\n\x1a", False),
        (b"a text of words", False),
        (b"\xffHDF\r\n\x1a\n", False),
        (b"", False),
    ],
)
def test_hdf5_by_its_first_bytes(tmp_path, content, known):
    (tmp_path / "file").write_bytes(content)
    assert is_hdf5(tmp_path / "file") is known
    assert is_hdf5(tmp_path / "none") is False
