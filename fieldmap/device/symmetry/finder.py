"""The symmetry group of a device's iron, and what each operation does to its coils and magnets.

An operation must fix the centre of all segment ends, so it is known from the images of two of them (and whether it is
a mirror); the fewest possible images are tried, and each candidate must map every body onto one that is like it.
Iron with an axis, or a single sphere, has infinitely many operations: of these the coils choose a finite group, or
else the mirrors in planes through the centre serve.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Body, Device, LinearMaterial, PermanentMagnet, StepFile
from fieldmap.device.symmetry.exact import exact_matrices
from fieldmap.device.symmetry.group import Operation, SymmetryGroup
from fieldmap.device.symmetry.outlines import Item, body_item, coil_axis, coil_item

Array = NDArray[np.float64]
# Positions and lengths are compared to this fraction of the iron's size: device files give seven digits or so.
_RELATIVE_TOLERANCE = 1e-6
_IDENTITY = np.eye(3)


def find_symmetry(device: Device) -> SymmetryGroup:
    """All mirrors and rotations that map the iron onto itself, and what they do to coils and magnets.

    Bodies are alike where shape, material (for magnets: mu_r) and mesh sizes are. Lengths and positions count as
    equal within 1e-6 of the iron's size. The parts of the device file are compared, not the solids they add up to:
    a symmetric body made of parts that are not is not recognised, and a STEP body counts as one without any
    symmetry of its own. Never raises.

    >>> import fieldmap as fm
    >>> print(find_symmetry(fm.read_device("drive_unit")))
    mirror y = 0
    >>> print(find_symmetry(fm.read_device("disk_six_cores")))
    6-fold axis z with 6 mirror planes
    """
    iron = [body_item(body, _kind(device, body)) for body in device.bodies]
    coils = [coil_item(coil) for coil in device.coils]
    if not iron:
        return SymmetryGroup((_trivial(device),), np.zeros(3), 0.0, ("no iron",))
    points = np.concatenate([item.points for item in iron])
    centre = points.mean(axis=0)
    size = float(np.abs(points - centre).max()) or max(_largest_scalar(item) for item in iron)
    centre[np.abs(centre) < 1e-12 * size] = 0.0
    tolerance = _RELATIVE_TOLERANCE * max(size, max(_largest_scalar(item) for item in iron))
    limits = tuple(
        f"body '{body.name}' comes from a STEP file, whose own symmetry is not looked at"
        for body in device.bodies
        if any(isinstance(part.shape, StepFile) for part in body.parts)
    )
    matrices = _finite_group(iron, coils, centre, tolerance)
    operations = tuple(_operation(device, m, centre, iron, coils, tolerance) for m in matrices)
    return SymmetryGroup(operations, centre, tolerance, limits)


def _finite_group(iron: list[Item], coils: list[Item], centre: Array, tolerance: float) -> Array:
    """Matrices (g, 3, 3), the identity first."""
    found = _candidates(iron, centre, tolerance)
    if found is None:
        # Iron with infinitely many operations. The coils may be less symmetric.
        joint = _candidates(iron + coils, centre, tolerance)
        found = [] if joint is None else _valid(joint, iron + coils, centre, tolerance)
        if len(found) < 2:
            found = _mirrors_of_axis(iron, coils, centre, tolerance)
    valid = _valid(found, iron, centre, tolerance)
    exact = exact_matrices(np.array([_IDENTITY, *valid]))
    return _IDENTITY[None] if exact is None else exact


def _valid(candidates: Sequence[Array], items: list[Item], centre: Array, tolerance: float) -> list[Array]:
    """Candidates that map the items onto themselves, each once, without the identity."""
    kept: list[Array] = [_IDENTITY]
    for matrix in candidates:
        if min(np.abs(matrix - other).max() for other in kept) < 1e-4:
            continue
        if _images(items, matrix, centre, tolerance) is not None:
            kept.append(matrix)
    return kept[1:]


def _candidates(items: list[Item], centre: Array, tolerance: float) -> list[Array] | None:
    """Orthogonal matrices that map two reference points onto possible images; None if all points lie on one axis."""
    kinds = list(dict.fromkeys((item.kind, len(item.points)) for item in items))
    label = np.concatenate([np.full(len(i.points), kinds.index((i.kind, len(i.points)))) for i in items])
    points = np.concatenate([item.points for item in items]) - centre
    _, first = np.unique(np.column_stack([np.round(points / tolerance), label]), axis=0, return_index=True)
    points, label = points[first], label[first]
    radius = np.linalg.norm(points, axis=1)
    size = radius.max()
    if size < tolerance:
        return None
    alike = (label[:, None] == label) & (np.abs(radius[:, None] - radius) < 4 * tolerance)
    far = radius > 0.1 * size
    one = int(np.where(far, alike.sum(axis=1), len(points) + 1).argmin())
    off_axis = np.linalg.norm(np.cross(points[one] / radius[one], points), axis=1)
    if off_axis.max() < 2 * tolerance:
        return None
    usable = off_axis > 0.3 * off_axis.max()
    two = int(np.where(usable, alike.sum(axis=1), len(points) + 1).argmin())
    frame = _frame(points[one], points[two])
    matrices = []
    for a in np.flatnonzero(alike[one]):
        angle_fits = np.abs(points @ points[a] - points[one] @ points[two]) < 8 * tolerance * size
        for b in np.flatnonzero(alike[two] & angle_fits):
            image = _frame(points[a], points[b])
            matrices += [image @ frame.T, image @ np.diag([1.0, 1.0, -1.0]) @ frame.T]
    return matrices


def _mirrors_of_axis(iron: list[Item], coils: list[Item], centre: Array, tolerance: float) -> list[Array]:
    """Two mirrors through the axis of round iron and their products, and the mirror across it where there is one."""
    points = np.concatenate([item.points for item in iron]) - centre
    if np.abs(points).max() < tolerance and coils:  # a sphere: the coils' axis, if they have one
        points = np.concatenate([item.points for item in coils]) - centre
        points = points if np.linalg.matrix_rank(points, tol=tolerance) == 1 else np.zeros((1, 3))
    longest = points[np.linalg.norm(points, axis=1).argmax()]
    axis = longest / np.linalg.norm(longest) if np.linalg.norm(longest) > tolerance else _IDENTITY[2]
    # The coordinate axis that is least along the axis, made perpendicular to it.
    side = _IDENTITY[np.abs(axis).argmin()]
    side = side - (side @ axis) * axis
    frame = np.column_stack([side / np.linalg.norm(side), np.cross(axis, side / np.linalg.norm(side)), axis])
    signs = [(a, b, c) for c in (1, -1) for a in (1, -1) for b in (1, -1)]
    return [frame @ np.diag(np.array(sign, dtype=float)) @ frame.T for sign in signs]


def _frame(first: Array, second: Array) -> Array:
    """Right-handed orthonormal columns: along the first, and in the half-plane of the second."""
    e1 = first / np.linalg.norm(first)
    e2 = second - (second @ e1) * e1
    e2 /= np.linalg.norm(e2)
    return np.column_stack([e1, e2, np.cross(e1, e2)])


def _images(items: list[Item], matrix: Array, centre: Array, tolerance: float) -> tuple[int, ...] | None:
    """Which item each is mapped onto; None if one is mapped onto none."""
    images = []
    for item in items:
        moved = item.moved(matrix, centre)
        image = next(
            (k for k, o in enumerate(items) if k not in images and moved.is_like(o, tolerance)), None
        )
        if image is None:
            return None
        images.append(image)
    return tuple(images)


def _operation(
    device: Device, matrix: Array, centre: Array, iron: list[Item], coils: list[Item], tolerance: float
) -> Operation:
    # The exact matrix is within the tolerance of the found one; twice as much keeps the verdict.
    bodies = _images(iron, matrix, centre, 2 * tolerance)
    windings = _images(coils, matrix, centre, 2 * tolerance)
    handedness = np.sign(np.linalg.det(matrix))
    axes = [coil_axis(coil) for coil in device.coils]
    signs = [] if windings is None else [axes[windings[k]] @ matrix @ axes[k] for k in range(len(axes))]
    offset = centre - matrix @ centre
    offset[np.abs(offset) < 1e-3 * tolerance] = 0.0
    images = bodies or tuple(range(len(iron)))
    return Operation(
        matrix=matrix,
        offset=offset,
        bodies=images,
        coils=windings,
        coil_signs=tuple(int(handedness * np.sign(value)) for value in signs),
        keeps_magnets=_keeps_magnets(device, matrix, images),
    )


def _keeps_magnets(device: Device, matrix: Array, images: tuple[int, ...]) -> bool:
    materials = [device.materials[body.material] for body in device.bodies]
    handedness = np.sign(np.linalg.det(matrix))
    for material, image in zip(materials, images, strict=True):
        other = materials[image]
        if isinstance(material, PermanentMagnet) and isinstance(other, PermanentMagnet):
            moved = handedness * matrix @ material.remanence
            if np.abs(moved - other.remanence).max() > 1e-6 * np.abs(material.remanence).max():
                return False
    return True


def _kind(device: Device, body: Body) -> tuple[object, ...]:
    material = device.materials[body.material]
    kind: tuple[object, ...] = (body.material,)
    if isinstance(material, PermanentMagnet):
        kind = ("magnet", material.mu_r)
    elif isinstance(material, LinearMaterial):
        kind = ("linear", material.mu_r)
    return (*kind, body.mesh_size, body.edge_size)


def _largest_scalar(item: Item) -> float:
    return max(float(outline.rows[:, 6:].max()) for run in item.runs for outline in run)


def _trivial(device: Device) -> Operation:
    coils = len(device.coils)
    return Operation(_IDENTITY, np.zeros(3), (), tuple(range(coils)), (1,) * coils, True)
