"""`check_map` and `fieldmap check MAP`: a sound map passes, and all faults are named at once."""

import json
from dataclasses import replace
from math import prod

import h5py
import numpy as np
import pytest

from fieldmap.cli import main
from fieldmap.errors import MapFileError
from fieldmap.store import FieldError, Grid, MapData, Provenance, check_map, seal_map, write_map
from tests.store.conftest import make_saturating

BX = "/data/0/meshes/B_upper/x"


def harmonic_map(shape=(4, 5, 3), **changes):
    """B = grad of x^2 - y^2 + z^3 - 3 z x^2 and of x y z: polynomials that Simpson's rule integrates exactly."""
    grid = Grid([-0.01, 0.0, 0.02], [0.005, 0.004, 0.003], shape)
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
        "flux_density": flux.reshape(2, *shape, 3),
        "gradient": slope.reshape(2, *shape, 3, 3),
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


TRIED = {"flux_density_share": 0.03, "gradient_share": 0.01, "states": 4}
BOUND = {"harmonic": FieldError(1e-9, 1e-7)}


@pytest.mark.parametrize(
    ("changes", "about", "word"),
    [
        ({}, {}, ""),
        ({}, {"fingerprint": ""}, "fingerprint"),
        ({}, {"versions": {}}, "versions"),
        ({}, {"recipe_text": ""}, "recipe"),
        ({}, {"device_text": ""}, "device file"),
        ({"interpolation_error": None}, {}, "error stated"),
        ({"interpolation_error": None, "error_bounds": BOUND}, {}, ""),
        ({"error_bounds": BOUND}, {}, ""),
        ({}, {"solver_report": {"held_out_within": 0.02, "states_tried": {"a": TRIED}}}, "off by up to 3 %"),
        ({}, {"solver_report": {"held_out_within": 0.03, "states_tried": {"a": TRIED}}}, ""),
    ],
)
def test_what_is_missing_but_allowed_is_noted(tmp_path, changes, about, word):
    data = harmonic_map(**changes)
    path = write_map(tmp_path / "map.h5", replace(data, provenance=replace(data.provenance, **about)))
    notes = check_map(path).notes
    assert len(notes) == bool(word)
    assert word in " ".join(notes)


def relative(values):
    return np.abs(values).max()


@pytest.mark.parametrize("shape", [(4, 5, 3), (2, 2, 3), (3, 2, 2), (2, 4, 2), (3, 3, 2)])
def test_the_deviations_are_the_largest_and_relative(tmp_path, shape):
    """One deviation in a node of one field, a smaller one in the other field, relative to each field's largest value.
    For cubic polynomials a difference of B over two cells equals the integral to the last bit."""
    data = harmonic_map(shape)
    flux, slope = data.flux_density.copy(), data.gradient.copy()
    largest = relative(slope[0]), relative(slope[1])
    steps = []
    for field in data.flux_density:
        parts = [np.moveaxis(field, k, 0) for k in range(3) if shape[k] >= 3]
        steps.append(max(relative(part[2:] - part[:-2]) for part in parts))
    # The deviations of the smaller field stay below those of the larger one.
    slope[0, 1, 1, 1, 1, 1] += 3e-5 * largest[0]
    slope[1, 0, 1, 0, 2, 2] -= 7e-5 * largest[1]
    slope[0, 0, 0, 1, 0, 1] += 9e-5 * largest[0]
    slope[1, 1, 0, 0, 2, 1] += 2e-5 * largest[1]
    flux[0, -1, -1, -1, 2] += 0.02 * steps[0]
    flux[1, -1, -1, -1, 0] += 0.04 * steps[1]
    path = write_map(tmp_path / "map.h5", replace(data, flux_density=flux, gradient=slope))
    total = 2.0 * flux[0] + 0.5 * flux[1]
    with h5py.File(path, "r+") as file:
        file["/data/0/meshes/B/y"][1, 1, 1] += 4e-10 * relative(total)
        file["/data/0/meshes/B/z"][0, 1, 0] -= 8e-10 * relative(total)
    seal_map(path)
    found = check_map(path)
    assert found.divergence == pytest.approx(7e-5, rel=1e-3)
    assert found.curl == pytest.approx(9e-5, rel=1e-3)
    assert found.values_and_gradients == pytest.approx(0.04, rel=2e-3)
    assert found.total == pytest.approx(8e-10, rel=1e-4)
    told = found.to_dict()
    names = ("divergence", "curl", "values_and_gradients", "total", "bytes", "data_sets")
    assert [told[name] for name in names] == [getattr(found, name) for name in names]
    assert (told["title"], told["device"], told["fingerprint"], told["created"]) == (
        "harmonic",
        "rig",
        "abc",
        "now",
    )
    assert told["grid"] == {"lower": [-0.01, 0.0, 0.02], "spacing": [0.005, 0.004, 0.003], "shape": [*shape]}
    assert told["interpolation_error"] == {"flux_density": 1e-9, "gradient": 1e-7}


