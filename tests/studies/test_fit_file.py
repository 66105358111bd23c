"""Fit files: readings of a thin loop, whose field, lift current and inductance are known in closed form."""

import re

import numpy as np
import pytest
from scipy.constants import g, mu_0

import fieldmap as fm
from fieldmap.errors import FitError, InputError
from fieldmap.iron import LinearSolution, NonlinearSolver
from fieldmap.studies import read_fit
from tests.conftest import DEVICES
from tests.levitation.conftest import slope_on_axis
from tests.refusals import refused

RADIUS, TURNS, CURRENT = 0.044, 1000, 2.0
HEIGHT_MM = 1.5
HEAD = """format = 1
title = "Where the loop hangs"
device = "thin_loop.toml"

[[unknown]]
key = "coil.loop.position_mm.3"
start = 0.0
lower = -5.0
upper = 5.0
"""


def on_axis(z):
    """B on the axis of a filament at HEIGHT_MM (Jackson, section 5.5)."""
    d = z - 1e-3 * HEIGHT_MM
    return 0.5 * mu_0 * TURNS * CURRENT * RADIUS**2 / (RADIUS**2 + d**2) ** 1.5


@pytest.fixture
def fit_file(tmp_path):
    """fit_file(text): the path of a fit file beside the device."""
    (tmp_path / "thin_loop.toml").write_text((DEVICES / "thin_loop.toml").read_text())

    def write(text):
        path = tmp_path / "fit.toml"
        path.write_text(text)
        return path

    return write


def probe(use, heights_mm, components='["x", "z"]'):
    values = [[0.0, 1e3 * on_axis(1e-3 * z)] for z in heights_mm]
    return f"""
[[flux_density]]
name = "probe {use}"
use = "{use}"
components = {components}
currents_A = {CURRENT}
points_mm = {[[0, 0, z] for z in heights_mm]}
measured_mT = {values}
deviation_mT = {[0.01] * len(heights_mm)}
"""


def lift(use, depths_mm):
    # Positions are of the magnet. Its moment points up, so B must grow upwards.
    amperes = [0.01 * g / (0.8 * slope_on_axis(1e-3 * (z - HEIGHT_MM))) for z in depths_mm]
    return f"""
[[lift_current]]
name = "lift"
use = "{use}"
positions_mm = {[[0, 0, z] for z in depths_mm]}
measured_A = {amperes}
deviation_A = 0.01
"""


def test_the_height_of_a_loop_from_a_probe_on_its_axis(fit_file):
    text = HEAD + probe("fit", [-70, -80]) + probe("predict", [-60]) + lift("predict", [-100])
    asked = read_fit(fit_file(text))
    found = asked.run()
    assert found.values["coil.loop.position_mm.3"] == pytest.approx(HEIGHT_MM, abs=0.01)
    fitted, *predicted = found.tables
    told = [(one.name, one.used) for one in found.tables]
    assert told == [("probe fit", True), ("probe predict", False), ("lift", False)]
    assert fitted.measured == pytest.approx([0.0, on_axis(-0.07), 0.0, on_axis(-0.08)])
    assert asked.labels["probe fit"][1] == "Bz at (0, 0, -70) mm"
    for one in predicted:
        assert one.after == pytest.approx(one.measured, rel=1e-3, abs=1e-9)
        assert one.misfit_before > 5 * one.misfit
    # By hand: one parameter, slope dB/dz, deviations of 0.01 mT.
    step = 1e-6
    slopes = [(on_axis(z - step) - on_axis(z + step)) / (2 * step) for z in (-0.07, -0.08)]
    deviation = 1e3 * 1e-5 / np.linalg.norm(slopes)
    assert found.deviations["coil.loop.position_mm.3"] == pytest.approx(deviation, rel=0.01)


def test_each_point_has_its_deviation(fit_file):
    """The same in all components at a point; a component without a reading is nan."""
    text = HEAD + probe("fit", [-70, -80]).replace("[0.01, 0.01]", "[0.01, 0.04]")
    (table,) = read_fit(fit_file(text)).readings
    np.testing.assert_allclose(table.deviation, [1e-5, 1e-5, 1e-5, 4e-5, 4e-5, 4e-5], rtol=1e-12)
    read = np.ravel(table.measured)
    np.testing.assert_allclose(read[[2, 5]], [on_axis(-0.07), on_axis(-0.08)], rtol=1e-9)
    assert np.isnan(read).tolist() == [False, True, False] * 2


def test_a_height_from_lift_currents(fit_file):
    found = read_fit(fit_file(HEAD + lift("fit", [-85, -95]))).run()
    assert found.values["coil.loop.position_mm.3"] == pytest.approx(HEIGHT_MM, abs=0.02)


