"""The printed pages: one golden file for each layout, from small fields and made-up results.

The values are tested with the functions that compute them. Here all numbers differ, so that an exchange of two is
noticed.
"""

import shlex
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.cli import main
from fieldmap.currents import CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device.model import Payload
from fieldmap.io.answers import Levitation
from fieldmap.io.map_summary import MapSummary, MiddleField
from fieldmap.iron.error import ErrorEstimate
from fieldmap.iron.report import SolverReport
from fieldmap.iron.summary import (
    BodyFlux,
    GroupForce,
    PointField,
    ReferenceComparison,
    SectionMean,
    SolutionSummary,
)
from fieldmap.levitation import ForceFit, LiftAtHeight, LiftCurrent, ShiftBesideMeasured
from fieldmap.store import FieldError, Grid, Provenance
from fieldmap.thesis import Comparison, PartResult
from tests.conftest import DEVICES, SCENARIOS

FILES = Path(__file__).parent / "files"
# No noise, and poles that differ along x and y.
SCENARIO = (
    (SCENARIOS / "step.toml")
    .read_text()
    .replace("linear_N_s_per_m = [0.3, 0.3, 0.3]", "linear_N_s_per_m = [0.3, 0.4, 0.5]")
    .replace("deviation_mm = [0.005, 0.008, 0.01]\n", "")
    .replace("duration_s = 1.0", "duration_s = 0.5")
    .replace("at_s = 0.2", "at_s = 0.1")
)


def readings():
    """A table of B = G r per ampere of a quadrupole at 2 A, with an error of alternating sign."""
    steps = np.linspace(-10.0, 10.0, 6)
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    flux = 2.0 * points @ np.diag([200.0, 200.0, -400.0])
    flux[:, 0] += 10.0 * (-1.0) ** np.arange(len(flux))
    rows = [",".join(f"{value:.6f}" for value in (*p, 2.0, *b)) for p, b in zip(points, flux, strict=True)]
    return "\n".join(["x_mm,y_mm,z_mm,I_loop_A,Bx_uT,By_uT,Bz_uT", *rows])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, circle_of_six, dipole_map, machine):
    """The working folder of the commands, so that printed paths are the same on every machine."""
    place = tmp_path_factory.mktemp("layouts")
    report = {"form": "potential", "tetrahedra": 12345, "surface_faces": 2468, "seconds": {"solve": 12.3}}
    about = {
        "title": "Field of six dipoles",
        "device_name": "drive_unit",
        "versions": {"fieldmap": "0.1.0", "numpy": "2.0.0"},
        "created": "2026-01-02 03:04:05 +0000",
        "solver_report": report,
        "assumptions": ("dipoles in the place of coils", "no remanence"),
    }
    recorded = (DEVICES / "recorded_by_six_dipoles.toml").read_text()
    dipole_map(circle_of_six, place / "six.h5", recorded, **about)
    (place / "everything.toml").write_text((DEVICES / "everything.toml").read_text())
    (place / "thin_loop.toml").write_text((DEVICES / "thin_loop_with_driver.toml").read_text())
    (place / "step.toml").write_text(SCENARIO)
    for name in ("turns.toml", "mistakes.toml"):
        (place / name).write_text((FILES / name).read_text())
    (place / "readings.csv").write_text(readings())
    return place


