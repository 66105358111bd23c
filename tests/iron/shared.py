"""Devices and closed forms that several iron tests use."""

import numpy as np
from scipy.constants import mu_0
from scipy.special import comb

import fieldmap as fm
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble

STEEL = fm.BHTable(
    "iron",
    np.array([200.0, 400.0, 1000.0, 3000.0, 1e4, 1e5]),
    np.array([0.7, 1.1, 1.45, 1.65, 1.85, 2.3]),
    "straight line to the origin",
    "slope mu0",
    2785.0,
)
FOOT = fm.BHTable(
    "foot",
    np.array([20.0, 60.0, 150.0, 200.0, 300.0, 600.0, 2e3, 1e4]),
    np.array([0.002, 0.015, 0.08, 0.4, 0.95, 1.3, 1.55, 1.8]),
    "straight line to the origin",
    "towards saturation",
    79.6,
    2.16,
)
"""A law whose relative permeability is 80 at H = 0, then 200, 400, 1600, 3000 and less again."""


def at(x, y, z):
    """Placement at a position in m, without rotation."""
    return fm.placed((x, y, z))


def iron_of(*bodies):
    """The iron of bodies on one mesh; the materials are given to the solve later."""
    materials = {body.material: fm.LinearMaterial(body.material, 1.0) for body in bodies}
    return assemble(generate_mesh(fm.Device("d", "", (), bodies, materials)))


def in_uniform_field(form, laws, flux, tolerance=1e-8, remanence=(0.0, 0.0, 0.0)):
    """State of the iron of a form in a uniform field (3,), T; laws: one for each body, all with the same remanence."""
    body = form.iron.mesh.body
    material = Magnetisation(body, law_tables(laws), np.tile(remanence, (1, len(body), 1)).astype(float))
    field = form.elements.coil_field(lambda x: np.broadcast_to(np.asarray(flux, float), (1, *x.shape)))
    solve = form.solve if any(law.saturates for law in laws) else form.solve_linear
    return solve(material, field, tolerance).iron


def dipole(points, moment):
    """Field of mu0/(4 pi) times a moment (3,) at the origin: (3 (m.r) r / r^2 - m) / r^3."""
    r = np.linalg.norm(points, axis=1)[:, None]
    return (3 * points * (points @ moment)[:, None] / r**2 - moment) / r**3


def core_and_coils(material=None, shift=0.0, magnet=False):
    """A core with a coil around it, a second coil to one side, and a magnet aside on request; a workspace below."""
    coils = (
        fm.CircularCoil("around", 0.006, 0.010, 0.02, 200.0, placement=at(0, 0, 0.015 + shift)),
        fm.CircularCoil("beside", 0.005, 0.008, 0.01, 100.0, -1, placement=at(0.015, 0.004, 0.04)),
    )
    bodies = [fm.Body("core", "iron", fm.Cylinder(0.005, 0.03), 0.005)]
    materials = {"iron": material or fm.LinearMaterial("iron", 500.0)}
    if magnet:
        bodies.append(fm.Body("magnet", "magnet", fm.Box((0.01, 0.01, 0.01)), 0.005).moved([-0.03, 0, 0]))
        materials["magnet"] = fm.PermanentMagnet("magnet", np.array([0.0, 0.3, 1.0]), 1.05)
    cut = fm.Section("middle", np.array([0.0, 0.0, 0.015]), np.array([0.0, 0.0, 1.0]), ("core",))
    space = fm.WorkspaceCylinder(np.array([0.0, 0.001, -0.012]), 0.004, 0.008)
    return fm.Device("core", "", coils, tuple(bodies), materials, workspace=space, sections=(cut,))


def electromagnet(material, disk_size=0.01, core_size=0.01):
    """A disk with a core in a coil, coarse."""
    disk = fm.Body("disk", "iron", fm.Cylinder(0.03, 0.006), disk_size, 0.003)
    core = fm.Body("core", "iron", fm.Cylinder(0.01, 0.04), core_size, 0.003).moved([0, 0, 0.006])
    coil = fm.CircularCoil("coil", 0.011, 0.021, 0.039, 840.0, placement=at(0, 0, 0.026))
    return fm.Device("electromagnet", "", (coil,), (disk, core), {"iron": material})


RING = 0.018, 0.022, 0.004
"""Inner and outer radius and height, m, of the ring of `toroid`."""


def toroid(material, size=0.004, sections=()):
    """An iron ring linked with six coils of ten turns around it: a closed circuit with hardly any leakage flux."""
    coils = []
    for angle in np.pi / 3 * np.arange(6):
        out, along = np.array([np.cos(angle), np.sin(angle), 0]), np.array([-np.sin(angle), np.cos(angle), 0])
        place = fm.Placement(0.02 * out, np.column_stack([out, [0, 0, -1.0], along]))
        coils.append(fm.CircularCoil(f"{len(coils)}", 0.006, 0.008, 0.003, 10.0, placement=place))
    ring = fm.Body("ring", "iron", fm.Ring(*RING), size).moved([0, 0, -RING[2] / 2])
    return fm.Device("d", "", tuple(coils), (ring,), {"iron": material}, sections=sections)


def sphere_inductance(height=0.025, radius=0.01, mu_r=1000.0, turns=100, terms=60):
    """Inductance that a sphere adds to a coaxial coil: its response to every multipole of a loop, linked with the loop.
    Flux of P_n through the cap of angle alpha: 2 pi d^2 sin(alpha) P_n^1(cos alpha) / (n (n + 1)) times the radial
    field; with b_n of geometry/loop_and_sphere.toml, L = pi mu0 R sum -b_n (sin(alpha) P_n^1)^2 (R/d)^2n / n^2,
    averaged over the winding's section."""
    x = np.array([-1, 1]) / np.sqrt(3)
    r, z = (grid.ravel() for grid in np.meshgrid(0.03 + 5e-4 * x, height + 5e-4 * x, indexing="ij"))
    d, cosine = np.hypot(r, z), z / np.hypot(r, z)
    total = 0.0
    for n in range(1, terms):
        legendre = np.polynomial.legendre.Legendre.basis(n).deriv()(cosine)
        strength = (1 - cosine**2) * legendre * (radius / d) ** n
        total += (mu_r - 1) / (n * (n * mu_r + n + 1)) * np.mean(strength) ** 2
    return np.pi * mu_0 * radius * turns**2 * total


def moments_of_two_spheres(mu_r, distance, count=80):
    """Multipoles (count,) of order 1, 2, ... of the lower of two equal spheres of radius 1 in a field of 1 along their
    axis. The multipoles of the upper sphere are re-expanded about the lower one, P_n(cos t') / r'^(n+1) = sum (-1)^n
    C(n+m, n) r^m P_m(cos t) / d^(n+m+1), and a sphere answers r^m P_m by -m (mu - 1) / (m (mu + 1) + 1)."""
    n = np.arange(1, count + 1)
    order, other = n[:, None], n[None, :]
    answer = n * (mu_r - 1) / (n * (mu_r + 1) + 1)
    # By symmetry the upper sphere has B_n = (-1)^(n+1) A_n.
    between = -comb(order + other, other) * distance ** -(order + other + 1.0)
    return np.linalg.solve(np.eye(count) + answer[:, None] * between, np.where(n == 1, answer, 0.0))
