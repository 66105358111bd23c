"""The iron's reaction to magnets against images, closed series, and the magnet meshed with the iron."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

import fieldmap as fm
from fieldmap.constants import MU0
from fieldmap.device.air_sources import AirSource
from fieldmap.iron.solvers.linear import solve_linear_and_reaction
from fieldmap.lookup import magnetic_body
from fieldmap.reaction import own_reaction
from validation.row import Array, Row, timed

FLUX_DENSITY, FORCE, TORQUE, STIFFNESS = 5e-3, 5e-3, 5e-3, 5e-3
"""Allowed relative errors of A, and of force, torque and stiffness of a dipole."""
PULL, THIRD_LAW = 1e-2, 1e-3
MAGNET_READ, DIPOLE_READ = 5e-3, 1e-4
"""Allowed errors of readings, relative to the largest reading."""
PERMEABILITIES = (2.0, 10.0, 10_000.0)
# Orders of the closed series.
_ORDERS = np.arange(1, 300)[:, None]
_SCALE = MU0 / (4 * np.pi)


def reaction() -> Iterator[Row]:
    """A dipole over a plate, beside a ball, in a shell; a levitator at ten places; payloads near a wide core."""
    for mu_r in PERMEABILITIES:
        yield from _closed("plate", _plate(mu_r), _over_a_plate(mu_r), np.array([0.015, 0.017, 0.02]), mu_r)
        yield from _closed("ball", _ball(mu_r), _beside_a_ball(mu_r), np.array([0.035, 0.038, 0.044]), mu_r)
        yield from _closed("shell", _shell(mu_r), _in_a_shell(mu_r), np.array([0.006, 0.008, 0.0095]), mu_r)
    yield from _levitator()
    yield from _near_a_wide_core()


Exact = Callable[[Array], Array]
"""Function of distances (n,), m, that returns (6, n): A along the axis, T/(A m^2), its first and second derivative by
the distance; and the same across the axis."""


def _closed(case: str, device: fm.Device, exact: Exact, distances: Array, mu_r: float) -> Iterator[Row]:
    """Rows for dipoles on the z axis: force and stiffness from A by F = dA/dz / 2, torque m_x m_z (A_xx - A_zz)."""
    (_, found, _), seconds, cpu = timed(lambda: solve_linear_and_reaction(device, box=device.bounds))
    assert found is not None
    points = np.column_stack([0.0 * distances, 0.0 * distances, distances])
    b, g = found.fields(points)
    second = found.second_gradient(points)
    along, first, bend = exact(distances).reshape(2, 3, -1).swapaxes(0, 1)
    ours = np.zeros((3, 2, len(distances)))
    for k, axis in enumerate((2, 0)):
        m, dm, ddm = b[:, :, axis], g[:, :, axis, 2], second[:, :, axis, 2, 2]
        ours[:, k] = [found.signs @ (m * m), found.signs @ (m * dm), found.signs @ (dm * dm + m * ddm)]
    # Torque about y on a dipole that is tilted by 40 degrees.
    tilted = np.array([np.sin(np.radians(40)), 0.0, np.cos(np.radians(40))])
    turning = np.cross(tilted, own_reaction(found, points, tilted)[0])[:, 1]
    cost = (len(found.faces.areas), 0, seconds, cpu, f"{len(found.charge)} fields")
    names = ("A", FLUX_DENSITY), ("force", FORCE), ("stiffness", STIFFNESS)
    for (name, bound), mine, true in zip(names, ours, (along, first / 2, bend / 2), strict=True):
        off = float(np.abs(mine / true - 1.0).max())
        yield Row(f"{case}, mu_r {mu_r:g}", f"{name} of a dipole", off, bound, _SOURCES[case], *cost)
    off = float(np.abs(turning / (tilted[0] * tilted[2] * (along[1] - along[0])) - 1.0).max())
    yield Row(f"{case}, mu_r {mu_r:g}", "torque on a tilted dipole", off, TORQUE, _SOURCES[case], *cost)
    name = f"{case}, mu_r {mu_r:g}"
    yield Row(name, "asymmetry of the solves", found.asymmetry, None, "reciprocity", *cost)


_SOURCES = {"plate": "image in a half-space", "ball": "spherical harmonics", "shell": "spherical harmonics"}


def _device(
    name: str, mu_r: float, box: tuple[Array, Array], *bodies: tuple[tuple[fm.Part, ...], float]
) -> fm.Device:
    """A device with bodies from pairs of parts and mesh size."""
    named = (fm.Body(f"{name} {k}", "iron", parts, size) for k, (parts, size) in enumerate(bodies))
    ring = fm.CircularCoil("1", 0.2, 0.25, 0.05, 100.0, placement=fm.Placement([0.0, 0.0, 0.3]))
    iron = {"iron": fm.LinearMaterial("iron", mu_r)}
    return fm.Device(name, "", (ring,), tuple(named), iron, workspace=fm.WorkspaceBox(*box))


def _plate(mu_r: float) -> fm.Device:
    """A plate with a radius of twelve times the dipole's height, with a finer mesh below the dipole."""

    def disc(radius: float, height: float, operation: str = "add") -> fm.Part:
        return fm.Part(fm.Cylinder(radius, height), fm.Placement([0.0, 0.0, -height]), operation)

    box = np.array([-0.002, -0.002, 0.014]), np.array([0.002, 0.002, 0.021])
    below = (disc(0.045, 0.02),), 0.0038
    return _device("plate", mu_r, box, below, ((disc(0.25, 0.25), disc(0.045, 0.02, "cut")), 0.03))


