"""From a name to a field: recognition, reading, and the time of the solve."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.device import read_device
from fieldmap.errors import InputError, MapFileError
from fieldmap.io import IronOptions, is_map_file, open_field
from fieldmap.io.field_source import existing_map, find_source, named_device, solve_device
from tests.refusals import refused

DEVICES = Path(__file__).parents[1] / "devices"
LOOP = DEVICES / "thin_loop_with_driver.toml"
BALL = DEVICES / "sphere_below_loop.toml"


def test_a_map_is_known_by_its_ending_or_by_its_first_bytes(tmp_path, six_coils):
    assert is_map_file("none.h5")
    assert is_map_file("none.HDF5")
    assert not is_map_file(LOOP)
    assert not is_map_file("drive_unit")
    renamed = tmp_path / "field.map"
    renamed.write_bytes(six_coils.read_bytes())
    assert is_map_file(renamed)
    (tmp_path / "short").write_bytes(b"\x89HDF")
    assert not is_map_file(tmp_path / "short")
    for content in (b"", b"\x00HDF\r\n\x1a\n", b"\xffHDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\r and more"):
        (tmp_path / "other").write_bytes(content)
        assert not is_map_file(tmp_path / "other")
    for name in ("x" * 5000, "no\0name", tmp_path / "none"):
        assert not is_map_file(name)
    with refused(InputError, where=str(tmp_path), received="a directory"):
        is_map_file(tmp_path)


def test_a_folder_does_not_hide_a_shipped_device_or_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("drive_unit", "sample", "mine"):
        (tmp_path / name).mkdir()
    assert (is_map_file("drive_unit"), is_map_file("sample")) == (False, True)
    assert existing_map("sample").name == "sample.h5"
    for name in ("mine", "./sample", "./drive_unit"):
        with refused(InputError, where=name, received="a directory"):
            is_map_file(name)


def test_an_existing_map_is_a_file_of_hdf5(tmp_path, six_coils):
    assert existing_map(str(six_coils)) == six_coils
    told = {
        tmp_path / "none.h5": "no such file",
        tmp_path / "none": "no such file",
        LOOP: "a file that is not HDF5",
    }
    for name, received in told.items():
        with refused(MapFileError, where=str(name), received=received):
            existing_map(name)


def test_a_map_is_no_device(six_coils):
    with pytest.raises(InputError) as error:
        named_device(six_coils)
    assert error.value.problems[0].received == "a map"
    assert named_device("drive_unit").name == "drive_unit"
    assert named_device(LOOP, {"payload.mass_g": 20.0}).payload.mass == 0.020
    with refused(InputError, where=str(six_coils), received="a map"):
        find_source(six_coils, changes={"payload.mass_g": 20.0})
    assert find_source(six_coils, changes={}).is_map


def test_a_map_that_recorded_no_device_has_no_payload(six_coils):
    source = find_source(six_coils)
    assert (source.payload, source.driver, source.device, source.kind) == (None, None, None, "map")


def test_a_map_brings_what_it_recorded(circle_of_six, dipole_map, tmp_path):
    path = dipole_map(circle_of_six, tmp_path / "six.h5", LOOP.read_text(), device_name="six dipoles")
    source = find_source(path)
    assert (source.name, source.device_name, source.is_map) == ("six.h5", "six dipoles", True)
    assert not source.nonlinear
    np.testing.assert_allclose(source.bounds, [[-0.02, -0.02, -0.14], [0.02, 0.02, -0.076]])
    assert (source.payload.mass, source.driver.current_limit) == (0.010, 3.0)
    # Six dipoles m of 8 A m^2/A, h above the point and 44 mm off the axis: each mu0 m (2 h^2 - a^2) / 4 pi r^5.
    h, a = 0.026 + 0.1, 0.044
    exact = 6 * 2e-7 * 8 * (h**2 - a**2 / 2) / (h**2 + a**2) ** 2.5
    assert source.field.at(1.0).field([0, 0, -0.1])[2] == pytest.approx(exact, rel=2e-4)
    np.testing.assert_array_equal(source.currents(2.0), np.full(6, 2.0))
    with pytest.raises(InputError):
        source.currents([1.0, 2.0])


def test_a_device_is_solved_when_its_field_is_asked_for_and_once(monkeypatch):
    calls = []
    monkeypatch.setattr(
        "fieldmap.iron.solve_linear", lambda device, **options: calls.append(options) or "solved"
    )
    source = find_source(LOOP, IronOptions(mu_r=30.0, refinement=0.5, form="flux"))
    assert not calls
    assert (source.name, source.is_map, source.nonlinear) == ("thin_loop", False, False)
    np.testing.assert_allclose(source.bounds, [[-0.012, -0.012, -0.124], [0.012, 0.012, -0.04]])
    assert source.payload.moment == 0.8
    assert (source.field, source.field) == ("solved", "solved")
    (options,) = calls
    assert {key: options[key] for key in ("mu_r", "refinement", "form")} == {
        "mu_r": 30.0,
        "refinement": 0.5,
        "form": "flux",
    }


def test_a_device_in_python_a_file_and_a_field_are_opened(monkeypatch, polynomial):
    """With the given options and changes; the default is linear iron."""
    asked = []
    monkeypatch.setattr(
        "fieldmap.io.field_source.solve_device", lambda *given: asked.append(given) or "solved"
    )
    device, options = read_device(LOOP), IronOptions(mu_r=30.0)
    assert open_field(device, options, print) == open_field(device) == "solved"
    assert asked == [(device, options, print), (device, IronOptions(), None)]
    assert open_field(LOOP, options, print, {"payload.mass_g": 20.0}) == "solved"
    assert (asked[-1][0].payload.mass, *asked[-1][1:]) == (0.020, options, print)
    assert open_field(str(LOOP)) == "solved"
    assert asked[-1][1:] == (IronOptions(), None)
    field = polynomial.field
    assert open_field(field) is field


def test_what_a_field_rests_on(polynomial, monkeypatch):
    """At given currents a device also has assumptions about its iron."""
    monkeypatch.setattr(
        "fieldmap.iron.notes.state_notes", lambda device, state: (device, state.currents.tolist())
    )
    source = polynomial.source()
    assert source.assumptions() == source.assumptions([1.0, 2.0]) == ("a polynomial",)
    made = polynomial.source(device="a device")
    assert (source.is_map, made.is_map) == (True, False)
    assert made.assumptions() == ("a polynomial",)
    assert made.assumptions([1.0, 2.0]) == ("a device", [1.0, 2.0])


@pytest.mark.parametrize("given", [True, False])
def test_progress_until_the_first_state(monkeypatch, given):
    """The message "assembled" does not end the progress; all others are passed on."""
    told, made = [], []

    def solver(device, refinement, progress):
        made.append(progress)
        for message in ("meshed", "assembled", "aaa", "zzz"):
            if progress is not None:
                progress(message, 0.5)

    monkeypatch.setattr("fieldmap.iron.NonlinearSolver", solver)
    solve_device("d", IronOptions(nonlinear=True), (lambda *what: told.append(what)) if given else None)
    assert told == [(message, 0.5) for message in ("meshed", "aaa", "zzz") if given]
    assert (made[0] is None) == (not given)


@pytest.mark.parametrize(
    ("options", "solver", "given"),
    [
        (IronOptions(), "solve_linear", {"mu_r": None, "refinement": 1.0, "form": "auto"}),
        (IronOptions(tolerance=0.1, mu_r=5.0), "solve_to_tolerance", {"mu_r": 5.0}),
        (IronOptions(nonlinear=True, refinement=0.5), "NonlinearSolver", {}),
    ],
)
def test_the_options_choose_the_solver(monkeypatch, options, solver, given):
    calls = []
    for name in ("solve_linear", "solve_to_tolerance", "NonlinearSolver"):
        monkeypatch.setattr(
            f"fieldmap.iron.{name}", lambda *args, _name=name, **named: calls.append((_name, args, named))
        )
    device = SimpleNamespace(name="d")
    solve_device(device, options)
    ((name, args, named),) = calls
    assert name == solver
    assert args[0] is device
    assert given.items() <= named.items()
    if solver == "solve_to_tolerance":
        assert args[1] == 0.1
    if solver == "NonlinearSolver":
        assert args[1] == 0.5


def test_states_are_only_solved_of_iron_that_can_be_followed():
    source = find_source(BALL, IronOptions(nonlinear=True))
    assert (source.nonlinear, source.kind) == (True, "device, nonlinear iron")
    source = find_source(BALL)
    assert (source.nonlinear, source.kind) == (False, "device, linear iron")
    with pytest.raises(InputError):
        find_source(LOOP, IronOptions(nonlinear=True))


def test_the_field_of_a_coil_by_the_name_of_its_file():
    """A thin loop of 1000 turns and 44 mm: mu0 N a^2 / 2 (a^2 + z^2)^1.5 on its axis."""
    found = open_field(LOOP).at(1.0).field([0.0, 0.0, -0.09])[2]
    assert found == pytest.approx(mu_0 * 1000 * 0.044**2 / 2 / (0.044**2 + 0.09**2) ** 1.5, rel=1e-4)
