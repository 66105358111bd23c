"""A map in memory: arrays over the nodes of a grid, and their provenance."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from mmap import mmap
from typing import Any

import numpy as np

from fieldmap.arguments import check
from fieldmap.records import Record
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.typing import Array

REACTION_FIELDS = 64
"""Most fields of a reaction: those that the C core has room for."""

NO_CURRENT = "no current"
"""Name of the constant field of a map; no name of a coil has a space."""


@dataclass(frozen=True, eq=False, repr=False)
class Grid(Record):
    """Regular grid of nodes. Node (i, j, k) lies at lower + (i, j, k) * spacing.

    Arrays over the grid are in C order of x, y, z.

    Parameters
    ----------
    lower
        (3,), first node, m.
    spacing
        (3,), m.
    shape
        (nx, ny, nz), numbers of nodes, each at least 2.

    Raises
    ------
    InputError
        If a number is not finite, a spacing not positive or a shape below 2.

    Examples
    --------
    >>> Grid([0, 0, 0], [0.1, 0.1, 0.1], (3, 2, 2)).points()[1]
    array([0. , 0. , 0.1])
    """

    lower: Array
    spacing: Array
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        lower, spacing = (np.array(values, dtype=np.float64) for values in (self.lower, self.spacing))
        shape = tuple(int(n) for n in self.shape)
        finite = [values.shape == (3,) and bool(np.isfinite(values).all()) for values in (lower, spacing)]
        for name, value, good, must_hold in (
            ("lower", lower, finite[0], "three finite numbers, m"),
            ("spacing", spacing, finite[1] and bool((spacing > 0).all()), "three positive numbers, m"),
            ("shape", shape, len(shape) == 3 and min(shape) >= 2, "three whole numbers of at least 2"),
        ):
            check(good, f"Grid, {name}", must_hold, value, "give the grid three axes with nodes on each")
            object.__setattr__(self, name, value)
        lower.flags.writeable = spacing.flags.writeable = False

    @property
    def upper(self) -> Array:
        """Last node (3,), m."""
        return self.lower + (np.array(self.shape) - 1) * self.spacing

    @property
    def size(self) -> int:
        """Number of nodes."""
        nx, ny, nz = self.shape
        return nx * ny * nz

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Node coordinates along x, y and z, m."""
        x, y, z = (self.lower[a] + np.arange(self.shape[a]) * self.spacing[a] for a in range(3))
        return x, y, z

    def every(self, step: int) -> "Grid":
        """The grid of every `step`-th node along each axis.

        Parameters
        ----------
        step
            Divides the number of cells along each axis.

        Returns
        -------
        Grid
            The grid, of the same box.
        """
        nx, ny, nz = ((n - 1) // step + 1 for n in self.shape)
        return Grid(self.lower, self.spacing * step, (nx, ny, nz))

    def points(self, first: int = 0, last: int | None = None) -> Array:
        """Nodes of some x-planes of the grid.

        Parameters
        ----------
        first
            First plane.
        last
            Plane after the last one; the end of the grid unless given.

        Returns
        -------
        Array
            Positions (n, 3), m.
        """
        x, y, z = self.axes
        mesh = np.meshgrid(x[first:last], y, z, indexing="ij")
        return np.stack([axis.ravel() for axis in mesh], axis=1)


@dataclass(frozen=True)
class FieldError(Record):
    """An error of flux density in T and of its gradient in T/m."""

    flux_density: float
    gradient: float


@dataclass(frozen=True, repr=False)
class Provenance(Record):
    """Origin of a map.

    Attributes
    ----------
    title : of the recipe.
    device_name : of the device.
    recipe_text, device_text : contents of the files.
    fingerprint : hash of all inputs of the data (settings, the device after reading, versions). A run is resumed only
        if the fingerprint is the same.
    versions : of Python and all libraries involved.
    solver_report : plain numbers, texts and lists.
    assumptions : of the solver, one sentence each.
    created : date and time, UTC, as openPMD writes it.
    included : other files that the device file refers to, by path relative to it: texts of materials, SHA-256 of
        solids.
    """

    title: str = ""
    device_name: str = ""
    recipe_text: str = ""
    device_text: str = ""
    fingerprint: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    solver_report: Mapping[str, Any] = field(default_factory=dict)
    assumptions: tuple[str, ...] = ()
    created: str = ""
    included: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class MapInfo(Record):
    """Description of a map: everything but its arrays.

    Attributes
    ----------
    grid : of the nodes.
    coil_names : in the order of the currents.
    reference_current : (n_coils,), currents at which the file states its fields, A.
    provenance : origin of the map.
    interpolation_error : largest difference between interpolant and solver at sampled points, summed over the coils at
        their reference currents. It is a sample, not a bound.
    error_bounds : certified bounds by kind of lookup; empty for a map without certificate.
    reduced_model : turns currents into the weights of the iron's fields, if the iron saturates; None for a field that
        is linear in the currents.
    current_error : largest difference between the reduced model and the solver at tested states. In files of earlier
        versions these are states that the model was not trained on.
    fixed_sources : names of the sources that no current drives, such as magnets and "background".
    constant_field : whether the last field has the weight 1 at all currents. It is the field of the fixed sources and
        of the iron that they magnetise. With a reduced model, whose fields include iron and magnets, it is the
        background alone.
    """

    grid: Grid
    coil_names: tuple[str, ...]
    reference_current: Array
    provenance: Provenance = field(default_factory=Provenance)
    interpolation_error: FieldError | None = None
    error_bounds: Mapping[str, FieldError] = field(default_factory=dict)
    reduced_model: ReducedModel | None = None
    current_error: FieldError | None = None
    fixed_sources: tuple[str, ...] = ()
    constant_field: bool = False

    def __post_init__(self) -> None:
        current = np.array(self.reference_current, dtype=np.float64)
        n = len(self.coil_names)
        model, constant = self.reduced_model, self.constant_field
        good = current.shape == (n,) and bool(np.isfinite(current).all()) and bool((current > 0).all())
        named = (n or constant) and len(set(self.coil_names)) == n
        _check(named, "coil_names", "at least one coil, each name once", self.coil_names)
        made = not constant or bool(self.fixed_sources)
        _check(made, "fixed_sources", "what makes the constant field, by name", "none")
        _check(good, "reference_current", f"{n} positive currents, A", current)
        if model is not None:
            received = f"a model of {model.coil_count} coils"
            _check(model.coil_count == n, "reduced_model", f"one for {n} coils", received)
            must_hold = "a background that both the iron and the air have, or neither"
            received = f"a constant field is {'there' if constant else 'missing'}"
            _check(bool(model.fixed.size) == constant, "reduced_model", must_hold, received)
        current.flags.writeable = False
        object.__setattr__(self, "reference_current", current)

    @property
    def field_names(self) -> tuple[str, ...]:
        """Names of the fields that the map holds: the coils, those of saturating iron, and the constant one."""
        count = 0 if self.reduced_model is None else self.reduced_model.field_count
        constant = (NO_CURRENT,) if self.constant_field else ()
        return (*self.coil_names, *(f"iron mode {k + 1}" for k in range(count)), *constant)

    @property
    def field_scale(self) -> Array:
        """Factors of the fields in the file: the reference currents, A, for coils, and 1 for the other fields."""
        return np.append(self.reference_current, np.ones(len(self.field_names) - len(self.coil_names)))

    @property
    def reference_weights(self) -> Array:
        """Weights of the stored fields in their sum at the reference currents."""
        weights = np.ones(len(self.coil_names))
        if self.reduced_model is not None:
            weights = np.append(weights, self.reduced_model.reference_weights)
        return np.append(weights, 1.0) if self.constant_field else weights


@dataclass(frozen=True, eq=False, repr=False)
class StoredFields(Record):
    """Fields of iron on a grid: flux_density (k, nx, ny, nz, 3), and gradient (k, nx, ny, nz, 3, 3)."""

    flux_density: Array
    gradient: Array

    def on(self, grid: Grid) -> "MapData":
        """The fields as a map of their own, as if each were that of a coil at 1 A.

        Parameters
        ----------
        grid
            Grid of the map.

        Returns
        -------
        MapData
            The map.
        """
        names = tuple(map(str, range(len(self.flux_density))))
        unit = np.ones(len(names))
        return MapData(grid, names, unit, flux_density=self.flux_density, gradient=self.gradient)


@dataclass(frozen=True, eq=False, repr=False)
class StoredReaction(StoredFields):
    """Fields on a grid, T/sqrt(J) and T/(m sqrt(J)), that span the iron's reaction to magnets (`fieldmap.reaction`).
    repelled: number of fields with the sign -1, the last ones."""

    repelled: int = 0


@dataclass(frozen=True, eq=False, repr=False)
class StoredSensors(Record):
    """The field sensors of a map.

    Attributes
    ----------
    names : of the s sensors.
    positions : (s, 3), m.
    axes : (s, 3), unit vectors.
    shares : (s, n_fields), readings of the map's fields at weight 1, T; T/A for coils.
    answers : response of the iron to a dipole of 1 A m^2 at each sensor, along its axis, T/(A m^2) and T/(A m^3); None
        without iron.

    Raises
    ------
    InputError
        If a shape does not fit.
    """

    names: tuple[str, ...]
    positions: Array
    axes: Array
    shares: Array
    answers: StoredFields | None = None

    def __post_init__(self) -> None:
        count = len(self.names)
        shapes = [np.shape(values) for values in (self.positions, self.axes, self.shares)]
        fits = shapes[:2] == [(count, 3)] * 2 and len(shapes[2]) == 2 and shapes[2][0] == count > 0
        _check(fits, "sensors", f"a row for each of {count} sensors", f"shapes {shapes}")
        answered = self.answers is None or len(self.answers.flux_density) == count
        _check(answered, "sensors, answers", f"one field for each of {count} sensors", "another number")


@dataclass(frozen=True, eq=False, repr=False)
class StoredLinkage(Record):
    """Flux linkages of c coils as a map holds them: docs/theory/flux_linkage.md.

    Attributes
    ----------
    inductance : (c, c), H, symmetric: of linear iron and coils; for saturating iron of the coils in air.
    constant : (c,), Wb: of magnets and background without currents; for saturating iron without the flux of the iron
        that they magnetise.

    Raises
    ------
    InputError
        If shapes do not fit, numbers are not finite, or the matrix is not symmetric.
    """

    inductance: Array
    constant: Array

    def __post_init__(self) -> None:
        matrix, constant = (np.array(x, dtype=np.float64) for x in (self.inductance, self.constant))
        fits = constant.ndim == 1 and matrix.shape == (*constant.shape, *constant.shape)
        received = f"shapes {matrix.shape} and {constant.shape}"
        _check(fits, "linkages", "an inductance (c, c) and a linkage (c,)", received)
        largest = np.abs(matrix).max(initial=0.0)
        good = np.isfinite(largest) and np.isfinite(constant).all()
        good = good and np.abs(matrix - matrix.T).max(initial=0.0) <= 1e-9 * largest
        _check(good, "linkages", "finite, with a symmetric inductance", matrix)
        for name, values in (("inductance", matrix), ("constant", constant)):
            values.flags.writeable = False
            object.__setattr__(self, name, values)


@dataclass(frozen=True, eq=False, repr=False)
class MapData(MapInfo):
    """A map: fields on a grid, those of the coils per ampere.

    The first fields are those of the coils. They include the iron if it is linear. With a reduced model they do not,
    and the fields of the iron at weight 1 follow, in T and T/m. A constant field is the last one, in T and T/m.

    Attributes
    ----------
    flux_density : (n_fields, nx, ny, nz, 3), T/A for coils.
    gradient : (n_fields, nx, ny, nz, 3, 3), T/(m A) for coils; gradient[..., i, j] = dB_i/dx_j.
    reaction : of the iron to magnets; None if it is not known.
    linkage : of the coils; None if it is not known.
    sensors : of the device; None without sensors, and in maps of earlier versions.

    Raises
    ------
    InputError
        If a shape does not fit.
    """

    flux_density: Array = field(kw_only=True)
    gradient: Array = field(kw_only=True)
    reaction: StoredReaction | None = field(kw_only=True, default=None)
    linkage: StoredLinkage | None = field(kw_only=True, default=None)
    sensors: StoredSensors | None = field(kw_only=True, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, tail in (("flux_density", (3,)), ("gradient", (3, 3))):
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            wanted = (len(self.field_names), *self.grid.shape, *tail)
            _check(values.shape == wanted, name, f"shape {wanted}", f"shape {values.shape}")
            object.__setattr__(self, name, values)
        if self.linkage is not None:
            coils, linked = len(self.coil_names), len(self.linkage.constant)
            _check(linked == coils, "linkages", f"those of {coils} coils", f"those of {linked}")
        if self.sensors is not None:
            received = f"{self.sensors.shares.shape[1]} shares"
            fits = self.sensors.shares.shape[1] == len(self.field_names)
            _check(fits, "sensors", f"a share for each of {len(self.field_names)} fields", received)

    def as_read(self) -> "MapData":
        """The map with the rounding of a file: its fields are multiplied by their scale and divided by it again."""
        scale = self.field_scale[:, None, None, None, None]
        flux, gradient = (
            self.flux_density * scale / scale,
            self.gradient * scale[..., None] / scale[..., None],
        )
        return replace(self, flux_density=flux, gradient=gradient)


class MappedNumbers(np.memmap):
    """Memory-mapped float64 numbers of a file. A pickle holds the path of the file and the first numbers."""

    @classmethod
    def at(cls, path: str, offset: int, count: int) -> "MappedNumbers":
        """`count` numbers of a file, from an offset in bytes."""
        return cls(path, np.dtype("<f8"), "r", offset, (count,))

    def beginning(self, first: Array) -> "MappedNumbers":
        """The numbers with other first ones, which are changed in memory but not in the file.

        Parameters
        ----------
        first
            The first numbers.

        Returns
        -------
        MappedNumbers
            The numbers; this object if it begins with them already.
        """
        if np.array_equal(self[: first.size], first):
            return self
        other = type(self)(str(self.filename), self.dtype, "c", self.offset, self.shape)
        other[: first.size] = first
        return other

    def __reduce__(self) -> Any:
        if not isinstance(self.base, mmap):
            return np.array(self).__reduce__()
        return _mapped, (str(self.filename), self.offset, self.size, np.array(self[:24]))


def _mapped(path: str, offset: int, count: int, first: Array) -> MappedNumbers:
    return MappedNumbers.at(path, offset, count).beginning(first)


@dataclass(frozen=True, eq=False, repr=False)
class LargeMap(MapInfo):
    """A large map as it is opened: the coefficients of its lookups, without the numbers at its nodes.

    Attributes
    ----------
    every : number of grid cells that a cell of the lookup spans along each axis.
    blocks : coefficients of all fields, by the name of the interpolant: blocks of `fieldmap.core.block`.
    misfits : largest difference of each interpolant from the values at all nodes, T and T/m, summed over the fields,
        coils at their reference currents.
    reaction, linkage, sensors : as of `MapData`, on `lookup_grid`.
    reaction_cells : coefficients of the reaction in the cells of `lookup_grid`, a block; None without a reaction.
    """

    every: int = field(kw_only=True)
    blocks: Mapping[str, Array] = field(kw_only=True)
    misfits: Mapping[str, FieldError] = field(kw_only=True)
    reaction_cells: Array | None = field(kw_only=True, default=None)
    reaction: StoredReaction | None = field(kw_only=True, default=None)
    linkage: StoredLinkage | None = field(kw_only=True, default=None)
    sensors: StoredSensors | None = field(kw_only=True, default=None)

    @property
    def lookup_grid(self) -> Grid:
        """The grid whose cells hold the coefficients."""
        return self.grid.every(self.every)


def _check(holds: object, name: str, must_hold: str, received: object) -> None:
    remedy = "make the arrays fit the grid and the coils"
    check(bool(holds), f"map data, {name}", must_hold, received, remedy)
