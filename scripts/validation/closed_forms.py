"""Spheres, a shell, cylinders and a sphere under a coil: fields in closed form."""

from collections.abc import Iterator

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Body, Cylinder, Device, LinearMaterial, Part, Sphere
from fieldmap.iron import generate_mesh
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.operators.assembled import AssembledIron, assemble
from validation.row import Array, Row, timed

FORMS = {"potential": PotentialForm, "flux": FluxForm}
UP = np.array([0.0, 0.0, 1.0])
RADIUS = 0.05
OUTSIDE = np.array([[0.06, 0, 0], [0, 0, 0.06], [0.04, 0.03, 0.04], [0.1, 0.02, 0.03], [0, 0.07, -0.02]])
# Volume-averaged axial factors by length/diameter, at small susceptibility.
AXIAL_FACTOR = {1.0: 0.3116, 0.2: 0.6802}


def spheres() -> Iterator[Row]:
    """A sphere in a uniform field, which is a dipole outside. Errors are relative to the local field."""
    iron = _assembled(Body("ball", "iron", (Part(Sphere(RADIUS)),), 0.007))
    distance = np.linalg.norm(OUTSIDE, axis=1)[:, None]
    unit = (3 * OUTSIDE * OUTSIDE[:, 2:] / distance**2 - UP) * (RADIUS / distance) ** 3
    for form, make in FORMS.items():
        solver = make(iron)
        for mu in (1e-4, 2.0, 10.0, 1e3, 1e6) if form == "flux" else (2.0, 10.0, 1e3, 1e6):
            state, wall, cpu = timed(lambda mu=mu, solver=solver: in_uniform_field(solver, mu))
            exact = (mu - 1) / (mu + 2) * unit
            error = np.linalg.norm(state.faces.field(OUTSIDE, state.density)[0] - exact, axis=1)
            worst = float((error / np.linalg.norm(exact + UP, axis=1)).max())
            faces = len(iron.surface.areas)
            yield Row(
                f"sphere, mu_r {mu:g}, {form} form",
                "error of B",
                worst,
                2e-3,
                "dipole, Jackson 5.11",
                faces,
                state.iterations,
                wall,
                cpu,
            )


def shell() -> Iterator[Row]:
    """a/b = 0.8, mu_r 1000: the weak field in the hollow."""
    mu, ratio = 1000.0, 0.8
    hollow = np.array([[0, 0, 0.0], [0.02, 0, 0], [0, 0.01, 0.02], [-0.01, 0.02, -0.01]])
    exact = 9 * mu / ((2 * mu + 1) * (mu + 2) - 2 * ratio**3 * (mu - 1) ** 2)
    for form, size in (("potential", 0.01), ("flux", 0.01)):
        parts = (Part(Sphere(RADIUS)), Part(Sphere(ratio * RADIUS), operation="cut"))
        iron = _assembled(Body("shell", "iron", parts, size))
        state, wall, cpu = timed(lambda form=form, iron=iron: in_uniform_field(FORMS[form](iron), mu, 1e-9))
        field = state.faces.field(hollow, state.density)[0] + UP
        error = float(np.abs(field / exact - UP).max())
        yield Row(
            f"shielding shell, {form} form",
            "error of B inside",
            error,
            1e-2,
            "Jackson 5.121",
            len(iron.surface.areas),
            state.iterations,
            wall,
            cpu,
        )


def cylinders() -> Iterator[Row]:
    """Demagnetising factor N of cylinders of weak susceptibility chi: <B>/B0 = 1 + chi (1 - N)."""
    chi = 1e-3
    for slenderness, exact in AXIAL_FACTOR.items():
        shape = Cylinder(0.01, 0.02 * slenderness)
        iron = _assembled(Body("rod", "iron", (Part(shape),), 0.003, 0.0005))
        state, wall, cpu = timed(lambda iron=iron: in_uniform_field(FluxForm(iron), 1 + chi, 1e-9))
        volume = FluxForm(iron).elements.volume
        mean = float((volume @ state.flux_density[0] / volume.sum())[2])
        factor = 1 - (mean - 1) / chi
        source = "Chen, Brug and Goldfarb, IEEE Trans. Magn. 27 (1991) 3601, table I"
        yield Row(
            f"cylinder, length/diameter {slenderness:g}, flux form",
            "error of N",
            factor / exact - 1,
            3e-3,
            source,
            len(iron.surface.areas),
            state.iterations,
            wall,
            cpu,
        )


def sphere_and_coil() -> Iterator[Row]:
    """The shipped device with reference values from a Legendre series in its file."""
    for form in FORMS:
        yield from device_file("loop_and_sphere", 1000.0, form, 1e-3, 1e-3)


def device_file(
    name: str, mu_r: float, form: str, field_bound: float | None, gradient_bound: float | None
) -> Iterator[Row]:
    """A shipped device against the reference values of its own file."""
    device = fm.read_device(name)
    unit, wall, cpu = timed(lambda: fm.solve_linear(device, mu_r=mu_r, form=form))
    worst = {"B": 0.0, "gradient": 0.0}
    for known in device.references:
        what = "gradient" if known.quantity.startswith("d") else "B"
        ours = (unit.gradient if what == "gradient" else unit.field)(known.at, known.currents)
        place = tuple("xyz".index(letter) for letter in known.quantity if letter in "xyz")
        worst[what] = max(worst[what], float(ours[place]) / known.value - 1, key=abs)
    bounds = {"B": field_bound, "gradient": gradient_bound}
    for what, value in worst.items():
        yield Row(
            f"{name}, {form} form",
            f"error of {what}, signed",
            value,
            bounds[what],
            f"{device.references[0].source} (geometry/{name}.toml)",
            unit.report.surface_faces,
            unit.report.iterations,
            wall,
            cpu,
        )


def _assembled(body: Body) -> AssembledIron:
    return assemble(generate_mesh(Device("d", "", (), (body,), {"iron": LinearMaterial("iron", 1.0)})))


def in_uniform_field(solver: PotentialForm | FluxForm, mu_r: float, tolerance: float = 1e-7) -> IronState:
    """State of one body of constant mu_r in a field of 1 T along z."""

    def applied(x: Array) -> Array:
        return np.broadcast_to(UP, (1, *x.shape))

    count = len(solver.elements.volume)
    law = law_tables([LinearMaterial("iron", mu_r)])
    material = Magnetisation(np.zeros(count, np.int64), law, np.zeros((1, count, 3)))
    return solver.solve_linear(material, solver.elements.coil_field(applied), tolerance).iron