@pytest.fixture
def printed(folder, monkeypatch, capsys):
    """printed(*words): stdout of a command run in the folder, at a terminal width of 80."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)

    def run(*words, code=0):
        assert main([str(word) for word in words]) == code
        caught = capsys.readouterr()
        return caught.err if code == 2 else caught.out

    return run


# Golden file -> command line and exit code.
LAYOUTS = {
    "help": ("--help", 0),
    "help_of_equilibrium": ("equilibrium --help", 0),
    "check_device": ("check everything.toml", 0),
    "check_map": ("check six.h5", 0),
    "currents": ("currents six.h5 --at-mm 7 4 -100 --moment 0 0 0.8 --force nan 0.01 0.05 --limit 3", 0),
    "info_measured": ("info six.h5", 0),
    "probe": (
        "probe six.h5 --at-mm 1 2 -90 --at-mm 0 0 -80 --currents 1,1.1,1.2,1.3,1.4,1.5 --payload",
        0,
    ),
    "equilibrium_at_currents": ("equilibrium six.h5 --currents 4.4,4.2,4,4.1,4,3.9", 0),
    "equilibrium_at_a_height": ("equilibrium six.h5 --sensor-mm 10", 0),
    "solve_coils": ("solve thin_loop.toml --currents 2 --at-mm 1 0 -90", 0),
    "simulate": ("simulate step.toml --vary control.z.Kc=0.4,0.6 -o runs.h5", 0),
    "linearise": ("linearise step.toml --depths 9,11 -o linear.npz", 0),
    "study": ("study turns.toml -o turns.nc --no-plot", 0),
    "import": ("import readings.csv -o measured.h5 --spacing-mm 5 --degree 2", 0),
    "mistakes": ("check mistakes.toml", 2),
    "simulate_ended_early": (
        "simulate step.toml --set control.z.Kc=0.0 --set 'start.shift_mm=[0.0, 0.0, 1.0]' --set duration_s=20.0",
        1,
    ),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_page(printed, golden, name):
    line, code = LAYOUTS[name]
    golden(name, printed(*shlex.split(line), code=code))


def summary_of(domain, names, measured=False):
    """A made-up summary of a map over currents; measured: with measurements of its machine, of an older version, and
    less accurate than requested."""
    report = tomllib.loads((FILES / "report_over_currents.toml").read_text())
    if measured:
        tried = {"at random": report["states_tried"]["at random"]}
        report |= {"held_out_within": 1e-3, "states_tried": tried}
        del report["extremes"]
    record = Provenance(
        title="A map over currents",
        device_name="rig",
        created="2026-01-02 03:04:05 +0000",
        solver_report=report,
        assumptions=("no remanence",),
    )
    n = len(names)
    info = SimpleNamespace(
        provenance=record,
        grid=Grid([-0.01, -0.01, -0.12], [0.002, 0.002, 0.0025], (11, 11, 21)),
        coil_names=names,
        reference_current=np.arange(1.0, n + 1),
        interpolation_error=FieldError(1.2e-6, 3.4e-4),
        error_bounds={"harmonic": FieldError(5.6e-6, 7.8e-4)},
        current_error=FieldError(9.8e-6, 7.6e-4),
        reduced_model=SimpleNamespace(domain=domain),
        fixed_sources=(),
    )
    device = SimpleNamespace(driver=None, payload=Payload(0.010, 0.8))
    middle = MiddleField(np.array([0.0, 0.0, -0.095]), (0.0123456,), (-0.345678,))
    about = Path("over_currents.h5"), 1_230_000, info, device, middle
    if not measured:
        lift = (LiftAtHeight(-0.08, 1.234), LiftAtHeight(-0.10, 2.345), LiftAtHeight(-0.12, None, 2.5))
        return MapSummary(*about, lift, "")
    lift = (
        LiftAtHeight(-0.08, 3.234, None, 0.0, 1.2, 0.456),
        LiftAtHeight(-0.09, None, 3.55, 10.0, 1.4, 0.467),
        LiftAtHeight(-0.10, None, None, 20.0, 1.6),
    )
    fit = ForceFit(2.167, (1.222, 1.388, None), (0.0183, -0.0086, None))
    signals, shifted = np.array([0.1, 0.2, 0.3]), np.array([1e-3, 2.5e-3, np.nan])
    about_shift = ("Table 6-2", 1.25, 10.0, -0.09, 1.4, -8.8e-5, signals)
    shift = ShiftBesideMeasured(
        *about_shift,
        np.array([1.1e-3, 2.2e-3, 4.4e-3]),
        shifted,
        np.array([1.41, 1.52, np.nan]),
        1.5 * shifted,
    )
    return MapSummary(*about, lift, "(7-18)", fit, (shift,))


LEFT_RIGHT = IndependentCurrents(2), np.array([0.5, -1.0]), np.array([2.0, 3.0])
DIVISION = LiftAndDirections(1.25, 3.55), np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3])


@pytest.mark.parametrize(
    ("name", "domain", "names"),
    [
        ("info_over_currents", LEFT_RIGHT, ("left", "right")),
        ("info_over_lift_and_directions", DIVISION, tuple("123456")),
    ],
)
def test_info_of_a_map_over_currents(printed, golden, monkeypatch, name, domain, names):
    summary = summary_of(CurrentDomain(*domain), names, measured=len(names) == 6)
    monkeypatch.setattr("fieldmap.io.map_summary.summarise_map", lambda path: summary)
    golden(name, printed("info", "over_currents.h5"))


def test_equilibrium_of_states(printed, golden, monkeypatch):
    """The intermediate states, and a driver limited below the lift current."""

    def lifted(source, payload, height, on_state):
        found = LiftCurrent(
            current=4.2,
            currents=np.array([4.2]),
            position=np.array([0.0, 0.0, height]),
            force=np.array([0.0011, 0.0022, 0.0981]),
            force_per_ampere=np.array([0.001, 0.002, 0.0335]),
            stiffness=np.diag([1.1, 1.2, -2.3]),
            held="moment down, fixed",
            field=np.array([0.001, 0.002, 0.0123]),
            volume_error=0.0,
            assumptions=("states of saturating iron",),
            history=((1.0, 0.0335), (4.0, 0.0971), (4.2, 0.0981)),
        )
        return Levitation(source, payload, found, found.assumptions)

    monkeypatch.setattr("fieldmap.io.answers.lifted", lifted)
    golden("equilibrium_of_states", printed("equilibrium", "thin_loop.toml", "--height-mm", "-87"))


REPORT = tomllib.loads((FILES / "solver_report.toml").read_text())
ERROR = ErrorEstimate(0.012, 0.034, (0.0056, 0.0078), (0.0091, 0.011))


def solution_of(device, nonlinear):
    """A made-up summary with different numbers throughout."""
    at = np.array([0.001, 0.002, -0.014])
    gradient = np.arange(1.0, 10.0).reshape(3, 3) / 100.0
    law = REPORT["state"] if nonlinear else REPORT["linear"] | {"error": ERROR}
    report = SolverReport(**REPORT["report"], **law)
    values = {"at": at, "currents": np.array([1.0, 0.0, 0.0]), "source": "a closed form"}
    other = {"ours": None, "deviation": None, "tolerance": None}
    references = (
        ReferenceComparison("Bz", reference=0.00123, mu_r=None, ours=0.00124, deviation=0.0081301, why_not="",
                            tolerance=1e-3, **values),
        ReferenceComparison("dBz/dz", reference=0.123, mu_r=4000.0, why_not="linear iron, --mu-r 4000",
                            **other, **values),
        ReferenceComparison("Bx", reference=0.1, mu_r=None, why_not="other currents than this state's",
                            **other, **values),
        ReferenceComparison("By", reference=0.2, mu_r=None, why_not="other currents than this state's",
                            **other, **values),
    )  # fmt: skip
    return SolutionSummary(
        device=device,
        nonlinear=nonlinear,
        report=report,
        currents=np.array([1.0, 2.0, 3.0]),
        points=(PointField(at, np.array([0.001, -0.002, 0.0031]), gradient),),
        bodies=(BodyFlux("disk", 1.234, 1.987, np.array([0.1, -0.2, 1.2])),) if nonlinear else (),
        forces=(GroupForce(("disk", "collar"), np.array([0.1, 0.2, -3.4]), np.array([0.005, 0.006, 0.007])),),
        sections=(SectionMean("across", 1.234567, 8.9e-5, 7.2e-5, 8.1e-7),),
        references=references,
        warnings=() if nonlinear else ("warning: iron up to 3.9 T",),
    )


@pytest.mark.parametrize("words", [(), ("--nonlinear", "--currents", "1,2,3")], ids=["linear", "state"])
def test_solve(printed, golden, monkeypatch, words):
    def summarised(device, *rest):
        return solution_of(device, bool(words))

    monkeypatch.setattr("fieldmap.io.solve_device", lambda *given: None)
    monkeypatch.setattr("fieldmap.iron.materials.require_soft_bodies", lambda device: None)
    monkeypatch.setattr("fieldmap.iron.summary.summarise_solution", summarised)
    golden("solve_state" if words else "solve_linear", printed("solve", "everything.toml", *words))


def comparison(name, thesis, ours, kind, agrees=None, misprint="", place="Table 2-2"):
    return Comparison(
        "S3", name, f"the {name}", "A m2", thesis, ours, ours / thesis - 1, kind, agrees, misprint, place,
        "Magnets", ("a cylinder", "no remanence"),
    )  # fmt: skip


def test_thesis(printed, golden, monkeypatch):
    numbers = (
        comparison("sphere_moment", 0.000542, 0.0005419, "sharp", agrees=True),
        comparison(
            "lift", 1.25, 1.375, "model", place="Fig. 4-7, read from the plot at the middle of its x axis"
        ),
        comparison("mass", 2.0, 25.0, "measured"),
        comparison("volume", 3.0, 4.0, "sharp", agrees=False, misprint="its exponent is wrong"),
    )
    results = [
        PartResult("S3", "Magnets", numbers, explanations={"": "All of it.", "lift": "Iron."}),
        PartResult("S10", "A map", problem="map missing", remedy="fieldmap map quick", map="quick"),
    ]
    monkeypatch.setattr("fieldmap.thesis.plan.computed", lambda *given: iter(results))
    golden("thesis", printed("thesis"))
