"""The examples for Simulink and ROS 2, compiled and called through stand-ins: neither program is at hand."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.interop import c_header, write_c_map

STAND_INS = Path(__file__).parent / "c" / "stand_ins"
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
MOMENT = [0.1, -0.2, 0.8]

pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None or shutil.which("g++") is None, reason="no gcc and g++ on this machine"
)


def build(source, target, *flags):
    places = ["-I", c_header().parent, "-I", STAND_INS, source, "-o", target]
    command = [*flags, "-Wall", "-Wextra", "-Werror", *places]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return target


def asked(program, m, rows, folder):
    path = write_c_map(m, folder / "linear.fmap")
    done = subprocess.run([program, path], input=np.hstack(rows).tobytes(), capture_output=True)
    return np.frombuffer(done.stdout), done


def questions(m):
    rng = np.random.default_rng(4)
    points = m.lower + rng.random((100, 3)) * (m.upper - m.lower)
    return points, rng.normal(size=(100, 4)), rng.normal(size=(100, 6))


def close(found, exact):
    assert np.abs(found - exact).max() < 1e-12 * np.abs(exact).max()


def test_the_s_function(ring, tmp_path):
    program = build(
        EXAMPLES / "sfun_fieldmap.c", tmp_path / "block", "gcc", "-std=c99", "-Wno-unused-function"
    )
    m = ring.map
    points, _, currents = questions(m)
    found, done = asked(program, m, (points, currents), tmp_path)
    assert done.returncode == 0
    found = found.reshape(-1, 18)
    flux, slope = m.field_and_gradient(points, currents)
    close(found[:, :3], flux)
    close(found[:, 3:12], slope.reshape(-1, 9))
    wrench = m.wrench(points, MOMENT, currents)
    close(found[:, 12:15], wrench[:, :3])
    close(found[:, 15:], wrench[:, 3:])
    points[3] = m.upper + 1.0
    found, done = asked(program, m, (points, currents), tmp_path)
    assert (len(found), done.returncode) == (3 * 18, 1)
    assert done.stderr
    assert subprocess.run([program, tmp_path / "none"], capture_output=True).returncode == 1


def test_the_node(ring, tmp_path):
    program = build(EXAMPLES / "field_node" / "field_node.cpp", tmp_path / "node", "g++", "-std=c++17")
    m = ring.map
    points, quaternions, currents = questions(m)
    found, done = asked(program, m, (points, quaternions, currents), tmp_path)
    assert done.returncode == 0
    found = found.reshape(-1, 7)
    assert found[:, 0].tolist() == list(range(1, 101))
    turned = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).apply(MOMENT)
    wrench = m.wrench(points, turned, currents)
    close(found[:, 1:4], wrench[:, :3])
    close(found[:, 4:], wrench[:, 3:])
    points[3] = m.upper + 1.0
    found, done = asked(program, m, (points, quaternions, currents), tmp_path)
    assert found.reshape(-1, 7)[:, 0].tolist() == [1, 2, 3, *range(5, 101)]
    assert done.stderr