def test_a_grid_of_two_nodes_has_no_steps_over_two_cells(tmp_path):
    assert check_map(write_map(tmp_path / "map.h5", harmonic_map((2, 2, 2)))).values_and_gradients is None


LIMITS = {
    "divergence": (1e-4, "field of 'lower'"),
    "curl": (1e-4, "field of 'lower'"),
    "values against gradients": (0.05, "field of 'lower'"),
    "total against sum": (1e-9, "total field"),
}


@pytest.mark.parametrize("share", [0.97, 1.03])
@pytest.mark.parametrize("what", LIMITS)
def test_limits(tmp_path, what, share):
    """The limits on the page of map files: 1e-4, 1e-4, 5 % and 1e-9."""
    data = harmonic_map((2, 2, 3))
    flux, slope = data.flux_density.copy(), data.gradient.copy()
    if what in ("divergence", "curl"):
        slope[1, 0, 0, 0, 2, 2 if what == "divergence" else 0] += share * 1e-4 * relative(slope[1])
    if what == "values against gradients":
        flux[1, 0, 0, 2, 1] += share * 0.05 * relative(flux[1][:, :, 2] - flux[1][:, :, 0])
    path = write_map(tmp_path / "map.h5", replace(data, flux_density=flux, gradient=slope))
    if what == "total against sum":
        with h5py.File(path, "r+") as file:
            file["/data/0/meshes/B/x"][0, 0, 0] += share * 1e-9 * relative(2.0 * flux[0] + 0.5 * flux[1])
        seal_map(path)
    if share < 1.0:
        check_map(path)
        return
    with pytest.raises(MapFileError) as caught:
        check_map(path)
    (problem,) = caught.value.problems
    limit, of = LIMITS[what]
    assert of in problem.must_hold
    assert problem.must_hold.endswith(f": {what} up to {limit:g} of the largest")
    assert float(problem.received) == pytest.approx(share * limit, rel=2e-3)


def test_a_deviation_of_the_limit_itself_is_allowed(tmp_path):
    """The largest gradient is 1 T/m and the trace 1e-4 T/m, both to the last bit."""
    slope = np.zeros((1, 2, 2, 2, 3, 3))
    slope[..., 0, 1] = slope[..., 1, 0] = 1.0
    slope[..., 0, 0] = 1e-4
    grid = Grid([0, 0, 0], [1, 1, 1], (2, 2, 2))
    data = MapData(grid, ("a",), [1.0], flux_density=np.zeros((1, 2, 2, 2, 3)), gradient=slope)
    assert check_map(write_map(tmp_path / "map.h5", data)).divergence == 1e-4


def test_without_a_field_deviations_are_absolute(tmp_path):
    """There is no largest value for a relative deviation."""
    nothing = harmonic_map(flux_density=np.zeros((2, 4, 5, 3, 3)), gradient=np.zeros((2, 4, 5, 3, 3, 3)))
    path = write_map(tmp_path / "map.h5", nothing)
    found = check_map(path)
    assert (found.divergence, found.curl, found.values_and_gradients, found.total) == (0.0, 0.0, 0.0, 0.0)

    def change(file):
        file["/data/0/meshes/B_upper/y"][0, 0, 0] = 0.25
        file["/data/0/meshes/B_lower/y"][0, 0, 0] = -0.25
        file["/data/0/meshes/B/x"][0, 0, 0] = 0.5

    caught = problems_after(path, change, told=True)
    assert [problem.received for problem in caught] == ["0.25", "0.25", "0.5"]


