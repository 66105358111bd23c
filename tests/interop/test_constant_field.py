"""A field that no current drives in every export: C, C32, FMU, JAX, MuJoCo, tables, images, mag_manip."""

import shutil
import subprocess

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.field import Field
from fieldmap.interop import c_header, write_c32_files, write_c_map, write_csv, write_fmu, write_mag_manip
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData
from tests.interop.test_c_map import STRICT, ask, build, questions, wave, wrench_by_hand

gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


def constant_data():
    """Two coils, and a field that neither drives."""
    grid = Grid([-0.01, -0.01, -0.02], [0.004, 0.005, 0.0025], (6, 5, 5))
    x, y, z = np.moveaxis(grid.points().reshape(6, 5, 5, 3), -1, 0)
    units = [wave(x, y, z, k, phase) for k, phase in ((60.0, 0.3), (45.0, 1.1), (30.0, 2.0))]
    flux, slope = (np.stack(parts) for parts in zip(*units, strict=True))
    return MapData(
        grid,
        ("left", "right"),
        [1.0, 2.0],
        flux_density=flux,
        gradient=slope,
        fixed_sources=("magnet",),
        constant_field=True,
    )


data = pytest.fixture(scope="module")(constant_data)


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    return build("ask.c", tmp_path_factory.mktemp("c") / "ask", *STRICT, "-O1")


@gcc
@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_c_gives_the_numbers_of_python(programs, data, tmp_path, kind):
    m = interpolate(data, kind)
    path = write_c_map(m, tmp_path / "field.fmap")
    currents, points, moments = questions(m, 2000)
    currents[:10] = 0.0
    (flux, slope, second, wrench, status), said = ask(programs, path, (currents, points, moments), tmp_path)
    assert not status.any()
    assert said.splitlines()[:2] == ["left", "right"]
    expected = [*m.field_and_gradient(points, currents), m.second_gradient(points, currents)]
    expected.append(np.hstack(wrench_by_hand(expected, moments)))
    for ours, python in zip((flux, slope, second, wrench), expected, strict=True):
        assert np.abs(ours - python).max() < 1e-13 * np.abs(python).max()
    assert np.abs(flux[:10]).max() > 0.0


@gcc
def test_c_readers_of_before_refuse_it(data, tmp_path):
    """Before the numbers, earlier readers check only that the version is 1."""
    raw = write_c_map(interpolate(data), tmp_path / "field.fmap").read_bytes()
    assert int.from_bytes(raw[12:16], "little") == 2
    # Marked as version 1, a map of coils alone, today's reader refuses it too.
    (tmp_path / "other.fmap").write_bytes(raw[:12] + (1).to_bytes(4, "little") + raw[16:])
    done, program = compiled(AT, tmp_path)
    assert done.returncode == 0, done.stderr
    assert subprocess.run([program, tmp_path / "other.fmap"], check=False).returncode == 1
    driven = MapData(
        data.grid,
        data.coil_names,
        data.reference_current,
        flux_density=data.flux_density[:2],
        gradient=data.gradient[:2],
    )
    raw = write_c_map(interpolate(driven), tmp_path / "driven.fmap").read_bytes()
    assert int.from_bytes(raw[12:16], "little") == 1


AT = """#include <stdio.h>
#include "fieldmap.h"
int main(int n, char **a) {
    fieldmap map, fixed;
    double currents[2] = {1.5, -0.5}, point[3] = {0.001, -0.002, -0.015}, one[3], two[3];
    if (n < 2 || fieldmap_open(&map, a[1]) != FIELDMAP_OK) return 1;
    if (map.n_coils != 2 || map.constant != 1 || fieldmap_coil_name(&map, 2) != NULL) return 2;
    if (fieldmap_field(&map, NULL, point, one, NULL) != FIELDMAP_ARGUMENT) return 3;
    if (fieldmap_field(&map, currents, point, one, NULL) != FIELDMAP_OK) return 4;
    if (fieldmap_at(&map, currents, &fixed) != FIELDMAP_OK || fixed.n_coils != 1 || fixed.constant != 0) return 5;
    if (fieldmap_field(&fixed, NULL, point, two, NULL) != FIELDMAP_OK) return 6;
    fieldmap_close(&map);
    fieldmap_close(&fixed);
    printf("%.17g %.17g %.17g %.17g %.17g %.17g", one[0], one[1], one[2], two[0], two[1], two[2]);
    return 0;
}
"""