def test_turns_from_an_inductance_and_a_prior(fit_file):
    """L = mu0 N^2 R (ln(8 R / 0.2235 (a + b)) - 2) of a thin ring of section a b (Maxwell)."""
    per_turn = mu_0 * RADIUS * (np.log(8 * RADIUS / (0.2235 * 2e-3)) - 2)
    text = HEAD.replace("coil.loop.position_mm.3", "coil.loop.turns")
    text = text.replace("start = 0.0\nlower = -5.0\nupper = 5.0", "start = 1000.0\nprior = [1000.0, 100.0]")
    text += f"""
[[inductance]]
name = "bridge"
coils = [["loop", "loop"]]
measured_mH = [{1e3 * per_turn * 1100**2}]
deviation_mH = 0.02
"""
    asked = read_fit(fit_file(text))
    assert asked.labels["bridge"] == ("loop",)
    assert asked.unknowns[0].prior == (1000.0, 100.0)
    found = asked.run()
    assert found.values["coil.loop.turns"] == pytest.approx(1100, rel=1e-3)
    assert found.deviations["coil.loop.turns"] == pytest.approx(0.02e-3 / (2 * per_turn * 1100), rel=0.01)


def test_the_shipped_fit_has_the_numbers_that_its_readings_were_made_of():
    asked = read_fit("loop_and_sphere")
    assert asked.device_path.name == "loop_and_sphere.toml"
    found = asked.run()
    truth = {"coil.loop.position_mm.3": 25.4, "coil.loop.turns": 98.6}
    for key, value in truth.items():
        assert abs(found.values[key] - value) < 2 * found.deviations[key]
    assert found.tables[1].misfit < 2.5 < found.tables[1].misfit_before


MISTAKES = """format = 1
title = "Mistakes"
device = "thin_loop.toml"

[[unknown]]
key = "coil.loop.hight_mm"
start = 1.0

[[inductance]]
name = "bridge"
coils = [["loop", "lop"]]
measured_mH = [1.0, 2.0]
deviation_mH = 0.1

[[flux_density]]
name = "probe"
currents_A = [1.0, 2.0]
points_mm = [[0, 0, -70]]
measured_mT = [[0, 0, 1]]
deviation_mT = [0.1, 0.1]

[[lift_current]]
name = "lift"
positions_mm = [[0, 0, -90]]
measured_A = [1.0]
deviation_A = 0.1
shares = [1.0, 1.0]
"""
PLACES = [
    (6, "unknown.1.key"),
    (11, "inductance.bridge.coils.1"),
    (12, "inductance.bridge.measured_mH"),
    (17, "flux_density.probe.currents_A"),
    (20, "flux_density.probe.deviation_mT"),
    (27, "lift_current.lift.shares"),
]


def test_what_does_not_fit_the_device_is_told_by_line(fit_file):
    path = fit_file(MISTAKES)
    with pytest.raises(FitError) as caught:
        read_fit(path)
    found = [problem.where.removeprefix(f"{path}:") for problem in caught.value.problems]
    assert found == [f"{line}: {key}" for line, key in PLACES]
    assert "height_mm" in caught.value.problems[0].remedy
    assert '"loop"' in caught.value.problems[1].remedy


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("upper = 5.0", "upper = -1.0", "unknown.1"),
        ("upper = 5.0", "prior = [0.0, 0.0]", "unknown.1"),
        ("deviation_mT = [0.01, 0.01]", "deviation_mT = 0.0", "flux_density.probe fit.deviation_mT"),
        ('components = ["x", "z"]', 'components = ["z"]', "flux_density.probe fit"),
        ('components = ["x", "z"]', 'components = ["z", "z"]', "flux_density.probe fit"),
        ("currents_A = 2.0", 'currents_A = "two"', "flux_density.probe fit.currents_A"),
        ("currents_A = 2.0", "currents_A = [[2.0], 1.0]", "flux_density.probe fit.currents_A"),
        ("points_mm = [[0, 0, -70], ", "points_mm = [", "flux_density.probe fit"),
        ('device = "thin_loop.toml"', 'device = "thin_lop.toml"', "device"),
    ],
)
def test_mistakes_of_the_file_itself(fit_file, old, new, where):
    text = HEAD + probe("fit", [-70, -80])
    assert old in text
    with pytest.raises(FitError) as caught:
        read_fit(fit_file(text.replace(old, new)))
    (problem,) = caught.value.problems
    assert problem.where.endswith(f": {where}")


def test_a_fit_needs_readings(fit_file):
    with pytest.raises(InputError):
        read_fit(fit_file(HEAD)).run()


def bridge(pairs='[["loop", "loop"]]', measured="[50.0]", deviation="0.1"):
    return f"""
[[inductance]]
name = "bridge"
coils = {pairs}
measured_mH = {measured}
deviation_mH = {deviation}
"""


PROBE = probe("fit", [-70, -80])
OF_PROBE = "flux_density.probe fit"


