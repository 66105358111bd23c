"""Exported maps in mag_manip itself, which runs in an environment of its own."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fieldmap.interop import sample_for_mag_manip, write_mag_manip
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData

ROOT = Path(__file__).parents[2]
GRID = Grid([-0.02, -0.015, -0.15], [0.008, 0.0075, 0.006], (6, 5, 9))


@pytest.fixture(scope="session")
def program(validation, usable):
    """The module that runs mag_manip."""
    found = validation("mag_manip_program")
    usable(found.PROGRAM)
    return found


def loops(n, grid=GRID):
    """A map of n loops of 10 000 turns on a circle above the box, no two alike."""
    angles = 2 * np.pi * np.arange(n) / n
    flux, slope = [], []
    for k, angle in enumerate(angles):
        centre = np.array([0.044 * np.cos(angle), 0.044 * np.sin(angle), 0.026])
        one = loop_flux_density_and_gradient(grid.points() - centre, 0.016 + 1e-4 * k)
        flux.append(1e4 * one[0].reshape(*grid.shape, 3))
        slope.append(1e4 * one[1].reshape(*grid.shape, 3, 3))
    names = tuple(f"loop {k}" for k in range(n))
    return interpolate(
        MapData(grid, names, np.ones(n), flux_density=np.array(flux), gradient=np.array(slope))
    )


def share(ours, exact):
    axes = tuple(range(1, exact.ndim))
    return np.sqrt(((ours - exact) ** 2).sum(axes)).max() / np.sqrt((exact**2).sum(axes)).max()


def test_the_field_of_a_map_of_unequal_counts(program, tmp_path):
    """B within 1e-4 in the box, on faces and corners too; the stated errors of B and gradient are those that occur."""
    field = loops(2)
    sampled = sample_for_mag_manip(field)
    path = sampled.write(tmp_path / "two.yaml")
    points, currents = program.box_points(field), np.array([1.0, -0.5])
    read = program.ask(path, points, currents)
    error = program.field_error(read.unit_field, field.unit_field(points))
    assert error < 1e-4
    assert error < 1.1 * sampled.flux_error < 2 * error
    error = share(read.gradient, field.gradient(points, currents))
    assert error < 0.02
    assert error < 1.5 * sampled.gradient_error


def test_currents_are_in_the_order_of_the_coils(program, tmp_path):
    """Of eleven coils, whose names the program sorts as texts; it also finds currents for a field."""
    field = loops(11)
    path = write_mag_manip(field, tmp_path / "eleven.yaml", spacing=0.006)
    points = program.box_points(field, 50)
    currents = np.linspace(-1, 2, 11)
    read = program.ask(path, points, currents)
    exact = field.unit_field(points)
    assert read.unit_field.shape == (len(points), 11, 3)
    assert program.field_error(read.unit_field, exact) < 2e-3
    # Neighbouring coils differ by far more.
    assert program.field_error(np.roll(read.unit_field, 1, axis=1), exact) > 0.1
    wanted = field.field(points, currents)
    assert share(np.einsum("nci,nc->ni", exact, read.inverse), wanted) < 4e-3


def test_unequal_counts_are_what_it_cannot_read(program, tmp_path):
    """The reason for resampling: the same numbers in its documented order, with unequal counts, are read wrongly."""
    field = loops(1, Grid([-0.02, -0.02, -0.15], [0.005, 0.005, 0.005], (9, 9, 9)))
    lines = write_mag_manip(field, tmp_path / "equal.yaml", spacing=0.005).read_text().splitlines()
    data = [line for line in lines if line.startswith("    - [")]
    assert len(data) == 9**3
    lower, upper = field.lower, np.array([0.0, *field.upper[1:]])
    box = [
        f"    {end}_{axis}: {face[a]}"
        for end, face in (("min", lower), ("max", upper))
        for a, axis in enumerate("xyz")
    ]
    # The half of the box with x < 0: 5 x 9 x 9 of the same nodes.
    half = [
        "name: half",
        "vfields:",
        "  coil_00:",
        "    data:",
        *data[: 5 * 81],
        "    dim_x: 5",
        "    dim_y: 9",
        "    dim_z: 9",
    ]
    (tmp_path / "half.yaml").write_text("\n".join([*half, *box]) + "\n")
    points = np.random.default_rng(1).uniform(lower + 1e-6, upper - 1e-6, (100, 3))
    exact = field.unit_field(points)
    whole = program.ask(tmp_path / "equal.yaml", points, [1.0])
    assert program.field_error(whole.unit_field, exact) < 3e-3
    part = program.ask(tmp_path / "half.yaml", points, [1.0])
    assert program.field_error(part.unit_field, exact) > 0.1


def test_the_lines_of_the_documentation(program, tmp_path):
    field = loops(6, Grid([-0.02, -0.02, -0.12], [0.008, 0.008, 0.008], (6, 6, 6)))
    write_mag_manip(field, tmp_path / "linear.yaml", spacing=0.004)
    section = (ROOT / "docs" / "other_programs.md").read_text().split("## mag_manip")[1]
    lines = re.search(r"```python\n(.*?)```", section, re.DOTALL)[1]
    lines += "np.savez('seen.npz', place=place, currents=currents, field=field, gradient=gradient, wanted=wanted)\n"
    subprocess.run([program.environment(), "-c", lines], cwd=tmp_path, check=True, capture_output=True)
    with np.load(tmp_path / "seen.npz") as seen:
        flux, slope = field.field_and_gradient(seen["place"], seen["currents"])
        assert np.linalg.norm(np.ravel(seen["field"]) - flux) < 1e-3 * np.linalg.norm(flux)
        assert np.linalg.norm(seen["gradient"] - slope) < 1e-2 * np.linalg.norm(slope)
        again = field.field(seen["place"], np.ravel(seen["wanted"]))
        assert np.linalg.norm(again - flux) < 2e-3 * np.linalg.norm(flux)
