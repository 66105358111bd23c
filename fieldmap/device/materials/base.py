"""Base classes of materials.

A law is a frozen class derived from `Material` or one of its subclasses here, in a module of its own in
`fieldmap.device.materials`; no other code names it. The annotations of its fields define the keys of a [material.NAME]
table (`fieldmap.inputs.declared`). In formulas h = mu0 H and b are both in tesla, J = b - h is the polarisation.
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
"""A/m: ten times the coercive field that separates soft from hard magnetic materials."""

CoerciveField = Annotated[
    float,
    Key(
        Annotated[float, Field(ge=0, le=LARGEST_COERCIVE_FIELD)],
        "half the width of the hysteresis loop at B = 0; only `HysteresisSolver` follows it",
        "A_per_m",
    ),
]

SAMPLES = np.concatenate([[0.0], np.geomspace(1e-3, 1e7, 240)])
"""Values of chi h / saturation at which a saturating law is sampled. At the last value J is saturated to 1e-7."""

NO_REMANENCE = np.zeros(3)
NO_REMANENCE.setflags(write=False)


@dataclass(frozen=True, eq=False, repr=False)
class LawPoints(Record):
    """Points of J(h) for monotone cubics: h (k,) from 0 on, J (k,), dJ/dh (k,), h and J in T. J is constant past the
    last point."""

    field: Array
    polarisation: Array
    slope: Array


class Material(Made):
    """The material of a body.

    kind: the word for the law in device files. role: models may give "iron" another constant permeability; a "magnet"
    keeps its own; a "flux barrier" lets no flux pass. saturates: whether its B(H) law is nonlinear.
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
        """The saturation polarisation of the law, T; infinite where it does not saturate."""
        return np.inf

    @property
    def likeness(self) -> tuple[object, ...] | None:
        """Materials with equal values are alike, except for their remanence; None: they are compared by name."""
        return None


class Iron(Material):
    """Soft iron: no remanence."""

    remanence = NO_REMANENCE


class SaturatingMaterial(Iron):
    """Soft iron with a single-valued B(H) law."""

    saturates: ClassVar[bool] = True
    coercive_field: float = 0.0
    """A/m, of iron with hysteresis; only `fieldmap.iron.HysteresisSolver` uses it."""
    initial_slope: str = "the initial slope of its law"
    """The permeability that a linear solution uses, in words."""

    @property
    def left_out(self) -> str:
        """The effects that solutions without hysteresis neglect, in words."""
        known = f" (coercive field {self.coercive_field:g} A/m left out)" if self.coercive_field else ""
        return f"no hysteresis{known}"

    @property
    def field_range(self) -> tuple[float, float]:
        """mu0 H, T, of the first and last point of a table. For a formula the first is infinite, and the last is the
        end of its range, which may be infinite."""
        return np.inf, np.inf

    @abstractmethod
    def points(self) -> LawPoints:
        """The law as points for the solvers; valid only where `fault` returns None."""

    @abstractmethod
    def fault(self) -> tuple[str, str] | None:
        """What must hold of the law and what was received; None for a law that iron can follow: one with a positive
        dB/dH and a polarisation that saturates."""

    def require_physical(self) -> None:
        """Raise InputError where there is a `fault`: a device made in Python was not checked by the file reader."""
        fault = self.fault()
        if fault is not None:
            where = f"material '{self.name}'"
            raise InputError.of(where, *fault, "correct the law; docs/device_tables.md describes them")


@dataclass(frozen=True, repr=False)
class TwoConstantLaw(SaturatingMaterial):
    """A law of two constants, initial permeability mu_r and saturation polarisation (T): J = saturation f(x), x = chi h
    / saturation, chi = mu_r - 1. Subclasses define `title`, `polarisation` and `susceptibility`."""

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