def compiled(text, folder, *flags):
    (folder / "main.c").write_text(text)
    program = folder / "main"
    command = ["gcc", *STRICT, *flags, "-I", c_header().parent, f"{program}.c", "-o", program, "-lm"]
    return subprocess.run(command, capture_output=True, text=True, check=False), program


@gcc
def test_c_at_fixed_currents(data, tmp_path):
    m = interpolate(data)
    path = write_c_map(m, tmp_path / "field.fmap")
    done, program = compiled(AT, tmp_path)
    assert done.returncode == 0, done.stderr
    found = subprocess.run([program, path], capture_output=True, text=True, check=True)
    values = np.array([float(x) for x in found.stdout.split()]).reshape(2, 3)
    exact = m.field([0.001, -0.002, -0.015], [1.5, -0.5])
    assert values == pytest.approx(np.tile(exact, (2, 1)), rel=1e-13, abs=1e-13 * np.abs(exact).max())


C32 = """#include <stdio.h>
#include "lift.h"
int main(void) {
    float currents[2] = {1.5f, -0.5f}, point[3] = {0.001f, -0.002f, -0.015f}, flux[3];
    if (fm32_field(&lift, NULL, point, flux, NULL) != FM32_ARGUMENT) return 1;
    if (fm32_field(&lift, currents, point, flux, NULL) != FM32_OK) return 2;
    printf("%.9g %.9g %.9g", (double)flux[0], (double)flux[1], (double)flux[2]);
    return 0;
}
"""


@gcc
def test_constants_in_single_precision(data, tmp_path):
    m = interpolate(data, "global")
    _, header = write_c32_files(m, tmp_path / "lift.h")
    done, program = compiled(C32, tmp_path, "-I", str(tmp_path))
    assert done.returncode == 0, done.stderr
    found = subprocess.run([program], capture_output=True, text=True, check=True)
    exact = m.field([0.001, -0.002, -0.015], [1.5, -0.5])
    assert np.array(found.stdout.split(), float) == pytest.approx(exact, abs=3e-6 * np.abs(exact).max())
    # A header without constant fields does not compile with such a map.
    header.write_text(header.read_text().replace("#define FM32_CONSTANT_FIELD 1", ""))
    (tmp_path / "other").mkdir()
    shutil.copy(header, tmp_path / "other" / "fieldmap32.h")
    refused, _ = compiled(C32, tmp_path, "-I", str(tmp_path))
    assert refused.returncode != 0


@gcc
def test_fmu_has_the_constant_field(data, fmpy, tmp_path):
    """In FMPy, without and with currents."""
    m, moment, point = interpolate(data), [0.1, 0.0, 0.5], [0.001, -0.002, -0.015]
    unit = write_fmu(m, tmp_path / "lift.fmu", magnet=moment)
    currents = np.array([[0.0, 0.0], [1.5, -0.5]])
    poses = np.tile([*point, 1.0, 0.0, 0.0, 0.0], (2, 1))
    found = fmpy(tmp_path, kind="ask", path=str(unit), poses=poses, currents=currents)["outputs"]
    for ours, amperes in zip(found, currents, strict=True):
        flux, slope = m.field_and_gradient(point, amperes)
        exact = np.concatenate([flux, np.ravel(slope), m.wrench(point, moment, amperes)])
        assert ours == pytest.approx(exact, rel=1e-12, abs=1e-13)


def test_jax_has_the_constant_field(data):
    jax = pytest.importorskip("jax")
    from fieldmap.interop import jax_field

    jax.config.update("jax_enable_x64", True)
    m = interpolate(data)
    currents, points, _ = questions(m, 50)
    field = jax_field(m)
    for ours, exact in (
        (field.field(points, currents), m.field(points, currents)),
        (field.gradient(points, currents[0]), m.gradient(points, currents[0])),
        (field.field(points, np.zeros(2)), m.field(points, 0.0)),
        (jax_field(m.at(currents[0])).field(points), m.field(points, currents[0])),
    ):
        assert np.asarray(ours) == pytest.approx(exact, rel=1e-12, abs=1e-13 * np.abs(exact).max())