def test_the_weights_of_the_total(tmp_path):
    """Random numbers are no magnetic field, but their total is right."""
    path = write_map(tmp_path / "map.h5", make_saturating())
    with pytest.raises(MapFileError) as caught:
        check_map(path)
    told = [problem.must_hold for problem in caught.value.problems]
    assert len(told) == 8 * 3
    assert not any("total" in text for text in told)


@pytest.mark.parametrize(
    ("flags", "received"),
    [
        ([1, 1], "2 of 2"),
        ([1, 1, 1, 1], "4 of 4"),
        ([[1, 1, 1]], "3 of 3"),
        ([1, 0, 1], "2 of 3"),
        ([1, 2, 1], "3 of 3"),
    ],
)
def test_every_part_is_flagged_once(tmp_path, flags, received):
    """2500 nodes in x-planes of 500: three parts of at most two planes."""
    shape = (5, 20, 25)
    path = write_map(tmp_path / "map.h5", harmonic_map(shape))
    assert check_map(path).info.grid.size == prod(shape)

    def change(file):
        del file["/fieldmap/completion/chunks"]
        file["/fieldmap/completion/chunks"] = np.array(flags, np.uint8)

    (problem,) = problems_after(path, change, told=True)
    assert (problem.must_hold, problem.received) == ("every part flagged as written", received)


def test_what_cannot_be_read_is_named_in_one_line(path):
    """A wrong byte in a chunk with a checksum; the other data sets are still checked."""
    with h5py.File(path) as file:
        place = file["/data/0/meshes/gradB_upper/yz"].id.get_chunk_info(0).byte_offset
    raw = bytearray(path.read_bytes())
    raw[place + 5] ^= 1
    path.write_bytes(raw)
    (problem,) = problems_after(path, lambda file: None, told=True)
    assert problem.must_hold == "/data/0/meshes/gradB_upper/yz: undamaged"
    assert problem.received.startswith("what cannot be read (OSError: ")
    assert "\n" not in problem.received


def problems_after(path, change, told=False):
    """`must_hold` of each problem after a change; told: the problems themselves."""
    with h5py.File(path, "r+") as file:
        change(file)
    seal_map(path)
    with pytest.raises(MapFileError) as caught:
        check_map(path)
    assert all(problem.where == str(path) and problem.remedy for problem in caught.value.problems)
    return caught.value.problems if told else [problem.must_hold for problem in caught.value.problems]


def scale(path, factor):
    def change(file):
        file[path][...] = factor * file[path][()]

    return change


def attribute(path, name, value):
    def change(file):
        file[path].attrs[name] = value

    return change


def relink(number, link):
    def change(file):
        del file[f"/ExternalFieldPath/{number}/magneticField"]
        file[f"/ExternalFieldPath/{number}/magneticField"] = link or file["/data/0/meshes/B_upper"]

    return change


def exchange(file):
    """Exchange the components x and y of B."""
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
        (relink(2, h5py.SoftLink("/data/0/meshes/B_upper")), "a soft link to /data/0/meshes/B_lower"),
        (relink(1, h5py.SoftLink("/data/0/meshes/B_lower")), "a soft link to /data/0/meshes/B_upper"),
        (
            relink(1, h5py.ExternalLink("other.h5", "/data/0/meshes/B_upper")),
            "a soft link to /data/0/meshes/B_up",
        ),
        (relink(1, None), "a soft link to /data/0/meshes/B_upper"),
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


def test_a_header_that_claims_a_giant_grid_costs_nothing(path, monkeypatch):
    from fieldmap.store import map_check
    from fieldmap.store.map_format import write_text

    values, asked = map_check._values, []
    monkeypatch.setattr(map_check, "_values", lambda *of: (asked.append(of), values(*of))[1])

    def change(file):
        header = json.loads(file["/fieldmap/header"][()])
        write_text(file, "header", json.dumps(header | {"shape": [10**12, 2, 2]}))

    found = " | ".join(problems_after(path, change))
    assert "flagged" in found
    assert "B_lower/z: float64 " in found
    # Once per quantity, not once for each of 2e6 pieces.
    assert len(asked) < 10
