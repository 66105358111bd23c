"""Devices with known errors for `solve_to_tolerance`: by closed forms, independent programs, or finer meshes."""

from collections.abc import Callable
from dataclasses import dataclass

import magpylib
import numpy as np

import fieldmap as fm
from fieldmap.device.model import (
    Background,
    Body,
    Box,
    Cylinder,
    Device,
    LinearMaterial,
    Part,
    PermanentMagnet,
    Sphere,
    WorkspaceBox,
    placed,
)
from fieldmap.iron import LinearSolution
from fieldmap.iron.error import estimate_error, workspace_surface
from validation import axisymmetric, joints, thin_gaps
from validation.row import Array

FieldAt = Callable[[Array], Array]
Errors = tuple[float, float]
UP = np.array([0.0, 0.0, 1.0])
# Step of the differences for the gradient of a field in closed form, m.
_STEP = 2e-5
CLOSED, INDEPENDENT, FINER = "closed form", "independent program", "finer mesh, both forms (weaker)"


@dataclass(frozen=True, eq=False)
class Known:
    """A device, its tolerance (asked), and a function from its solution to the true errors of B and of the gradient,
    relative as in the estimate; truth: kind of reference."""

    name: str
    device: Device
    asked: float
    truth: str
    errors: Callable[[LinearSolution], Errors]
    mu_r: float | None = None
    most_meshes: int = 10


@dataclass(frozen=True, eq=False)
class ExactFields:
    """Fields of one source in closed form, with the members of a solution that the estimate uses."""

    flux_density: FieldAt
    sources: tuple[str, ...] = ("",)
    iron_points: Array = None  # type: ignore[assignment]

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Field (1, n, 3) and gradient (1, n, 3, 3), by differences of fourth order."""
        columns = []
        for axis in np.eye(3) * _STEP:
            far, near = (
                self.flux_density(points + k * axis) - self.flux_density(points - k * axis) for k in (2, 1)
            )
            columns.append((8 * near - far) / (12 * _STEP))
        return self.flux_density(points)[None], np.stack(columns, axis=-1)[None]


def exactly(device: Device, flux_density: FieldAt) -> Callable[[LinearSolution], Errors]:
    """Errors against a field (n, 3) at points (n, 3)."""
    return lambda solution: _difference(device, solution, ExactFields(flux_density))


def against_finer(
    device: Device,
    refinement: float,
    mu_r: float | None = None,
    forms: tuple[str, ...] = ("potential", "flux"),
) -> Callable[[LinearSolution], Errors]:
    """Errors against the mean of the forms on a mesh with the device's sizes over `refinement`."""

    def errors(solution: LinearSolution) -> Errors:
        both = [
            fm.solve_linear(device, mu_r, refinement=refinement, form=form) for form in dict.fromkeys(forms)
        ]
        return _difference(device, solution, Mean(both[0], both[-1]))

    return errors


@dataclass(frozen=True, eq=False)
class Mean:
    """Mean of two solutions."""

    one: LinearSolution
    other: LinearSolution

    @property
    def sources(self) -> tuple[str, ...]:
        """Sources of the first solution."""
        return self.one.sources

    @property
    def iron_points(self) -> Array:
        """Points of the first solution."""
        return self.one.iron_points

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Means of fields and gradients."""
        (b, g), (c, h) = self.one.source_fields(points), self.other.source_fields(points)
        return 0.5 * (b + c), 0.5 * (g + h)


def _difference(device: Device, solution: LinearSolution, truth: ExactFields | Mean) -> Errors:
    change = estimate_error(workspace_surface(device), solution, truth, None).change
    assert change is not None
    return change


def against_references(device: Device) -> Callable[[LinearSolution], Errors]:
    """Errors at the reference points of the device's file, relative to the largest value of the same quantity there."""

    def errors(solution: LinearSolution) -> Errors:
        out = []
        for gradient in (False, True):
            known = [one for one in device.references if one.quantity.startswith("d") == gradient]
            off, size = [], []
            for one in known:
                place = tuple("xyz".index(letter) for letter in one.quantity if letter in "xyz")
                ours = (solution.gradient if gradient else solution.field)(one.at, one.currents)[place]
                off.append(abs(float(ours) - one.value))
                size.append(abs(one.value))
            out.append(max(off) / max(size) if known else float("nan"))
        return out[0], out[1]

    return errors


