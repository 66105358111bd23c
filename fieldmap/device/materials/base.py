"""What a material is to the rest of the package, and how a law of one file becomes a choice of device files.

A law is a frozen class derived from `Material` (or from one of its two refinements here), in a module of its own in
`fieldmap.device.materials`; nothing else names it. Its fields say how a [material.NAME] table states them
(`fieldmap.inputs.declared`). In formulas h = mu0 H and b are both in tesla, J = b - h is the polarisation.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from fieldmap.device.made import Made
from fieldmap.errors import InputError
from fieldmap.inputs.declared import Key
from fieldmap.records import Record
from fieldmap.typing import Array

Role = Literal["iron", "magnet", "flux barrier"]

# Iron-cobalt, the strongest material known, saturates at 2.45 T.
LARGEST_POLARISATION_T = 3.0
Polarisation = Annotated[float, Field(gt=0, le=LARGEST_POLARISATION_T)]

LARGEST_COERCIVE_FIELD = 1e5
"""A/m: ten times what separates soft from hard magnetic materials."""

CoerciveField = Annotated[
    float,
    Key(
        Annotated[float, Field(ge=0, le=LARGEST_COERCIVE_FIELD)],
        "half the width of the hysteresis loop at B = 0; only `HysteresisSolver` follows it",
        "A_per_m",
    ),
]

SAMPLES = np.concatenate([[0.0], np.geomspace(1e-3, 1e7, 240)])
"""Where a law of initial permeability and saturation is sampled: chi h / saturation. At the last, J is saturated to
1e-7."""

NO_REMANENCE = np.zeros(3)
NO_REMANENCE.setflags(write=False)


@dataclass(frozen=True, eq=False, repr=False)
class LawPoints(Record):
    """Points of J(h) for monotone cubics: h (k,) from 0 on, J (k,), dJ/dh (k,), h and J in T. Past the last point J
    stays."""

    field: Array
    polarisation: Array
    slope: Array


class Material(Made):
    """What a body is made of.

    kind: the word for the law in device files.
    role: how the models take it. "iron" may be given another constant permeability; a "magnet" keeps its own; a
    "flux barrier" lets no flux pass. saturates: whether it follows a B(H) law that a linear solution does not know.
    """

    kind: ClassVar[str]
    role: ClassVar[Role] = "iron"
    saturates: ClassVar[bool] = False

    name: str
    initial_mu_r: float
    """Relative permeability at H = 0."""
    remanence: Array
    """Flux density (3,) in T at H = 0, in the device's frame."""

    @property
    @abstractmethod
    def description(self) -> str:
        """The law in words: its kind, the range in which it holds, and what holds outside."""

    @property
    def largest_polarisation(self) -> float:
        """The polarisation, T, that the law ends with or tends to; infinite where it has no end."""
        return np.inf

    @property
    def likeness(self) -> tuple[object, ...] | None:
        """What must be equal in materials that are alike (their remanence apart); None: the name in the device."""
        return None


class Iron(Material):
    """Soft iron: no remanence."""

    remanence = NO_REMANENCE


class SaturatingMaterial(Iron):
    """Soft iron with a single-valued B(H) law."""

    saturates: ClassVar[bool] = True
    coercive_field: float = 0.0
    """A/m, of iron with hysteresis, which `fieldmap.iron.HysteresisSolver` knows; other solutions leave it out."""
    initial_slope: str = "the initial slope of its law"
    """What a linear solution takes for its permeability, in words."""

    @property
    def left_out(self) -> str:
        """What solutions without memory leave out, in words."""
        known = f" (coercive field {self.coercive_field:g} A/m left out)" if self.coercive_field else ""
        return f"no hysteresis{known}"

    @property
    def field_range(self) -> tuple[float, float]:
        """mu0 H in T of a table's first and last point. Of a formula the first is infinite, and the last is where the
        formula ends; infinite where it holds everywhere."""
        return np.inf, np.inf

    @abstractmethod
    def points(self) -> LawPoints:
        """The law as the solvers take it. Called only where `fault` finds nothing."""

    @abstractmethod
    def fault(self) -> tuple[str, str] | None:
        """What must hold of the law and what was received instead; None for a law that iron can follow: dB/dH nowhere
        below that of free space, and a polarisation that ends somewhere."""

    def require_physical(self) -> None:
        """Raise InputError where there is a `fault`: a device made in Python has passed no reader."""
        fault = self.fault()
        if fault is not None:
            where = f"material '{self.name}'"
            raise InputError.of(where, *fault, "correct the law; docs/device_tables.md describes them")


@dataclass(frozen=True, repr=False)
class TwoConstantLaw(SaturatingMaterial):
    """A law that initial permeability and saturation polarisation (T) fix: J = saturation f(x), x = chi h / saturation,
    chi = mu_r - 1. A law of this kind defines `title`, `polarisation` and `susceptibility`."""

    title: ClassVar[str]

    name: str
    mu_r: Annotated[float, Key(Annotated[float, Field(gt=1)], "initial relative permeability")]
    saturation: Annotated[
        float, Key(Polarisation, "B - mu0 H in saturation", "T", name="saturation_polarisation")
    ]
    coercive_field: CoerciveField = 0.0

    @abstractmethod
    def polarisation(self, x: Array) -> Array:
        """Polarisation of the law.

        Parameters
        ----------
        x
            chi h / saturation.

        Returns
        -------
        Array
            J, T.
        """

    @abstractmethod
    def susceptibility(self, x: Array) -> Array:
        """Slope of the law.

        Parameters
        ----------
        x
            chi h / saturation.

        Returns
        -------
        Array
            dJ/dh.
        """

    @property
    def initial_mu_r(self) -> float:  # type: ignore[override]
        """Relative permeability at H = 0."""
        return self.mu_r

    @property
    def largest_polarisation(self) -> float:
        """The saturation polarisation, T."""
        return self.saturation

    def fault(self) -> tuple[str, str] | None:
        """See `SaturatingMaterial.fault`."""
        if self.mu_r > 1 and 0 < self.saturation < np.inf:
            return None
        text = "mu_r must be above 1 and the saturation polarisation a finite number above 0"
        return text, f"mu_r = {self.mu_r}, saturation = {self.saturation}"

    def points(self) -> LawPoints:
        """Samples that grow geometrically."""
        field = SAMPLES * self.saturation / (self.mu_r - 1)
        return LawPoints(field, self.polarisation(SAMPLES), self.susceptibility(SAMPLES))

    @property
    def description(self) -> str:
        """The law in words."""
        numbers = f"initial mu_r {self.mu_r:g}, saturation polarisation {self.saturation:g} T"
        return f"{self.title}, {numbers}"
