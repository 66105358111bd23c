"""[background]: read, refused, written, and its field."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device import read_device, recorded_device
from fieldmap.errors import DeviceFileError, InputError

TEXT = """format = 1
name = "d"
title = "t"

[background]
flux_density_mT = [1.0, -2.0, 3.0]
{gradient}

[[coil]]
name = "1"
kind = "circular"
inner_radius_mm = 10
outer_radius_mm = 12
height_mm = 5
turns = 10
"""
FIVE = "gradient_mT_per_m = [1.0, 2.0, 3.0, 4.0, 5.0]"
NINE = "gradient_mT_per_m = [[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, -5.0]]"
TENSOR = 1e-3 * np.array([[1.0, 2, 3], [2, 4, 5], [3, 5, -5]])


@pytest.mark.parametrize(("gradient", "tensor"), [(FIVE, TENSOR), (NINE, TENSOR), ("", np.zeros((3, 3)))])
def test_a_background_is_uniform_or_has_a_gradient_written_in_either_way(gradient, tensor):
    device = read_device(TEXT.format(gradient=gradient + "\ncentre_mm = [10.0, 0.0, 0.0]"))
    points = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.2, -0.1]])
    flux, slope = device.background.field_and_gradient(points)
    expected = 1e-3 * np.array([1.0, -2.0, 3.0]) + (points - [0.01, 0, 0]) @ tensor
    assert flux == pytest.approx(expected, rel=1e-14)
    assert slope == pytest.approx(np.broadcast_to(tensor, (3, 3, 3)), rel=1e-14)
    assert device.fixed_sources == ("background",)


@pytest.mark.parametrize(
    "gradient",
    [
        "[1.0, 2.0, 3.0, 4.0]",
        "[[1.0, 2.0], [2.0, -1.0]]",
        "[[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, -4.9]]",
        "[[1.0, 2.0, 3.0], [2.1, 4.0, 5.0], [3.0, 5.0, -5.0]]",
        '[1.0, 2.0, 3.0, 4.0, "5"]',
        "[1.0, 2.0, 3.0, 4.0, nan]",
        "3.0",
    ],
)
def test_what_is_no_gradient_of_a_field_is_refused_at_its_key(gradient):
    with pytest.raises(DeviceFileError) as error:
        read_device(TEXT.format(gradient=f"gradient_mT_per_m = {gradient}"))
    (problem,) = error.value.problems
    assert "background.gradient_mT_per_m" in problem.where


@pytest.mark.parametrize("gradient", [np.diag([1.0, 1.0, 1.0]), np.ones(4), np.full((3, 3), np.nan)])
def test_python_devices_are_refused_alike(gradient):
    with pytest.raises(InputError) as error:
        fm.Device("d", "", coils=[], bodies=[], background=fm.Background([0.0, 0.0, 1e-3], gradient))
    assert any("background.gradient" in problem.where for problem in error.value.problems)


@pytest.mark.parametrize("gradient", [FIVE, NINE, ""])
def test_written_and_read_again(gradient):
    device = read_device(TEXT.format(gradient=gradient))
    for other in (read_device(device.to_toml()), recorded_device(device.text), device.replace(name="e")):
        points = np.random.default_rng(1).normal(size=(5, 3))
        assert np.array_equal(other.background.field(points), device.background.field(points))
    made = fm.Device("d", "", coils=device.coils, background=device.background)
    assert read_device(made.text).background.field(points) == pytest.approx(
        device.background.field(points), rel=1e-15
    )


def test_a_mirror_keeps_the_field_across_it_and_no_other():
    """Flux density is an axial vector, so only a field across the mirror is kept."""
    mirror = np.diag([1.0, 1.0, -1.0])
    for flux, kept in (([0.0, 0.0, 1.0], True), ([1.0, 0.0, 0.0], False), ([1.0, 0.0, 1.0], False)):
        assert fm.Background(flux).is_kept_by(mirror, np.zeros(3)) is kept
    turn = np.diag([-1.0, -1.0, 1.0])
    assert fm.Background([0.0, 0.0, 1.0], [1.0, 0.5, 0.0, 1.0, 0.0]).is_kept_by(turn, np.zeros(3))
    assert not fm.Background([0.0, 0.0, 1.0], [1.0, 0.5, 0.1, 1.0, 0.0]).is_kept_by(turn, np.zeros(3))
    assert not fm.Background([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0, 0.0]).is_kept_by(mirror, [0, 0, 0.1])
