"""Field sensors, the height by a calibration curve and a PID in C programs, against Python: in double and in float."""

import shutil
import subprocess

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.control import PID, AxisReading, pid_block
from fieldmap.core.headers import FOLDER
from fieldmap.errors import InputError
from fieldmap.instruments import calibrate
from fieldmap.interop import write_c_controller, write_c_curve, write_c_files, write_c_sensors
from fieldmap.lookup import MagneticBody
from tests.refusals import refused

COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
DIPOLE = MagneticBody.dipole([0.0, 0.0, 1.08])

CONTROLLER = """#include <stdio.h>
#include "hall.h"
#include "pid.h"
int main(void)
{
    fm_real v[7] = {0}, memory[3] = {0}, none[1] = {0}, scratch[5], output[1], current[1];
    double reading, ampere;
    v[2] = FM(-0.025), v[6] = FM(1);
    memory[0] = pid_memory[0], memory[1] = pid_memory[1], memory[2] = pid_memory[2];
    while (scanf("%lf %lf", &reading, &ampere) == 2) {
        current[0] = FM(ampere);
        v[5] = fieldmap_height_of_reading(&hall, FM(reading), current);
        fieldmap_control(&pid, v, none, memory, scratch, output);
        printf("%.17g %.17g\\n", (double)v[5], (double)output[0]);
    }
    return 0;
}
"""

