"""Iron in a constant background field against closed forms: fields, forces, linkages, saturation."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.optimize import brentq

import fieldmap as fm
from fieldmap.device.model import (
    Background,
    Body,
    Box,
    CircularCoil,
    Cylinder,
    Device,
    Froehlich,
    LinearMaterial,
    PermanentMagnet,
    Sphere,
    WorkspaceBox,
    placed,
)

R, MU = 0.01, 50.0
FLUX = np.array([0.01, -0.02, 0.05])
FIVE = [0.4, 0.1, 0.2, -0.1, 0.3]
POINTS = np.random.default_rng(3).uniform([-8e-3, -8e-3, -24e-3], [8e-3, 8e-3, -14e-3], (40, 3))


def sphere(background, coils=(), material=None, mesh_size=1.5e-3):
    body = Body("sphere", "iron", Sphere(R), mesh_size)
    laws = {"iron": material or LinearMaterial("iron", MU)}
    return Device("sphere", "", coils, [body], laws, background=background)


def exact(points, background, mu_r=MU):
    """Field outside a sphere at the origin in B0 + G x: a dipole and a quadrupole answer."""
    flux, tensor = background.field(np.zeros((1, 3)))[0], background.tensor
    r = np.linalg.norm(points, axis=1)[:, None]
    n, along = points / r, points @ tensor
    dipole = (mu_r - 1) / (mu_r + 2) * R**3 * (3 * n * (n @ flux)[:, None] - flux) / r**3
    twice = np.einsum("ni,ni->n", along, points)[:, None]
    share = -2 * (mu_r - 1) / (2 * mu_r + 3) * R**5
    return background.field(points) + dipole + share * (along / r**5 - 2.5 * twice * points / r**7)


@pytest.mark.parametrize("name", ["sphere_in_field", "shell_in_field"])
def test_shipped_devices_agree_with_their_closed_forms(name):
    device = fm.read_device(name)
    unit = fm.solve_linear(device)
    assert device.coil_names == ()
    assert not unit.proportional
    # The largest value of B, and of its slopes if the file has any.
    size = [
        max((abs(k.value) for k in device.references if ("/" in k.quantity) == slope), default=0.0)
        for slope in (0, 1)
    ]
    for reference in device.references:
        axes = ["xyz".index(letter) for letter in reference.quantity if letter in "xyz"]
        slope = len(axes) == 2
        found = (unit.gradient if slope else unit.field)(reference.at, [])[tuple(axes)]
        assert abs(found - reference.value) < (1e-3 if slope else 2e-4) * size[slope]


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_both_forms_answer_a_uniform_field_and_a_gradient(form):
    background = Background(FLUX, FIVE)
    unit = fm.solve_linear(sphere(background, mesh_size=2e-3), form=form)
    truth = exact(POINTS, background)
    assert np.abs(unit.field(POINTS, []) - truth).max() < 3e-4 * np.abs(truth).max()
    flux, slope = unit.constant_fields(POINTS)
    assert flux == pytest.approx(unit.field(POINTS, []), rel=1e-12)
    step = 1e-4 * np.eye(3)
    moved = [(exact(POINTS + h, background) - exact(POINTS - h, background)) / 2e-4 for h in step]
    assert np.abs(slope - np.stack(moved, axis=-1)).max() < 3e-3 * np.abs(moved).max()


def test_the_centre_shifts_the_field():
    one = Background(FLUX, FIVE, [0.01, 0.02, 0.03])
    other = Background(one.field(np.zeros((1, 3)))[0], FIVE)
    first, second = (fm.solve_linear(sphere(b, mesh_size=4e-3)).field(POINTS, []) for b in (one, other))
    assert first == pytest.approx(second, rel=1e-9)


def test_coil_and_background_superpose_in_linear_iron():
    coil = CircularCoil("1", 0.028, 0.032, 0.004, 100.0, placement=placed([0.0, 0.0, 0.02]))
    background = Background(FLUX, FIVE)
    both = fm.solve_linear(sphere(background, [coil], mesh_size=3e-3))
    coil_alone = fm.solve_linear(sphere(None, [coil], mesh_size=3e-3))
    without = fm.solve_linear(sphere(background, mesh_size=3e-3))
    total = coil_alone.field(POINTS, [3.0]) + without.field(POINTS, [])
    assert both.field(POINTS, [3.0]) == pytest.approx(total, abs=2e-4 * np.abs(total).max())
    assert both.unit_fields(POINTS)[0][0] == pytest.approx(coil_alone.unit_fields(POINTS)[0][0], abs=1e-8)
    change = both.field(POINTS, [3.0]) - both.field(POINTS, [0.0])
    assert change == pytest.approx(3.0 * both.unit_field(POINTS)[:, 0], rel=1e-9, abs=1e-15)


def test_saturating_sphere_is_magnetised_uniformly():
    law = Froehlich("iron", mu_r=200.0, saturation=1.2)
    flux = np.array([0.3, 0.0, 0.9])
    device = sphere(Background(flux), material=law, coils=[far_coil()], mesh_size=2.5e-3)
    state = fm.solve(device, [0.0], tolerance=1e-4)
    chi, saturation, applied = 199.0, 1.2, float(np.linalg.norm(flux))

    def polarisation(b):  # b = mu0 H
        return chi * b / (1 + chi * b / saturation)

    # mu0 H inside = B0 - J/3.
    inside = brentq(lambda b: b + polarisation(b) / 3 - applied, 0.0, applied)
    moment = polarisation(inside) / mu_0 * 4 / 3 * np.pi * R**3 * flux / applied
    r = np.linalg.norm(POINTS, axis=1)[:, None]
    n = POINTS / r
    truth = flux + mu_0 / (4 * np.pi) * (3 * n * (n @ moment)[:, None] - moment) / r**3
    assert np.abs(state.field(POINTS) - truth).max() < 5e-4 * np.abs(truth).max()
    mean = (inside + polarisation(inside)) * flux / applied
    assert state.flux_density("sphere") == pytest.approx(mean, abs=2e-3 * applied)


def far_coil():
    return CircularCoil("far", 0.02, 0.025, 0.004, 100.0, placement=placed([0.0, 0.0, 0.05]))


def test_both_solvers_give_the_same_state_of_linear_iron():
    background = Background(FLUX, FIVE)
    device = sphere(background, [far_coil()], mesh_size=3e-3)
    linear, other = fm.solve_linear(device).at([2.0]), fm.solve(device, [2.0], tolerance=1e-4)
    for one, two in (
        (linear.field(POINTS), other.field(POINTS)),
        (linear.gradient(POINTS), other.gradient(POINTS)),
        (linear.force_on("sphere"), other.force_on("sphere")),
        (linear.force_on("far"), other.force_on("far")),
        (linear.flux_linkage(), other.flux_linkage()),
    ):
        assert one == pytest.approx(two, abs=2e-5 * np.abs(two).max())


def test_force_and_torque_of_the_background():
    background = Background(FLUX, FIVE)
    soft = fm.solve_linear(sphere(background, mesh_size=2.5e-3)).at([])
    moment = (MU - 1) / (MU + 2) * 4 * np.pi * R**3 / mu_0 * FLUX
    force = background.tensor @ moment
    assert soft.force_on("sphere") == pytest.approx(force, abs=2e-3 * np.abs(force).max())
    remanence = np.array([0.3, 0.5, -1.0])
    hard = PermanentMagnet("iron", remanence, 1.0)
    magnet = fm.solve_linear(sphere(background, material=hard, mesh_size=2.5e-3)).at([])
    moment = remanence / mu_0 * 4 / 3 * np.pi * R**3
    force, torque = background.tensor @ moment, np.cross(moment, FLUX)
    assert magnet.force_on("sphere") == pytest.approx(force, abs=3e-3 * np.abs(force).max())
    found = magnet.torque_on("sphere", [0.0, 0.0, 0.0])
    assert found == pytest.approx(torque, abs=3e-3 * np.abs(torque).max())


def test_force_and_torque_on_a_coil_and_its_linkage():
    coil = CircularCoil("1", 0.028, 0.032, 0.004, 100.0, placement=placed([0.0, 0.01, 0.02], [30.0, 0, 0]))
    background = Background(FLUX, FIVE)
    state = fm.solve_linear(Device("air", "", coils=[coil], background=background)).at([2.0])
    axis = coil.placement.rotation[:, 2]
    # Mean square of the turns' radius, times the turns.
    area = np.pi * (0.028**2 + 0.028 * 0.032 + 0.032**2) / 3 * 100.0
    place = coil.placement.position
    at_centre = background.field(place[None])[0]
    linkage = state.flux_linkage()[0] - state.solution.inductance()[0, 0] * 2.0
    assert linkage == pytest.approx(area * axis @ at_centre, rel=1e-6)
    moment = 2.0 * area * axis
    assert state.force_on("1") == pytest.approx(background.tensor @ moment, rel=1e-6)
    # About its own centre a coil in a gradient has only the torque of its moment: the torque of the gradient cancels.
    assert state.torque_on("1", place) == pytest.approx(np.cross(moment, at_centre), rel=1e-6)


def test_linkage_is_the_derivative_of_the_coenergy():
    law = Froehlich("iron", mu_r=200.0, saturation=1.2)
    device = sphere(Background(20 * FLUX), material=law, coils=[far_coil()], mesh_size=4e-3)
    solver = fm.iron.NonlinearSolver(device, tolerance=1e-6)
    low, middle, high = (solver.at([i]) for i in (9.5, 10.0, 10.5))
    slope = high.coenergy() - low.coenergy()
    assert middle.flux_linkage()[0] == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("flux", [[0.0, 0.0, 0.3], [0.2, 0.0, 0.1]])
def test_images_of_states_are_states(flux):
    """The symmetry of the iron counts only as far as the background has it too."""
    law = Froehlich("iron", mu_r=200.0, saturation=1.2)
    coils = CircularCoil("c", 0.004, 0.008, 0.012, 200.0).moved([0.02, 0.0, 0.0]).around("z", 2)
    plate = Body("plate", "iron", Box((0.06, 0.02, 0.004)), 4e-3).moved([0.0, 0.0, 0.01])
    device = Device("pair", "", coils, [plate], {"iron": law}, background=Background(flux))
    solver = fm.iron.NonlinearSolver(device, tolerance=1e-5)
    state = solver.solve([8.0, 1.0], 1e-5)
    below = np.array([[0.01, 0.005, -0.02], [-0.02, 0.0, -0.02]])
    for image in solver.images:
        currents = image.currents(state.currents)
        fresh = solver.solve(currents, 1e-5)
        charge = solver.charge_density(image.potential(state.state.potential))
        assert charge[0] == pytest.approx(fresh.iron.density[0], abs=1e-4 * np.abs(fresh.iron.density).max())
        assert fresh.field(below).shape == (2, 3)
    assert bool(solver.images) is (flux[0] == 0.0)


def test_error_estimate_counts_what_no_current_drives():
    """A magnet and a piece of iron without a coil: the estimate is for the constant field."""
    bodies = [
        Body("magnet", "hard", Cylinder(0.01, 0.01), 8e-3),
        Body("iron", "iron", Box((0.01, 0.01, 0.01)), 8e-3).moved([0.03, 0.0, 0.0]),
    ]
    laws = [PermanentMagnet("hard", [0.0, 0.0, 1.0], 1.05), LinearMaterial("iron", 500.0)]
    space = WorkspaceBox([-5e-3, -5e-3, -24e-3], [5e-3, 5e-3, -14e-3])
    device = Device("pair", "", (), bodies, {law.name: law for law in laws}, workspace=space)
    solution = fm.solve_to_tolerance(device, 2e-2, gradient_tolerance=0.1)
    assert 0.0 < solution.report.error.flux_density <= 2e-2