def _over_a_plate(mu_r: float) -> Exact:
    """A = q mu0/4pi 2 / (2 z)^3 along the axis, and half of it across; q = (mu_r - 1)/(mu_r + 1)."""
    share = _SCALE * (mu_r - 1) / (mu_r + 1) / 4
    return lambda z: np.concatenate(
        [k * share * np.array([z**-3, -3 * z**-4, 12 * z**-5]) for k in (1.0, 0.5)]
    )


def _ball(mu_r: float) -> fm.Device:
    box = np.array([-0.003, -0.003, 0.034]), np.array([0.003, 0.003, 0.045])
    return _device("ball", mu_r, box, ((fm.Part(fm.Sphere(0.02)),), 0.0035))


def _beside_a_ball(mu_r: float) -> Exact:
    """The response of the ball to r^l P_l is -chi a^(2l+1) / r^(l+1) P_l, chi = l (mu_r - 1) / (l mu_r + l + 1)."""
    l, a = _ORDERS, 0.02
    chi = l * (mu_r - 1) / (l * mu_r + l + 1)

    def exact(d: Array) -> Array:
        share, n = _SCALE * chi * (a / d) ** (2 * l + 1) / d**3, 2 * l + 4
        parts = (l + 1) ** 2 * share, l * (l + 1) / 2 * share
        return np.concatenate(
            [[p.sum(axis=0), -(n * p / d).sum(axis=0), (n * (n + 1) * p / d**2).sum(axis=0)] for p in parts]
        )

    return exact


def _shell(mu_r: float) -> fm.Device:
    parts = fm.Part(fm.Sphere(0.03)), fm.Part(fm.Sphere(0.02), operation="cut")
    box = np.array([-0.004, -0.004, -0.002]), np.array([0.004, 0.004, 0.011])
    return _device("shell", mu_r, box, (parts, 0.0026))


def _in_a_shell(mu_r: float) -> Exact:
    """The response of the shell to r^-(l+1) P_l inside is chi_l r^l / b^(2l+1) P_l, from continuous potential and flux
    at both radii b and c. The dipole is attracted to the wall for mu_r > 1."""
    l, b, c = _ORDERS, 0.02, 0.03
    # Ratio of r^l to r^-(l+1) in the shell at b, from the outer face; then the slope of the potential at b.
    back = (l + 1) * (mu_r - 1) / (l * mu_r + l + 1) * (b / c) ** (2 * l + 1)
    slope = mu_r * (l * back - (l + 1)) / (1.0 + back)
    chi = (slope + l + 1) / (l - slope)

    def exact(d: Array) -> Array:
        share = _SCALE * chi * (d / b) ** (2 * l - 2) / b**3
        n = 2 * l - 2
        parts = -(l**2) * share, -(l * (l + 1)) / 2 * share
        return np.concatenate(
            [[p.sum(axis=0), (n * p / d).sum(axis=0), (n * (n - 1) * p / d**2).sum(axis=0)] for p in parts]
        )

    return exact


