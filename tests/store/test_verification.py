"""`check_map` and `fieldmap check MAP`: a sound map passes, and everything that is wrong is named, all at once."""

import json

import h5py
import numpy as np
import pytest

from fieldmap.cli import main
from fieldmap.errors import MapFileError
from fieldmap.store import FieldError, Grid, MapData, Provenance, check_map, seal_map, write_map

BX = "/data/0/meshes/B_upper/x"


def harmonic_map(**changes):
    """B = grad of x^2 - y^2 + z^3 - 3 z x^2 and of x y z: polynomials that Simpson's rule integrates exactly."""
    grid = Grid([-0.01, 0.0, 0.02], [0.005, 0.004, 0.003], (4, 5, 3))
    x, y, z = grid.points().T
    zero = 0 * x
    flux = np.stack(
        [
            np.stack([2 * x - 6 * z * x, -2 * y, 3 * z**2 - 3 * x**2], axis=1),
            np.stack([y * z, x * z, x * y], axis=1),
        ]
    )
    rows = [
        [[2 - 6 * z, zero, -6 * x], [zero, zero - 2, zero], [-6 * x, zero, 6 * z]],
        [[zero, z, y], [z, zero, x], [y, x, zero]],
    ]
    slope = np.moveaxis(np.array(rows), -1, 1)
    given = {
        "grid": grid,
        "coil_names": ("upper", "lower"),
        "reference_current": np.array([2.0, 0.5]),
        "provenance": Provenance(
            "harmonic", "rig", "spacing_mm = 4\n", "[rig]\n", "abc", {"fieldmap": "0"}, created="now"
        ),
        "interpolation_error": FieldError(1e-9, 1e-7),
        "flux_density": flux.reshape(2, 4, 5, 3, 3),
        "gradient": slope.reshape(2, 4, 5, 3, 3, 3),
    }
    return MapData(**(given | changes))


@pytest.fixture
def path(tmp_path):
    return write_map(tmp_path / "map.h5", harmonic_map())


def test_a_sound_map(path):
    check = check_map(path)
    assert check.info.coil_names == ("upper", "lower")
    assert check.data_sets == 3 + 2 * 12
    assert check.bytes == path.stat().st_size
    for figure in (check.divergence, check.curl, check.values_and_gradients, check.total):
        assert figure < 1e-12
    assert check.notes == ()


def test_what_is_missing_but_allowed_is_noted(tmp_path):
    path = write_map(tmp_path / "map.h5", harmonic_map(provenance=Provenance(), interpolation_error=None))
    notes = " ".join(check_map(path).notes)
    assert all(word in notes for word in ("fingerprint", "versions", "recipe", "device", "error"))


def problems_after(path, change):
    with h5py.File(path, "r+") as file:
        change(file)
    seal_map(path)
    with pytest.raises(MapFileError) as caught:
        check_map(path)
    assert all(problem.where == str(path) and problem.remedy for problem in caught.value.problems)
    return [problem.must_hold for problem in caught.value.problems]


def scale(path, factor):
    def change(file):
        file[path][...] = factor * file[path][()]

    return change


def attribute(path, name, value):
    def change(file):
        file[path].attrs[name] = value

    return change


def relink(file):
    del file["/ExternalFieldPath/2/magneticField"]
    file["/ExternalFieldPath/2/magneticField"] = h5py.SoftLink("/data/0/meshes/B_upper")


def exchange(file):
    """Components x and y of B in each other's place."""
    x, y = (file[f"/data/0/meshes/B_upper/{c}"] for c in "xy")
    x[...], y[...] = y[()], x[()]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (scale("/data/0/meshes/gradB_upper/xx", 2.0), "divergence up to"),
        (scale("/data/0/meshes/gradB_upper/xz", 2.0), "curl up to"),
        (scale(BX, 1e3), "values against gradients up to"),
        (exchange, "values against gradients up to"),
        (scale("/data/0/meshes/B/x", 1.001), "total against sum up to"),
        (attribute(BX, "unitSI", 1e-3), f"{BX}, unitSI: 1"),
        (attribute(BX, "unitDimension", np.zeros(7)), f"{BX}, unitDimension"),
        (attribute("/data/0/meshes/B", "dataOrder", np.bytes_(b"F")), "B, dataOrder"),
        (attribute("/data/0/meshes/B", "gridUnitSI", 1e-3), "B, gridUnitSI"),
        (attribute("/data/0/meshes/gradB_lower", "axisLabels", np.array([b"z", b"y", b"x"])), "axisLabels"),
        (
            attribute("/data/0/meshes/gradB_lower", "gridGlobalOffset", np.zeros(3)),
            "gradB_lower, gridGlobalOffset",
        ),
        (attribute("/data/0/meshes/gradB_lower", "referenceCurrent", 3.0), "referenceCurrent: 0.5"),
        (attribute("/data/0/meshes/gradB_lower", "coilName", np.bytes_(b"upper")), "coilName: b'lower'"),
        (relink, "a soft link to /data/0/meshes/B_lower"),
    ],
)
def test_each_thing_that_is_wrong_is_named(path, change, words):
    found = problems_after(path, change)
    assert any(words in text for text in found), found


def test_all_at_once(path):
    def change(file):
        attribute(BX, "unitSI", 2.0)(file)
        scale("/data/0/meshes/gradB_lower/xy", 3.0)(file)
        del file["/data/0/meshes/B_lower/z"]
        file["/data/0/meshes/B/y"][0, 0, 0] = np.nan

    found = " | ".join(problems_after(path, change))
    for words in ("unitSI", "curl", "B_lower/z inside the file", "B/y: finite numbers"):
        assert words in found


def test_the_command(path, capsys):
    assert main(["check", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "27 data sets" in printed
    assert main(["check", str(path), "--json"]) == 0
    contents = json.loads(capsys.readouterr().out)
    assert contents["data_sets"] == 27
    assert contents["coil_names"] == ["upper", "lower"]
    assert contents["curl"] < 1e-12


def test_the_command_on_a_damaged_map(path, capsys):
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    assert main(["check", str(path)]) == 2
    assert "SHA-256" in capsys.readouterr().err
    assert main(["check", str(path.with_name("none.h5"))]) == 2
    assert "none.h5" in capsys.readouterr().err


def test_a_header_that_claims_a_giant_grid_costs_nothing(path):
    from fieldmap.store.map_format import write_text

    def change(file):
        header = json.loads(file["/fieldmap/header"][()])
        write_text(file, "header", json.dumps(header | {"shape": [10**12, 2, 2]}))

    found = " | ".join(problems_after(path, change))
    assert "flagged" in found
    assert "B_lower/z: float64 " in found
