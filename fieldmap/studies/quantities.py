"""The quantities that a study can record: names, units, axes, and meanings."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fieldmap.records import Record

AXES = ("variant", "currents", "coil", "other_coil", "body", "point", "component", "direction")
"""Axes of the data set that are not varied keys."""


@dataclass(frozen=True, repr=False)
class Quantity(Record):
    """One variable of the data set.

    group: the word in record.quantities that selects it. unit: SI, as UDUNITS writes it. axes: in addition to those of
    the variants and sets of currents. printed: (factor, unit) in tables and plots, which show it if it has no axes.
    """

    name: str
    group: str
    unit: str
    meaning: str
    axes: tuple[str, ...] = ()
    printed: tuple[float, str] = (1.0, "")

    @property
    def printed_unit(self) -> str:
        """Unit of tables and plots."""
        return self.printed[1] or self.unit


_AT = "at the equilibrium of these currents"
_POINT = ("point", "component")
_IN_BOX = "|B - mean B| in record.box_mm, relative to |mean B|"
_IN_WORKSPACE = "in the workspace, relative to its largest value"
_MEAN = "mean magnitude of the currents; the lift current where they carry"
_PER_AMPERE = "derivative by the mean current of the force on the payload, a vertical dipole, at the points"
_LINKAGE = "derivative of the flux linkage of a coil by the current of another one, at these currents"
_AREA = (
    "area around the equilibrium, in its horizontal plane, in which the horizontal force is below force_share "
    "of the weight, as far as straight lines from the equilibrium stay in it"
)
_REACH = (
    "lowest z of the workspace, on the vertical through the place that is carried, at which these currents, scaled "
    "until a coil is at the limit, carry the payload"
)
_REACHABLE = "share of the workspace in which some currents within the limit hold the payload"
_MM, _PERCENT = (1e3, "mm"), (100.0, "%")
QUANTITIES = (
    Quantity("common_current", "currents", "A", _MEAN),
    Quantity("current", "currents", "A", "current of each coil", ("coil",)),
    Quantity("flux_density", "field", "T", "flux density B at the points", _POINT),
    Quantity("gradient", "field", "T m-1", "dB_component/dx_direction at the points", (*_POINT, "direction")),
    Quantity("force_per_ampere", "force_per_ampere", "N A-1", _PER_AMPERE, _POINT),
    *(
        Quantity(f"equilibrium_{x}", "equilibrium", "m", f"{x} of the magnet's centre {_AT}", (), _MM)
        for x in "xyz"
    ),
    Quantity("stiffness_x", "equilibrium", "N m-1", f"-dF_x/dx {_AT}"),
    Quantity("stiffness_y", "equilibrium", "N m-1", f"-dF_y/dy {_AT}"),
    Quantity("stiffness_z", "equilibrium", "N m-1", f"-dF_z/dz {_AT}: negative, unstable without control"),
    Quantity("equilibrium_area", "equilibrium_area", "m2", _AREA, (), (1e6, "mm2")),
    Quantity("reach_height", "reach", "m", _REACH, (), _MM),
    Quantity("reachable_share", "reachable_share", "1", _REACHABLE, (), _PERCENT),
    Quantity("power", "power", "W", "power of all windings at these currents"),
    Quantity("inhomogeneity", "homogeneity", "1", f"root mean square of {_IN_BOX}", (), _PERCENT),
    Quantity("largest_inhomogeneity", "homogeneity", "1", f"largest {_IN_BOX}", (), _PERCENT),
    Quantity("inductance", "inductance", "H", _LINKAGE, ("coil", "other_coil")),
    Quantity("largest_flux_density", "iron", "T", "largest flux density of an element of the iron"),
    Quantity("body_flux_density", "iron", "T", "largest flux density of an element of each body", ("body",)),
    Quantity("error_flux_density", "error", "1", f"estimated error of B {_IN_WORKSPACE}", (), _PERCENT),
    Quantity(
        "error_gradient", "error", "1", f"estimated error of the gradient {_IN_WORKSPACE}", (), _PERCENT
    ),
    Quantity("surface_faces", "error", "1", "faces of the mesh's surface"),
)

TAKEN = frozenset(
    {*AXES, *(quantity.name for quantity in QUANTITIES), "point_x", "point_y", "point_z", "problem"}
    | {"study_file", "device_file", "included_files"}
)
"""Names in the data set that a varied key cannot have."""

GROUPS = tuple(dict.fromkeys(quantity.group for quantity in QUANTITIES))
NEED_PAYLOAD = frozenset({"force_per_ampere", "equilibrium", "equilibrium_area", "reach", "reachable_share"})
ON_REQUEST = frozenset({"inductance", "power"})
"""Groups that are recorded only if a file names them: they need additional solves or assumptions."""


def recorded(groups: tuple[str, ...]) -> tuple[Quantity, ...]:
    """The quantities of some groups, in the order of all.

    >>> [quantity.name for quantity in recorded(("iron", "field"))]
    ['flux_density', 'gradient', 'largest_flux_density', 'body_flux_density']
    """
    return tuple(quantity for quantity in QUANTITIES if quantity.group in groups)


Places = dict[str, tuple[Quantity, tuple[int, ...]]]
"""Quantity and index of single numbers, by name."""


def number_names(groups: tuple[str, ...], labels: Mapping[str, Sequence[str]]) -> Places:
    """Every single number of some groups by its name, NAME or NAME LABEL ..., with its quantity and index.

    labels: of the entries along each axis.

    >>> labels = {"point": ["1"], "component": "xyz", "direction": "xyz", "body": ["disk"]}
    >>> names = number_names(("field", "iron"), labels)
    >>> list(names)[:2], list(names)[-2:]
    (['flux_density 1 x', 'flux_density 1 y'], ['largest_flux_density', 'body_flux_density disk'])
    >>> names["flux_density 1 z"][1]
    (0, 2)
    """
    found: Places = {}
    for quantity in recorded(groups):
        for at in itertools.product(*(range(len(labels[axis])) for axis in quantity.axes)):
            words = [labels[axis][k] for axis, k in zip(quantity.axes, at, strict=True)]
            found[" ".join([quantity.name, *words])] = quantity, at
    return found
