"""Payloads of several pieces, of magnets and of soft iron: files, Python, their mistakes, and inertia."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.reader import recorded_device
from fieldmap.errors import DeviceFileError, InputError
from tests.test_records import same

HEAD = """format = 1
name = "pair"
title = "A coil and a bead"

[[coil]]
name = "1"
kind = "circular"
inner_radius_mm = 20
outer_radius_mm = 30
height_mm = 10
turns = 100

[material.steel]
kind = "bh_table"
file = "materials/steel_a3.toml"
below = "straight line to the origin"
above = "slope mu0"

[payload]
mass_g = 0.3
"""
BEAD = HEAD + '[[payload.piece]]\nshape = "soft_sphere"\ndiameter_mm = 4\nmaterial = "steel"\n'
SEVERAL = (
    BEAD
    + """
[[payload.piece]]
shape = "soft_ellipsoid"
size_mm = [2, 2, 6]
mu_r = 500
position_mm = [0, 0, 6]

[[payload.piece]]
shape = "cylinder"
diameter_mm = 3
height_mm = 5
remanence_T = 1.2
position_mm = [0, 0, -6]
rotation_deg = [180, 0, 0]
"""
)


def test_pieces_of_a_file():
    payload = fm.read_device(SEVERAL).payload
    sphere, ellipsoid, magnet = (piece.shape for piece in payload.pieces)
    assert (sphere.diameter, sphere.mu_r, sphere.material.name) == (0.004, None, "steel")
    assert sphere.material.largest_polarisation == fm.material("steel_a3").largest_polarisation
    assert (ellipsoid.size, ellipsoid.mu_r) == ((0.002, 0.002, 0.006), 500.0)
    assert (magnet.diameter, magnet.height, magnet.remanence) == (0.003, 0.005, 1.2)
    assert payload.soft
    assert payload.moment == pytest.approx(magnet.volume * 1.2 / (4e-7 * np.pi), rel=1e-9)
    assert payload.pieces[2].placement.rotation[2, 2] == pytest.approx(-1.0)


@pytest.mark.parametrize("text", [BEAD, SEVERAL])
def test_a_file_and_its_text_are_the_same(text, tmp_path):
    device = fm.read_device(text)
    again = fm.read_device(device.to_toml())
    assert same(again.payload, device.payload)
    # In Python a piece has the name of a material, or the material itself, which the device then contains.
    steel = fm.material("steel_a3")
    named = fm.Payload(mass=3e-4, pieces=[fm.SoftSphere(4e-3, "steel")])
    assert device.replace(payload=named).payload.pieces[0].shape.material is device.materials["steel"]
    own = fm.Payload(mass=3e-4, pieces=[fm.SoftSphere(4e-3, steel)])
    other = fm.Device("own", "", coils=device.coils, payload=own)
    assert list(other.materials) == ["steel_a3"]
    assert same(fm.read_device(other.to_toml()).payload, own)
    # As a map records it.
    assert same(recorded_device(device.text).payload, device.payload)


@pytest.mark.parametrize(
    ("old", "new", "where", "received"),
    [
        ('material = "steel"', 'material = "stel"', "payload.piece.1.material", '"stel"'),
        ('material = "steel"', "", "payload.piece.1.mu_r", "neither"),
        ('material = "steel"', 'material = "steel"\nmu_r = 10', "payload.piece.1.mu_r", "both"),
        ('material = "steel"', "mu_r = 0.5", "payload.piece.1.mu_r", "0.5"),
        ("diameter_mm = 4", "diameter_mm = -4", "payload.piece.1.diameter_mm", "-4"),
        ('shape = "soft_sphere"', 'shape = "soft_cube"', "payload.piece.1.shape", '"soft_cube"'),
        ("diameter_mm = 4", "diameter_mm = 4\nremanence_T = 1.2", "payload.piece.1.remanence_T", None),
        ("mass_g = 0.3", "mass_g = 0.3\nmoment_A_m2 = 0.1", "payload.moment_A_m2", None),
        ("mass_g = 0.3", 'mass_g = 0.3\ndirection = "up"', "payload.direction", None),
        (
            'kind = "bh_table"\nfile = "materials/steel_a3.toml"\nbelow = "straight line to the origin"\n'
            'above = "slope mu0"',
            'kind = "permanent_magnet"\nremanence_T = [0, 0, 1.2]\nmu_r = 1.05',
            "payload.piece.1.material",
            '"steel", a magnet',
        ),
    ],
)
def test_what_is_wrong_is_told_at_its_key(old, new, where, received):
    assert old in BEAD
    with pytest.raises(DeviceFileError) as caught:
        fm.read_device(BEAD.replace(old, new))
    found = [problem for problem in caught.value.problems if problem.where.endswith(where)]
    assert len(found) == 1, caught.value.problems
    assert found[0].remedy
    if received is not None:
        assert found[0].received == received


def test_what_is_wrong_in_python_is_told_at_its_attribute():
    coil = fm.read_device(BEAD).coils
    steel = fm.material("steel_a3")

    def problems(payload, **values):
        with pytest.raises(InputError) as caught:
            fm.Device("one", "", coils=coil, payload=payload, **values)
        return [problem.where for problem in caught.value.problems]

    assert problems(fm.Payload(1e-3, pieces=[fm.SoftSphere(-1e-3, steel)])) == [
        'Device "one": payload.pieces[0].shape.diameter'
    ]
    assert problems(fm.Payload(1e-3, pieces=[fm.SoftSphere(1e-3, "iron")])) == [
        'Device "one": payload.pieces[0].shape.material'
    ]
    # Pieces have their own directions.
    assert problems(fm.Payload(1e-3, pieces=[fm.SoftSphere(1e-3, steel)], direction="down")) == [
        'Device "one": payload.direction'
    ]
    assert problems(fm.Payload(1e-3, pieces=["bead"])) == ['Device "one": payload.pieces[0]']
    known = {"steel_a3": fm.LinearMaterial("steel_a3", 100.0)}
    assert problems(fm.Payload(1e-3, pieces=[fm.SoftSphere(1e-3, steel)]), materials=known) == [
        'Device "one": payload.pieces[0].shape.material'
    ]


def test_inertia_of_pieces_of_one_density():
    # Against a sum over a fine grid of points.
    pieces = [
        fm.PayloadPiece(fm.SoftEllipsoid((4e-3, 6e-3, 8e-3), mu_r=10.0), fm.placed([0.0, 0.0, 5e-3])),
        fm.PayloadPiece(fm.SoftSphere(5e-3, mu_r=10.0), fm.placed([0.0, 0.0, -4e-3])),
    ]
    axis = (np.arange(90) + 0.5) / 90 * 18e-3 - 9e-3
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.zeros(len(grid), bool)
    for piece in pieces:
        inside |= (((grid - piece.placement.position) / (np.array(piece.shape.axes) / 2)) ** 2).sum(
            axis=1
        ) < 1.0
    points = grid[inside] - grid[inside].mean(axis=0)
    square = (points**2).mean(axis=0)
    exact = 2e-3 * (square.sum() - square)
    assert fm.Payload(2e-3, pieces=pieces).principal_moments == pytest.approx(exact, rel=5e-3)
    turned = [fm.PayloadPiece(pieces[0].shape, fm.placed([0, 0, 5e-3], [30.0, 0.0, 0.0])), pieces[1]]
    assert fm.Payload(2e-3, pieces=turned).principal_moments is None