def _levitator() -> Iterator[Row]:
    """The magnet of desk_levitator, meshed as a body of the device and by its quadrature on the map; and readings of
    eight sensors for the magnet and for a hundred dipoles in the air of the device."""
    angles = 0.3 + 0.5 * np.pi * np.arange(4)
    rounds = [(np.cos(a), np.sin(a)) for a in angles]
    sensors = [
        fm.FieldSensor(f"{k} {name}", [0.018 * x, 0.018 * y, -0.035], axis)
        for k, (x, y) in enumerate(rounds)
        for name, axis in (("z", [0.0, 0.0, 1.0]), ("r", [x, y, 0.0]))
    ]
    device = fm.read_device("desk_levitator").replace(sensors=sensors)
    field = fm.open_map(fm.generate(device, spacing=2e-3, progress=False))
    pull, third, read = [], [], []
    for n in range(10):
        at = np.array([3e-3 * np.sin(n), 0.0, -0.02 - 1.5e-3 * n])
        amperes = 0.2 * np.cos(2 * n) * (n % 2)
        solution, (force, rest) = _with_payload(device, device.payload, at, amperes, 2e-3)
        read.append(_misread(field, solution, at, magnetic_body(device.payload), amperes))
        pull.append(_off(magnetic_body(device.payload).wrench(field, at, [amperes])[:3], force))
        third.append(_off(force, -rest))
    yield Row("desk_levitator", "force on the magnet at 10 places", max(pull), PULL, _MESHED)
    yield Row("desk_levitator", "action and reaction", max(third), THIRD_LAW, "third law")
    yield Row(
        "desk_levitator", "readings of the magnet at 10 places", max(read), MAGNET_READ, "magnet meshed"
    )
    random, bare, alone = np.random.default_rng(1), device.replace(workspace=None), []
    for _ in range(100):
        place, moment = (
            random.uniform([-0.009, -0.009, -0.044], [0.009, 0.009, -0.013]),
            random.normal(size=3),
        )
        dipole = AirSource("Dipole", moment=moment, placement=fm.Placement(place))
        solution = fm.solve_linear(bare.replace(background=fm.Background(sources=dipole)))
        alone.append(_misread(field, solution, place, moment, random.uniform(-1.0, 1.0)))
    yield Row("desk_levitator", "readings of 100 dipoles", max(alone), DIPOLE_READ, "dipole as a background")
    for diameter in (2e-3, 4e-3, 6e-3):
        bead, at = (
            fm.Payload(0.01, pieces=[fm.SoftSphere(diameter, mu_r=2000.0)], soft_level=2),
            np.array([1e-3, 0.0, -0.0125 - 0.5 * diameter]),
        )
        force = _on_bodies(device, bead, at, 0.5, diameter / 10)[0]
        off = _off(magnetic_body(bead).wrench(field, at, [0.5])[:3], force)
        yield Row("desk_levitator", f"force on a bead of {1e3 * diameter:g} mm", off, PULL, _MESHED)


_MESHED = "force_on, payload meshed"


def _off(found: Array, exact: Array) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def _on_bodies(
    device: fm.Device, payload: fm.Payload, at: Array, amperes: float, size: float
) -> tuple[Array, Array]:
    """Forces on a payload that is meshed as bodies of the device, and on the rest of the device."""
    return _with_payload(device, payload, at, amperes, size)[1]


def _with_payload(
    device: fm.Device, payload: fm.Payload, at: Array, amperes: float, size: float
) -> tuple[Any, tuple[Array, Array]]:
    """The solution of a device with the pieces of a payload as bodies, and the forces of `_on_bodies`."""
    bodies, materials = list(device.bodies), dict(device.materials)
    single = () if payload.magnet is None else (fm.PayloadPiece(payload.magnet),)
    for k, piece in enumerate(payload.pieces or single):
        shape, place = piece.shape, fm.Placement(at + piece.placement.position)
        if isinstance(shape, fm.SoftSphere):
            material: fm.Material = fm.LinearMaterial(f"piece {k}", float(shape.mu_r or np.inf))
            solid, edge = fm.Sphere(shape.diameter / 2), None
        else:
            material = fm.PermanentMagnet(f"piece {k}", np.array([0.0, 0.0, shape.remanence]), 1.0)
            solid, edge = fm.Cylinder(shape.diameter / 2, shape.height), size / 2
            place = fm.Placement(place.position - [0.0, 0.0, shape.height / 2])
        materials[material.name] = material
        bodies.append(fm.Body(material.name, material.name, (fm.Part(solid, place),), size, edge_size=edge))
    whole = fm.Device("with payload", "", device.coils, tuple(bodies), materials)
    solution = fm.solve_linear(whole)
    names = [body.name for body in whole.bodies[len(device.bodies) :]]
    rest = [body.name for body in device.bodies] + [coil.name for coil in device.coils]
    forces = solution.force_on(names, [amperes]), solution.force_on(rest, [amperes])
    return solution, forces


