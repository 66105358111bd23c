"""The shipped devices against the thesis: its tables, and the commands of Appendix A-3 (appendix_a3.txt)."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from fieldmap.device import model, read_device
from fieldmap.device.schema import DEVICE
from fieldmap.inputs.key_paths import matches
from fieldmap.shipped import shipped_file, shipped_folder, shipped_names

COMMANDS = (Path(__file__).parent / "appendix_a3.txt").read_text().splitlines()
UNITS = ["drive_unit", "drive_unit_a3", "drive_unit_no_centre_core", "disk_six_cores", "disk_six_cores_plate"]
WITH_YOKE = [("drive_unit_a3", 0.12), ("drive_unit", 0.283), ("drive_unit_no_centre_core", 0.283)]
CORES = [f"core {k}" for k in range(1, 7)]
# Coil names (thesis Fig. 6-4) in the order of A-3's C1..C6, which begin at 0 deg and go round by 60 deg.
NAMES_BY_ANGLE = ["5", "6", "3", "2", "1", "4"]


def arguments(command: str) -> list[list[str]]:
    lines = [line.split(",") for line in COMMANDS]
    return [[word.strip() for word in line[1:]] for line in lines if line[0] == command]


def settings(gap: float) -> dict[str, float]:
    return {name: float(value) for name, value in arguments("*SET")} | {"GAP": gap}


def number(text: str, gap: float = 0.12) -> float:
    return float(eval(text, {"__builtins__": {}}, settings(gap)))


def body(device: model.Device, name: str) -> model.Body:
    return next(body for body in device.bodies if body.name == name)


def extent(part: model.Part) -> np.ndarray:
    """(3, 2) lower and upper coordinate of an unturned cylinder or box."""
    assert np.array_equal(part.placement.rotation, np.eye(3))
    if isinstance(part.shape, model.Box):
        half, height = np.array(part.shape.size[:2]) / 2, part.shape.size[2]
    else:
        half, height = np.full(2, part.shape.radius), part.shape.height
    x, y, z = part.placement.position
    return np.array([[x - half[0], x + half[0]], [y - half[1], y + half[1]], [z, z + height]])


@pytest.mark.parametrize("name", [name for name in shipped_names("geometry") if name[:6] != "planar"])
def test_every_shipped_device_is_read_under_its_own_name(name):
    assert read_device(name).name == name


@pytest.mark.parametrize(("name", "gap"), WITH_YOKE)
def test_yoke_is_the_blocks_of_a3(name, gap):
    parts = body(read_device(name), "yoke").parts
    blocks = arguments("BLOCK")
    assert len(parts) == len(blocks) == 5
    for part, block in zip(parts, blocks, strict=True):
        corners = np.array([number(text, gap) for text in block[:6]]).reshape(3, 2)
        np.testing.assert_allclose(extent(part), np.sort(corners, axis=1), atol=1e-12)


@pytest.mark.parametrize(("name", "gap"), WITH_YOKE)
def test_the_gap_is_between_disk_and_lower_plate(name, gap):
    device = read_device(name)
    disk, upper, lower = (extent(body(device, k).parts[0]) for k in ("disk", "upper plate", "lower plate"))
    assert disk[2, 0] - lower[2, 1] == pytest.approx(gap, abs=1e-12)
    np.testing.assert_allclose(upper[2], [0.046, 0.052], atol=1e-12)  # VGEN by 0.006 + L
    for plate in (disk, upper, lower):
        np.testing.assert_allclose(plate[:2], [[-0.066, 0.066]] * 2, atol=1e-12)  # CYL4,0,0,0.066
        assert plate[2, 1] - plate[2, 0] == pytest.approx(0.006, abs=1e-12)


@pytest.mark.parametrize("name", UNITS)
def test_cores_and_coils_stand_where_a3_puts_them(name):
    device = read_device(name)
    assert device.coil_names == ("1", "2", "3", "4", "5", "6")
    for k, coil_name in enumerate(NAMES_BY_ANGLE):
        x, y, radius, *_, height = arguments("CYL4")[k]
        core = extent(body(device, f"core {coil_name}").parts[0])
        centre, r = np.array([number(x), number(y)]), number(radius)
        np.testing.assert_allclose(core[:2], centre[:, None] + [-r, r], atol=1e-12)
        np.testing.assert_allclose(core[2], [0.006, 0.006 + number(height)], atol=1e-12)
        coil = device.coils[int(coil_name) - 1]
        place = [number(text) for text in arguments("LOCAL")[k][2:5]]
        np.testing.assert_allclose(coil.placement.position, place, atol=1e-12)
        assert np.array_equal(coil.placement.rotation, np.eye(3))
        race = [number(arguments("RACE")[k][j]) for j in (0, 1, 2, 4, 5)]
        sizes = [coil.half_width_x, coil.half_width_y, coil.corner_radius, coil.thickness, coil.height]
        np.testing.assert_allclose(sizes, race, atol=1e-12)
        assert coil.polarity == 1


def test_which_bodies_each_variant_has():
    disk_and_cores = {"disk", *CORES}
    yoke = {"upper plate", "yoke", "lower plate"}
    expected = {
        "drive_unit": disk_and_cores | yoke | {"centre core"},
        "drive_unit_a3": disk_and_cores | yoke | {"centre core"},
        "drive_unit_no_centre_core": disk_and_cores | yoke,
        "disk_six_cores": disk_and_cores,
        "disk_six_cores_plate": disk_and_cores | {"upper plate"},
    }
    for name, bodies in expected.items():
        assert {body.name for body in read_device(name).bodies} == bodies


def test_turns_resistance_and_inductance():
    assert {coil.turns for coil in read_device("drive_unit_a3").coils} == {1350}
    coils = read_device("drive_unit").coils
    assert {coil.turns for coil in coils} == {840}
    assert [coil.resistance for coil in coils] == [4.27, 4.23, 4.25, 4.25, 4.29, 4.25]  # Table 3-1
    inductances = [29.68e-3, 28.84e-3, 29.08e-3, 28.77e-3, 27.65e-3, 29.64e-3]
    np.testing.assert_allclose([coil.inductance for coil in coils], inductances, rtol=1e-14)


def test_steel_is_the_table_of_a3():
    points = np.array([[float(h), float(b)] for _, h, b in arguments("TBPT")])
    assert points.shape == (30, 2)
    steel = read_device("drive_unit").materials["steel"]
    assert np.array_equal(steel.h, points[:, 0])
    assert np.array_equal(steel.b, points[:, 1])
    assert steel.initial_mu_r == pytest.approx(1569.1, abs=0.1)  # 0.70 T / (mu0 355 A/m)


def test_payload_and_driver_of_the_unit():
    device = read_device("drive_unit")
    assert round(device.payload.moment, 3) == 0.813 or device.payload.moment == pytest.approx(
        0.8125, abs=1e-6
    )
    assert device.payload.mass == pytest.approx(11.19e-3)
    assert device.driver.gain * 10 == pytest.approx(
        device.driver.current_limit
    )  # 10 V at the input, section 3.7


def test_sphere_of_the_single_electromagnet():
    payload = read_device("single_electromagnet").payload
    volume = np.pi / 6 * payload.magnet.diameter**3
    assert f"{volume:.3g}" == "5.24e-10"  # Table 2-2
    assert f"{payload.moment:.3g}" == "0.000542"
    assert payload.mass == pytest.approx(7400 * volume, rel=2e-3)  # 3.87e-6 kg as printed
    assert payload.inertia[0] == pytest.approx(
        0.4 * payload.mass * (payload.magnet.diameter / 2) ** 2, rel=1e-3
    )


def test_winding_of_the_single_electromagnet_holds_both_wires_of_table_2_1():
    (coil,) = read_device("single_electromagnet").coils
    section = (coil.outer_radius - coil.inner_radius) * coil.height
    assert section == pytest.approx(5 * 0.018**2, rel=1e-12)
    assert section == pytest.approx(500 * 0.0018**2, rel=1e-12)


def test_references_of_a3_have_840_ampere_turns_in_the_coil_at_0_deg():
    device = read_device("drive_unit_a3")
    assert len(device.references) == 8
    for reference in device.references:
        ampere_turns = [coil.turns * i for coil, i in zip(device.coils, reference.currents, strict=True)]
        np.testing.assert_allclose(ampere_turns, [0, 0, 0, 0, 840, 0], rtol=1e-14)
        assert reference.mu_r == 4000
    assert device.coils[4].placement.position[0] == pytest.approx(0.044)


@pytest.mark.parametrize("name", shipped_names("geometry"))
def test_every_number_says_where_it_comes_from(name):
    path = shipped_file("geometry", name)
    data = tomllib.loads(path.read_text()) if name.startswith("planar") else DEVICE.load(path).data
    sourced = {location for pattern in data["provenance"] for location in matches(data, pattern)}
    assert [location for location in number_locations(data) if location not in sourced] == []


def number_locations(data: dict) -> list[tuple]:
    """Locations of the keys that hold a number or an array of numbers, other than the format's version."""
    found, waiting = [], [((), data)]
    while waiting:
        location, here = waiting.pop()
        if isinstance(here, dict):
            waiting += [((*location, key), value) for key, value in here.items()]
        elif isinstance(here, list) and here and isinstance(here[0], dict):
            waiting += [((*location, k), value) for k, value in enumerate(here)]
        elif location[-1] == "between":
            # The entries are names of bodies.
            continue
        elif isinstance(here, int | float | list):
            found.append(location)
    return [location for location in found if location != ("format",)]


def test_shipped_names_and_places():
    assert {*UNITS, "single_electromagnet", "loop_and_sphere"} <= set(shipped_names("geometry"))
    materials = ["materials/cobalt_iron", "materials/steel_a3", "materials/steel_foot"]
    assert shipped_names("geometry", "materials") == materials
    assert shipped_file("geometry", "drive_unit") == shipped_folder("geometry") / "drive_unit.toml"
    by_path = read_device(shipped_file("geometry", "drive_unit"))
    assert by_path.text == read_device("drive_unit").text == read_device("drive_unit.toml").text
    assert shipped_file("geometry", "no such device") is None
    assert shipped_file("geometry", "../pyproject") is None
    with pytest.raises(ValueError, match="geometry, maps"):
        shipped_folder("shapes")