READER = """#include <stdio.h>
#include "map_file.h"
#include "sensors.h"

int main(int argc, char **argv)
{
    const fieldmap_dipole dipole = {{0.0, 0.0, 0.0}, {0.0, 0.0, 1.08}};
    const fieldmap_magnetic_body body = {.n_dipoles = 1, .dipoles = &dipole};
    const double upright[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    fieldmap map, answers;
    fieldmap_field_sensors sensors_here = sensors;
    double place[3], current[1], readings[2];
    fieldmap_path field = {.map = &map, .weights = current};
    if (argc < 3 || fieldmap_open(&map, argv[1]) || fieldmap_open(&answers, argv[2])) return 1;
    sensors_here.answers = &answers;
    while (scanf("%lf %lf %lf %lf", place, place + 1, place + 2, current) == 4) {
        if (fieldmap_read_sensors(&sensors_here, &field, &body, place, upright, readings) != FIELDMAP_OK) return 2;
        printf("%.17g %.17g\\n", readings[0], readings[1]);
    }
    fieldmap_close(&answers);
    fieldmap_close(&map);
    return 0;
}
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """The desk levitator with a second sensor, in the field of the earth."""
    device = fm.read_device("desk_levitator")
    device = device.replace(
        sensors=(*device.sensors, fm.FieldSensor("beside", [0.018, 0.004, -0.035], [1, 0, 1])),
        background=fm.Background(flux_density=np.array([20e-6, -5e-6, -45e-6])),
    )
    path = tmp_path_factory.mktemp("sensors") / "desk.h5"
    return fm.open_map(fm.generate(device, path, spacing=3e-3, progress=False))


def said(folder, source, given, *arguments, real="double", library=True):
    """What a program prints for rows of numbers, as rows."""
    (folder / "it.c").write_text(source)
    libraries = ["-lm"] if library else []
    include = ["-I", folder, "-I", FOLDER]
    command = ["gcc", *STRICT, f"-DFIELDMAP_REAL={real}", *include, folder / "it.c", "-o", folder / "it"]
    subprocess.run([*command, *libraries], check=True)
    text = "\n".join(" ".join(f"{x:.17g}" for x in row) for row in given)
    done = subprocess.run([folder / "it", *arguments], input=text, capture_output=True, text=True, check=True)
    return np.array([line.split() for line in done.stdout.splitlines()], float)


@COMPILED
@pytest.mark.parametrize(("real", "height", "output"), [("double", 1e-14, 1e-12), ("float", 1e-8, 1e-4)])
def test_estimator_and_pid_in_c_give_what_python_gives(field, tmp_path, real, height, output):
    """After 500 samples with noise: heights of 25 mm to 1e-14 m, in float to 10 nm; outputs of up to 2.5 V to 1e-12 V,
    in float to 0.1 mV."""
    curve = calibrate(field, DIPOLE, "hall")
    pid = PID(800.0, 0.55, 0.0192, 5e-4, -2.5, 2.5, Tf=0.00192, c=0.0, anti_windup="back_calculation")
    block = pid_block(pid, AxisReading("z"), 0.3)
    for _ in range(2):  # what this package wrote, it may replace
        write_c_curve(curve, tmp_path / "hall.h")
        write_c_controller(block, tmp_path / "pid.h")
    random, n = np.random.default_rng(4), 500
    true = -0.025 + 5e-4 * np.sin(0.05 * np.arange(n))
    currents = random.uniform(-0.5, 1.0, (n, 1))
    places = np.column_stack([np.zeros((n, 2)), true])
    readings = field.readings(places, DIPOLE, currents)[:, 0] + 20e-6 * random.normal(size=n)
    found = said(
        tmp_path,
        CONTROLLER,
        np.column_stack([readings, currents]),
        real=real,
    )
    heights = curve.height(readings, currents)
    signals = np.column_stack([np.full((n, 3), [0, 0, -0.025]), np.zeros((n, 2)), heights, np.ones(n)])
    outputs = np.array(list(run_of(block, signals)))
    np.testing.assert_allclose(found[:, 0], heights, rtol=0, atol=height)
    np.testing.assert_allclose(found[:, 1], outputs, rtol=0, atol=output)
    assert (np.abs(found[:, 0] - heights).max() > 1e-12) == (real == "float")
    # Heights follow the true place to within the noise.
    assert np.abs(heights - true).max() < 5e-5
    assert np.sum(np.abs(outputs) < 2.5) > 20
    assert np.ptp(outputs) > 1.0


def run_of(block, signals):
    """Outputs of a block in numpy, with its limits: docs/theory/closed_loop.md (5)."""
    memory = block.memory
    for v in signals:
        wanted = block.C @ memory + block.D @ v
        out = np.clip(wanted, block.lower, block.upper)
        memory = block.A @ memory + block.B @ v + block.E @ out
        yield float(out[0])


@COMPILED
def test_a_curve_in_c_is_one_file_that_calls_no_library(field, tmp_path):
    curve = calibrate(field, DIPOLE, "hall")
    header, reader = write_c_curve(curve, tmp_path / "hall.h")
    assert header.name == "hall.h"
    assert reader.name == "calibration_curve.h"
    assert '#include "real.h"' not in reader.read_text()
    source = '#include <stdio.h>\n#include "hall.h"\nint main(void) { fm_real i[1] = {FM(0.5)};\n'
    source += 'printf("%.17g\\n", (double)fieldmap_height_of_reading(&hall, FM(0.045), i)); return 0; }\n'
    found = said(tmp_path, source, [], library=False)
    assert found[0, 0] == pytest.approx(float(curve.height(0.045, 0.5)), abs=1e-15)


@COMPILED
def test_readings_in_c_are_those_of_python(field, tmp_path):
    write_c_files(field, tmp_path / "desk.fmap")
    written = write_c_sensors(field, tmp_path / "sensors.h")
    assert [path.name for path in written] == ["sensors.h", "sensors.fmap"]
    random = np.random.default_rng(6)
    places = random.uniform([-0.005, -0.005, -0.035], [0.005, 0.005, -0.02], (50, 3))
    currents = random.uniform(-2.0, 2.0, (50, 1))
    given = np.column_stack([places, currents])
    found = said(tmp_path, READER, given, tmp_path / "desk.fmap", tmp_path / "sensors.fmap")
    np.testing.assert_allclose(found, field.readings(places, DIPOLE, currents), rtol=1e-12)


def test_a_map_without_sensors_is_refused(tmp_path):
    with refused(InputError, where="write_c_sensors, field_map"):
        write_c_sensors(fm.open_map("sample"), tmp_path / "sensors.h")