def _near_a_wide_core() -> Iterator[Row]:
    """Payloads of several magnets, and beads nearer to the core than their own width, each on two meshes."""
    core = fm.Body("core", "steel", (fm.Part(fm.Cylinder(0.02, 0.03)),), 3e-3, edge_size=1.5e-3)
    coil = fm.CircularCoil("1", 0.022, 0.035, 0.028, 800.0, placement=fm.Placement([0.0, 0.0, 0.015]))
    box = fm.WorkspaceBox(np.array([-0.012, -0.012, -0.028]), np.array([0.012, 0.012, -0.006]))
    steel = {"steel": fm.LinearMaterial("steel", 2000.0)}
    device = fm.Device("wide core", "", (coil,), (core,), steel, workspace=box)
    path = fm.generate(device, spacing=2e-3, progress=False)
    fields = {"": fm.open_map(path), ", without the reaction": fm.open_map(path, reaction=False)}
    for name, payload, size, heights in _payloads():
        off: dict[str, list[float]] = {words: [] for words in fields}
        mesh = []
        for x, z in zip((0.0, 0.002, 0.001), heights, strict=True):
            at = np.array([x, 1e-3, z])
            force, finer = (_on_bodies(device, payload, at, 0.5, size * k)[0] for k in (1.0, 0.7))
            mesh.append(_off(force, finer))
            for words, field in fields.items():
                off[words].append(_off(magnetic_body(payload).wrench(field, at, [0.5])[:3], finer))
        for words, shares in off.items():
            yield Row(f"{name}, wide core", f"force{words}", max(shares), None if words else PULL, _MESHED)
        yield Row(f"{name}, wide core", "force on two meshes", max(mesh), None, "elements 0.7 times as wide")


def _payloads() -> Iterator[tuple[str, fm.Payload, float, tuple[float, float, float]]]:
    """Names, payloads, mesh sizes and heights of the centres, m."""

    def body(*pieces: tuple[fm.MagnetCylinder | fm.SoftSphere, tuple[float, float, float]]) -> fm.Payload:
        return fm.Payload(0.01, pieces=[fm.PayloadPiece(shape, fm.Placement(at)) for shape, at in pieces])

    def ring(shape: fm.MagnetCylinder, radius: float, count: int) -> list[Any]:
        angles = 2 * np.pi * np.arange(count) / count
        return [(shape, (radius * np.cos(a), radius * np.sin(a), 0.0)) for a in angles]

    inner, outer = fm.MagnetCylinder(4e-3, 4e-3, 1.2), fm.MagnetCylinder(3e-3, 3e-3, 1.3)
    yield "two rings", body(*ring(inner, 3.5e-3, 4), *ring(outer, 7.5e-3, 8)), 1e-3, (-0.01, -0.014, -0.02)
    flat, slim = fm.MagnetCylinder(1e-2, 3e-3, 1.3), fm.MagnetCylinder(6e-3, 5e-3, 1.2)
    stack = body((flat, (0.0, 0.0, -5e-3)), (slim, (0.0, 0.0, 0.0)), (flat, (0.0, 0.0, 5e-3)))
    yield "stack", stack, 1.2e-3, (-0.014, -0.017, -0.02)
    for diameter in (3e-3, 6e-3):
        bead = replace(body((fm.SoftSphere(diameter, mu_r=2000.0), (0.0, 0.0, 0.0))), soft_level=2)
        yield f"bead {diameter * 1e3:g} mm", bead, diameter / 8, (-0.01, -0.013, -0.018)


def _misread(field: fm.lookup.FieldMap, solution: Any, place: Any, magnet: Any, current: float) -> float:
    """Largest error of the readings, relative to the largest reading."""
    assert field.sensors is not None
    truth = np.sum(solution.field(field.sensors.positions, [current]) * field.sensors.axes, axis=1)
    off = field.readings(place, magnet, [current]) - truth
    return float(np.abs(off).max() / np.abs(truth).max())