MODEL = """<mujoco><option timestep="0.0005" gravity="0 0 0"/><worldbody><body name="float" pos="0.001 -0.002 -0.015">
<freejoint/><geom type="sphere" size="0.002" mass="0.005"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("compiled", [True, False])
def test_mujoco_feels_the_constant_field(data, compiled):
    mujoco = pytest.importorskip("mujoco")
    from fieldmap.interop import MagnetForces

    m = interpolate(data)
    model = mujoco.MjModel.from_xml_string(MODEL)
    state = mujoco.MjData(model)
    moment = np.array([0.01, 0.0, 0.05])
    with MagnetForces(model, m, {"float": moment}, [0.0, 0.0], compiled=compiled) as magnets:
        assert magnets.compiled is compiled
        for currents in ([0.0, 0.0], [1.5, -0.5]):
            magnets.currents = currents
            mujoco.mj_forward(model, state)
            exact = m.wrench([0.001, -0.002, -0.015], moment, currents)
            assert state.qfrc_passive[:6] == pytest.approx(exact, rel=1e-10, abs=1e-15)


def test_table_has_what_is_there_without_currents(data, tmp_path):
    m = interpolate(data)
    lines = write_csv(m, tmp_path / "field.csv").read_text().splitlines()
    rows = np.array([line.split(",") for line in lines if line[0] != "#"][1:], float)
    points, currents, flux, slope = np.split(rows, [3, 5, 8], axis=1)
    assert len(np.unique(currents, axis=0)) == 3
    at = np.clip(points, m.lower, m.upper)
    assert flux == pytest.approx(m.field(at, currents), rel=1e-12, abs=1e-14)
    assert slope.reshape(-1, 3, 3) == pytest.approx(m.gradient(at, currents), rel=1e-12, abs=1e-12)
    assert any("magnet" in line for line in lines if line[0] == "#")


def test_images_have_the_field_without_currents(data):
    pytest.importorskip("pyvista")
    from fieldmap.plot.vti import map_image

    m = interpolate(data)
    image = map_image(m)
    at = np.clip(np.array(image.points, float), m.lower, m.upper)
    exact = m.field(at, 0.0)
    assert image.point_data["B_no_current_T"] == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())
    assert "B_no_current_T" not in map_image(m, [1.0, 1.0]).point_data


def test_mag_manip_is_refused_by_name(data, tmp_path):
    """Its linear model sums the fields of coils, which is zero without currents."""
    m = interpolate(data)
    with pytest.raises(InputError) as error:
        write_mag_manip(m, tmp_path / "field.yaml")
    assert "magnet" in error.value.problems[0].received
    with pytest.raises(InputError):
        write_mag_manip(m, tmp_path / "field.yaml", currents=[1.0, 1.0])
    assert not (tmp_path / "field.yaml").exists()


def test_a_field_of_your_own_may_say_that_it_is_affine(tmp_path):
    class Earth(Field):
        coil_names, affine, bounds = ("1",), True, (np.zeros(3), np.ones(3))

        def field(self, points, currents):
            up = 3.0 * np.asarray(currents)[..., 0] if np.ndim(currents) else 3.0 * currents
            return np.broadcast_to([1.0, 2.0, up], np.shape(points)).copy()

        def gradient(self, points, currents):
            return np.zeros((*np.shape(points), 3))

    earth = Earth()
    point = np.array([0.1, 0.2, 0.3])
    assert earth.unit_field(point).tolist() == [[0.0, 0.0, 3.0]]
    assert earth.constant_field(point[None]).tolist() == [[1.0, 2.0, 0.0]]
    lines = write_csv(earth, tmp_path / "earth.csv", spacing=0.5).read_text().splitlines()
    rows = np.array([line.split(",") for line in lines if line[0] != "#"][1:], float)
    assert np.unique(rows[:, 3:7], axis=0).tolist() == [[0.0, 1.0, 2.0, 0.0], [1.0, 1.0, 2.0, 3.0]]