def block(
    name: str, material: str, lower: Array, upper: Array, size: float, edge: float | None = None
) -> Body:
    """A box between two corners."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    at = 0.5 * (lower + upper)
    at[2] = lower[2]
    return Body(name, material, (Part(Box(tuple(upper - lower)), placed(at)),), size, edge)


IRON = {"iron": LinearMaterial("iron", 1000.0)}


def magnet(mu_r: float = 1.0) -> dict[str, PermanentMagnet]:
    """A magnet of 1.2 T upwards."""
    return {"ndfeb": PermanentMagnet("ndfeb", 1.2 * UP, mu_r)}


def spheres() -> list[Known]:
    """Spheres and shells in a background, a coil or beside a magnet."""
    shipped, loop = fm.read_device("sphere_in_field"), fm.read_device("loop_and_sphere")
    background, mu = shipped.background, shipped.materials["iron"].mu_r
    shell = fm.read_device("shell_in_field")
    ball = Device(
        "sphere in a gradient",
        "",
        bodies=[Body("ball", "iron", Sphere(0.01), 3e-3)],
        materials=IRON,
        background=Background([0, 0, 0], [0.5, 0.1, 0.0, 0.4, 0.2]),
        workspace=WorkspaceBox([-4e-3, -4e-3, -2.1e-2], [4e-3, 4e-3, -1.3e-2]),
    )
    return [
        Known(
            "sphere in a field",
            shipped,
            0.01,
            CLOSED,
            exactly(shipped, sphere_in_field(background, mu, 0.01)),
        ),
        Known(
            "sphere in a gradient",
            ball,
            0.01,
            CLOSED,
            exactly(ball, sphere_in_field(ball.background, 1000.0, 0.01)),
        ),
        Known(
            "shell, mu_r 100",
            shell,
            0.01,
            CLOSED,
            exactly(shell, hollow(shell.background.flux_density, 100.0, 0.8)),
        ),
        thin_shell(),
        Known("sphere below a coil", loop, 0.005, CLOSED, against_references(loop), 1000.0),
        magnet_and_ball(),
    ]


def sphere_in_field(background: Background, mu: float, radius: float) -> FieldAt:
    """Field outside a sphere at the origin: B0 + G x with the dipole and the quadrupole of the sphere."""
    flux, tensor = background.field(np.zeros((1, 3)))[0], background.tensor

    def field(points: Array) -> Array:
        r = np.linalg.norm(points, axis=1)[:, None]
        n, along = points / r, points @ tensor
        dipole = (mu - 1) / (mu + 2) * radius**3 * (3 * n * (n @ flux)[:, None] - flux) / r**3
        twice = np.einsum("ni,ni->n", along, points)[:, None]
        answer = -2 * (mu - 1) / (2 * mu + 3) * radius**5 * (along / r**5 - 2.5 * twice * points / r**7)
        return background.field(points) + dipole + answer

    return field


def hollow(flux: Array, mu: float, ratio: float) -> FieldAt:
    """Uniform field inside a shell (Jackson 5.121)."""
    inside = 9 * mu / ((2 * mu + 1) * (mu + 2) - 2 * ratio**3 * (mu - 1) ** 2)
    return lambda points: np.broadcast_to(inside * np.asarray(flux), points.shape)


def thin_shell() -> Known:
    """A shell with a shielding factor of 600."""
    parts = (Part(Sphere(0.02)), Part(Sphere(0.018), operation="cut"))
    device = Device(
        "thin shell",
        "",
        bodies=[Body("shell", "iron", parts, 4e-3)],
        materials={"iron": LinearMaterial("iron", 1e4)},
        background=Background(1e-3 * UP),
        workspace=WorkspaceBox([-5e-3] * 3, [5e-3] * 3),
    )
    return Known("shell, mu_r 10 000", device, 0.03, CLOSED, exactly(device, hollow(1e-3 * UP, 1e4, 0.9)))


def magnet_and_ball() -> Known:
    """A spherical magnet at mu_r = 1, a dipole, above a sphere of iron: a sum over multipoles."""
    radius, far, mu = 0.01, 0.022, 1000.0
    device = Device(
        "magnet and ball",
        "",
        bodies=[
            Body("ball", "iron", Sphere(radius), 3e-3),
            Body("magnet", "ndfeb", (Part(Sphere(0.008), placed(far * UP)),), 3e-3),
        ],
        materials=IRON | magnet(),
        workspace=WorkspaceBox([-4e-3, -4e-3, -2.2e-2], [4e-3, 4e-3, -1.4e-2]),
    )
    moment = 1.2 * 0.008**3 / 3

    def field(points: Array) -> Array:
        offset = points - far * UP
        d = np.linalg.norm(offset, axis=1)[:, None]
        dipole = moment * (3 * offset * offset[:, 2:] / d**2 - UP) / d**3
        r = np.linalg.norm(points, axis=1)
        c = points[:, 2] / r
        radial, along = np.zeros(len(points)), np.zeros(len(points))
        for n in range(1, 60):
            p = np.polynomial.legendre.Legendre.basis(n)
            # Potential -(n + 1) r^n / far^(n + 2) P_n of the dipole, and the response of the sphere, which decays as
            # r^-(n + 1); mu0 m / 4 pi = moment.
            own = n * (mu - 1) / (n * (mu + 1) + 1) * radius ** (2 * n + 1) * (n + 1) / far ** (n + 2)
            radial += moment * own * (n + 1) / r ** (n + 2) * p(c)
            along -= moment * own / r ** (n + 2) * p.deriv()(c)
        n_r = points / r[:, None]
        # d/dtheta = -sin(theta) d/dc, and sin(theta) e_theta = cos(theta) e_r - z.
        return dipole + n_r * radial[:, None] + along[:, None] * (UP - c[:, None] * n_r)

    return Known("magnet and ball", device, 0.01, CLOSED, exactly(device, field))


def magnets() -> list[Known]:
    """Magnets at mu_r = 1 against magpylib, and one on a plate against its image."""
    ball = Device(
        "ball",
        "",
        bodies=[Body("ball", "ndfeb", Sphere(0.01), 4e-3)],
        materials=magnet(),
        workspace=WorkspaceBox([-5e-3, -5e-3, 1.3e-2], [5e-3, 5e-3, 2e-2]),
    )
    pair = Device(
        "pair",
        "",
        bodies=[
            Body(f"rod {z}", "ndfeb", (Part(Cylinder(6e-3, 1e-2), placed(1e-3 * z * UP)),), 4e-3)
            for z in (-20, 10)
        ],
        materials=magnet(),
        workspace=WorkspaceBox([-4e-3, -4e-3, -4e-3], [4e-3, 4e-3, 4e-3]),
    )
    rods = [
        magpylib.magnet.Cylinder(polarization=1.2 * UP, dimension=(0.012, 0.01), position=z * UP)
        for z in (-0.015, 0.015)
    ]
    sphere = magpylib.magnet.Sphere(polarization=1.2 * UP, diameter=0.02)
    return [
        Known("spherical magnet", ball, 0.01, INDEPENDENT, exactly(ball, sphere.getB)),
        Known(
            "two cylindrical magnets", pair, 0.01, INDEPENDENT, exactly(pair, magpylib.Collection(rods).getB)
        ),
        magnet_on_plate(),
        magnet_and_cube(),
    ]


def magnet_on_plate() -> Known:
    """A magnet 0.1 mm above a thick plate of mu_r 10 000: magnet and image, within 1e-3 (the plate is finite)."""
    device = thin_gaps.magnet_above_plate(1e-4, 6e-3, 2e-3)
    device = device.replace(workspace=WorkspaceBox([-5e-3, -5e-3, 1.3e-2], [5e-3, 5e-3, 2e-2]))
    sides = [
        magpylib.magnet.Cuboid(polarization=UP, dimension=(0.02, 0.02, 0.01), position=z * UP)
        for z in (1e-4 + 5e-3, -1e-4 - 5e-3)
    ]
    return Known(
        "magnet 0.1 mm above a plate", device, 0.01, CLOSED, exactly(device, magpylib.Collection(sides).getB)
    )


def magnet_and_cube() -> Known:
    """A magnet beside a small soft cube."""
    device = Device(
        "magnet and cube",
        "",
        bodies=[
            block("magnet", "ndfeb", [-7.5e-3, -7.5e-3, 0], [7.5e-3, 7.5e-3, 1.5e-2], 6e-3),
            block("cube", "iron", [-1e-3, -1e-3, 1.55e-2], [1e-3, 1e-3, 1.75e-2], 2e-3),
        ],
        materials=IRON | magnet(1.05),
        workspace=WorkspaceBox([-5e-3, -5e-3, 2.1e-2], [5e-3, 5e-3, 2.6e-2]),
    )
    one, other = device.bodies
    fine = (
        Body(one.name, one.material, one.parts, 2.5e-3, 5e-4),
        Body(other.name, other.material, other.parts, 2.5e-4, 2e-5),
    )
    return Known(
        "magnet beside a small cube", device, 0.01, FINER, against_finer(device.replace(bodies=fine), 1.0)
    )


def on_one_axis() -> list[Known]:
    """Disk, core and plate about a coil, against axisymmetric finite elements."""
    out = []
    for case, mu_r, asked in (("disk", 1000, 0.003), ("diskcore", 4000, 0.003), ("spool", 4000, 0.005)):
        device, errors = axisymmetric.linear_case(case, mu_r)
        coarse = [Body(one.name, one.material, one.parts, max(one.mesh_size, 5e-3)) for one in device.bodies]
        # The reference points lie below the disk, out to 28 mm.
        space = WorkspaceBox([-2e-2, -2e-2, -0.11], [2e-2, 2e-2, -0.07])
        device = Device.unchecked(**{**vars(device), "bodies": tuple(coarse), "workspace": space})
        words = axisymmetric.WORDS[case]
        out.append(Known(f"{words} in a coil", device, asked, INDEPENDENT, errors))
    return out


def shields_and_gaps() -> list[Known]:
    """A box in a uniform field, a C-core, a cube with an edge that touches the workspace, and plates with gaps."""
    walls = (
        Part(Box((0.06,) * 3), placed((0, 0, -0.03))),
        Part(Box((0.05,) * 3), placed((0, 0, -0.025)), "cut"),
    )
    shield = Device(
        "box",
        "",
        bodies=[Body("box", "iron", walls, 6e-3)],
        materials=IRON,
        background=Background(1e-3 * UP),
        workspace=WorkspaceBox([-8e-3] * 3, [8e-3] * 3),
    )
    core = joints.c_core(1e-4, True, 3e-3, 5e-4)
    core = core.replace(workspace=WorkspaceBox([2.4e-2, -4e-3, 2.5e-2], [3e-2, 4e-3, 3.5e-2]))
    cube = Device(
        "cube",
        "",
        bodies=[block("cube", "iron", [-0.01, -0.01, -0.02], [0.01, 0.01, 0.0], 5e-3)],
        materials=IRON,
        background=Background(1e-2 * UP),
        workspace=WorkspaceBox([1.01e-2, -2e-3, -1e-3], [1.3e-2, 2e-3, 3e-3]),
    )
    at_edge = against_finer(with_fine_part(cube), 1.0, forms=("potential",))
    return [
        Known("box in a uniform field", shield, 0.01, FINER, against_finer(shield, 3.0)),
        Known("C-core, gap of 0.1 mm", core, 0.005, FINER, against_finer(core, 1.6)),
        Known("workspace at an edge", cube, 0.02, FINER, at_edge),
        Known("workspace at an edge, five meshes", cube, 5e-4, FINER, at_edge, None, 5),
    ]


def with_fine_part(device: Device) -> Device:
    """The cube in two touching bodies; the body next to the workspace has elements of 0.11 mm."""
    box = (Part(Box((1.4e-3, 5e-3, 1.8e-3)), placed((9.3e-3, 0, -1.8e-3))),)
    cut = Part(Box((1.4e-3, 5e-3, 1.8e-3)), placed((9.3e-3, 0, -1.8e-3)), "cut")
    cube = device.bodies[0]
    rest = Body("cube", "iron", (*cube.parts, cut), 2.5e-3, 1e-4)
    return device.replace(bodies=(rest, Body("part", "iron", box, 1.1e-4, 2e-5)))


def shipped() -> list[Known]:
    """The shipped machines, with a workspace added where one is missing."""
    pole = fm.read_device("pole_in_box").replace(
        workspace=WorkspaceBox([-1e-2, -1e-2, 8e-2], [1e-2, 1e-2, 9e-2])
    )
    plates = fm.read_device("thin_plates").replace(
        workspace=WorkspaceBox([-1.5e-2, -1.5e-2, 7e-2], [1.5e-2, 1.5e-2, 8.5e-2])
    )
    unit, cores, hybrid = (
        fm.read_device(name) for name in ("drive_unit_a3", "disk_six_cores", "magnet_core")
    )
    return [
        Known("pole in a box", pole, 0.01, FINER, against_finer(pole, 1.5, 2000.0), 2000.0),
        Known("thin plates", plates, 0.01, FINER, against_finer(plates, 1.4, 1000.0), 1000.0),
        Known("drive unit", unit, 0.005, INDEPENDENT, against_references(unit), 4000.0),
        Known("disk, six cores", cores, 0.005, FINER, against_finer(cores, 1.6)),
        Known("coil with a magnet as core", hybrid, 0.01, FINER, against_finer(hybrid, 2.0)),
    ]


def all_devices() -> list[Known]:
    """All devices."""
    return [*spheres(), *magnets(), *on_one_axis(), *shields_and_gaps(), *shipped()]
