"""The PID of Python as a program in C with controller.h: in double precision, and in float for microcontrollers."""

import shutil
import subprocess

import numpy as np
import pytest

from fieldmap.control import PID, AxisReading, pid_block, run_pid
from fieldmap.interop import write_c_controller

PROGRAM = """#include <stdio.h>
#include "pid.h"
int main(void)
{
    fm_real v[7] = {0}, memory[3], none[1] = {0}, scratch[5], output[1];
    double reference, measured;
    v[6] = FM(1);
    memory[0] = pid_memory[0], memory[1] = pid_memory[1], memory[2] = pid_memory[2];
    while (scanf("%lf %lf", &reference, &measured) == 2) {
        v[0] = FM(reference), v[3] = FM(measured);
        fieldmap_control(&pid, v, none, memory, scratch, output);
        printf("%.17g\\n", (double)output[0]);
    }
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
@pytest.mark.parametrize(("real", "close"), [("double", 1e-12), ("float", 1e-5)])
@pytest.mark.parametrize("anti_windup", ["clamping", "back_calculation"])
def test_a_program_in_c_gives_the_outputs_of_python(tmp_path, real, close, anti_windup):
    """To 1e-12 of the largest term in double precision, and to 1e-5 of it in float, after 400 samples with limits."""
    pid = PID(0.5, 0.05, 0.004, 2e-3, -1.0, 1.5, anti_windup=anti_windup, Tf=4e-4, b=0.7, c=0.2)
    write_c_controller(pid_block(pid, AxisReading("x")), tmp_path / "pid.h")
    (tmp_path / "pid.c").write_text(PROGRAM)
    strict = [
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Werror",
        f"-DFIELDMAP_REAL={real}",
    ]
    command = ["gcc", *strict, tmp_path / "pid.c", "-o", tmp_path / "pid", "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    random = np.random.default_rng(4)
    reference, measured = 0.3 * random.normal(size=400), np.cumsum(0.2 * random.normal(size=400))
    given = "\n".join(f"{r:.17g} {y:.17g}" for r, y in zip(reference, measured, strict=True))
    done = subprocess.run([tmp_path / "pid"], input=given, capture_output=True, text=True, check=True)
    found, expected = np.array(done.stdout.split(), float), run_pid(pid, reference, measured)
    np.testing.assert_allclose(found, expected, rtol=0, atol=close * max(1.0, float(np.abs(measured).max())))
    assert 20 < np.sum(np.isin(expected, [-1.0, 1.5])) < 380
    assert (np.abs(found - expected).max() > 1e-9) == (real == "float")