@pytest.mark.parametrize(
    ("text", "old", "new", "wheres"),
    [
        (PROBE, "currents_A = 2.0", "currents_A = [2.0]", []),
        (PROBE, "currents_A = 2.0", "currents_A = [[2.0], [1.0]]", []),
        (PROBE, "currents_A = 2.0", "currents_A = [[2.0]]", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "currents_A = 2.0", "currents_A = [[2.0], [1.0], [1.0]]", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "currents_A = 2.0", "currents_A = [[2.0], [1.0, 3.0]]", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "currents_A = 2.0", "currents_A = [2.0, 1.0]", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "currents_A = 2.0", "currents_A = []", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "currents_A = 2.0", "currents_A = [[2.0], []]", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "currents_A = 2.0", "currents_A = [2.0, [1.0]]", [f"{OF_PROBE}.currents_A"]),
        (PROBE, "[0.01, 0.01]", "0.01", []),
        (PROBE, "[0.01, 0.01]", "[0.01]", [f"{OF_PROBE}.deviation_mT"]),
        (PROBE, "[0.01, 0.01]", "[0.01, 0.01, 0.01]", [f"{OF_PROBE}.deviation_mT"]),
        (PROBE, "[0.01, 0.01]", "[0.01, 0.0]", [f"{OF_PROBE}.deviation_mT"]),
        (PROBE, '"probe fit"', '"probe fit"\niron = 1', [f"{OF_PROBE}.iron"]),
        (bridge(), "", "", []),
        (bridge('[["loop", "loop"], ["loop", "loop"]]'), "", "", ["inductance.bridge.measured_mH"]),
        (bridge(measured="[1.0, 2.0]"), "", "", ["inductance.bridge.measured_mH"]),
        (bridge(deviation="[0.1, 0.1]"), "", "", ["inductance.bridge.deviation_mH"]),
        (bridge(deviation="[0.1]"), "", "", []),
        (bridge('[["loop"]]'), "", "", ["inductance.bridge.coils.1"]),
        (bridge() + bridge(), "", "", [""]),
        (lift("fit", [-85, -95]), "deviation_A = 0.01", "deviation_A = [0.01, 0.02]\nshares = [2.0]", []),
        (
            lift("fit", [-85, -95]),
            "deviation_A = 0.01",
            "deviation_A = [0.01]",
            ["lift_current.lift.deviation_A"],
        ),
        (lift("fit", [-85, -95]), "[[0, 0, -85], ", "[", ["lift_current.lift.measured_A"]),
    ],
)
def test_lists_of_readings_fit_the_device(fit_file, text, old, new, wheres):
    assert old in text
    path = fit_file(HEAD + text.replace(old, new))
    try:
        read_fit(path)
        found = []
    except FitError as error:
        found = [re.sub(r"^.*?fit\.toml(:\d+: )?", "", problem.where) for problem in error.problems]
    assert found == wheres


def test_unknowns_are_named_once_and_a_payload_is_there(fit_file, tmp_path):
    path = fit_file(HEAD + HEAD.split("\n\n", 1)[1] + PROBE)
    with refused(FitError, must_hold="every unknown is named once"):
        read_fit(path)
    device = tmp_path / "thin_loop.toml"
    device.write_text("\n\n".join(p for p in device.read_text().split("\n\n") if "[payload]" not in p))
    with refused(FitError, where="lift_current.lift", must_hold="[payload]"):
        read_fit(fit_file(HEAD + lift("fit", [-85])))


def test_labels_and_units_of_readings(fit_file):
    text = HEAD + probe("fit", [-70], '["z", "x"]') + bridge() + lift("predict", [-85])
    asked = read_fit(fit_file(text))
    assert asked.labels == {
        "probe fit": ("Bx at (0, 0, -70) mm", "Bz at (0, 0, -70) mm"),
        "bridge": ("loop",),
        "lift": ("at (0, 0, -85) mm",),
    }
    assert asked.units == {"probe fit": ("mT", 1e-3), "bridge": ("mH", 1e-3), "lift": ("A", 1.0)}
    table, line = asked.readings
    # The columns of readings follow their list of components.
    np.testing.assert_allclose(np.ravel(table.measured), [on_axis(-0.07), np.nan, 0.0])
    assert float(table.deviation[0]) == pytest.approx(1e-5)
    assert (line.measured.tolist(), float(line.deviation)) == ([0.05], 1e-4)
    assert [one.name for one in asked.predict] == ["lift"]


@pytest.mark.parametrize(("iron", "saturating"), [("", True), ('iron = { model = "linear" }', False)])
def test_how_iron_is_solved(fit_file, tmp_path, iron, saturating):
    """By the device's materials unless the file gives a model; at the file's refinement."""
    (tmp_path / "sphere.toml").write_text((DEVICES / "sphere_below_loop.toml").read_text())
    text = HEAD.replace("thin_loop", "sphere").replace("[[unknown]]", f"{iron}\n[[unknown]]")
    asked = read_fit(fit_file(text.replace("start = 0.0", "start = 3.0") + PROBE))
    field = asked.solve(fm.read_device(tmp_path / "sphere.toml"))
    assert isinstance(field, NonlinearSolver if saturating else LinearSolution)
    finer = text.replace("[[unknown]]", "iron.refinement = 1.5\n[[unknown]]", 1)
    if iron:
        finer = text.replace('"linear"', '"linear", refinement = 1.5')
    again = read_fit(fit_file(finer.replace("start = 0.0", "start = 3.0") + PROBE))
    fine = again.solve(fm.read_device(tmp_path / "sphere.toml"))
    faces = [len(one.surface.areas) if saturating else one.report.surface_faces for one in (field, fine)]
    assert faces[1] > 1.5 * faces[0]
