"""`fieldmap import`: a quadrupole that was read with noise, and what is refused."""

import json

import numpy as np
import pytest

from fieldmap.cli import main
from fieldmap.lookup import open_map

GRADIENT, NOISE = np.diag([0.2, 0.2, -0.4]), 10e-6


@pytest.fixture
def readings(tmp_path):
    """300 readings of B = G r per ampere at 2 A, within 10 mm of the origin."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.01, 0.01, (300, 3))
    flux = 2.0 * points @ GRADIENT + NOISE * rng.standard_normal((300, 3))
    lines = ["x_mm,y_mm,z_mm,I_loop_A,Bx_uT,By_uT,Bz_uT"]
    lines += [
        ",".join(map(repr, [*row[:3], 2.0, *row[3:]]))
        for row in np.hstack([1e3 * points, 1e6 * flux]).tolist()
    ]
    path = tmp_path / "readings.csv"
    path.write_text("\n".join(lines))
    return path


def test_a_table_becomes_a_map(readings, tmp_path):
    target = tmp_path / "measured.h5"
    assert main(["import", str(readings), "-o", str(target), "--spacing-mm", "4"]) == 0
    opened = open_map(target)
    np.testing.assert_allclose(opened.gradient([0.002, 0.001, -0.003], [1.5]), 1.5 * GRADIENT, atol=2e-3)
    assert (opened.upper - opened.lower).max() / (np.array(opened.info.grid.shape) - 1).max() < 0.004
    assert main(["check", str(target)]) == 0
    assert main(["info", str(target)]) == 0


def test_json_has_the_residual_in_tesla(readings, tmp_path, capsys):
    arguments = ["import", str(readings), "-o", str(tmp_path / "m.h5"), "--degree", "2", "--json"]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["coils"] == ["loop"]
    assert found["report"]["degree"] == 2
    assert found["report"]["residual"] == pytest.approx(NOISE, rel=0.1)
    assert found["report"]["standard_error"]["flux_density"] < NOISE
