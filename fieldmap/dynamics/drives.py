"""What drives coupled coils, in the place of an ideal source of current: a controller of the current, a bridge; and how
windings warm up. docs/theory/electrical.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fieldmap.arguments import check, check_not_negative, check_positive
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import NotNegative, Positive
from fieldmap.records import Record
from fieldmap.typing import Array

ABSOLUTE_ZERO = -273.15
COPPER = 3.93e-3
"""Temperature coefficient of the resistance of copper at 20 degC, 1/K: IEC 60028."""


@dataclass(frozen=True, repr=False)
class CurrentController(Record):
    """A PI controller for the current of each coil: voltage = P (asked - current) + I times the integral of it.

    bandwidth: Hz, of the closed loop of a coil by itself, from which P = 2 pi bandwidth L and I = 2 pi bandwidth R
    follow; or both gains: proportional, V/A; integral, V/(A s). At a limit of the supply the integral is that of the
    reference which the limit allows (back-calculation).
    """

    bandwidth: Annotated[
        Positive | None, Key(..., "of the loop of a coil by itself; or proportional and integral", "Hz")
    ] = None
    proportional: Annotated[NotNegative | None, Key(..., "gain", "V_per_A")] = None
    integral: Annotated[NotNegative | None, Key(..., "gain of the integral", "V_per_A_s")] = None

    def __post_init__(self) -> None:
        where, gains = "CurrentController", (self.proportional, self.integral)
        if self.bandwidth is None:
            must = "must be given with integral, or bandwidth without both"
            check(None not in gains, f"{where}(proportional)", must, "None", "give bandwidth")
            check_positive(where, proportional=self.proportional or 0.0)
            check_not_negative(where, integral=self.integral or 0.0)
        else:
            check_positive(where, bandwidth=self.bandwidth)
            must = "must not be given with bandwidth"
            check(gains == (None, None), f"{where}(proportional, integral)", must, gains, "leave one out")

    def gains(self, resistance: Array, inductance: Array) -> tuple[Array, Array]:
        """The gains of each coil.

        Parameters
        ----------
        resistance
            Of the windings (n,), ohm.
        inductance
            Of the coils (n,), H.

        Returns
        -------
        tuple[Array, Array]
            P (n,), V/A, and I (n,), V/(A s).
        """
        if self.bandwidth is None:
            ones = np.ones(len(resistance))
            return float(self.proportional or 0.0) * ones, float(self.integral or 0.0) * ones
        rate = 2.0 * np.pi * self.bandwidth
        return rate * inductance, rate * resistance


@dataclass(frozen=True, repr=False)
class Bridge(Record):
    """An H-bridge at each coil, as its mean over periods of the PWM: voltage = duty times supply, less what it loses.

    frequency: of the PWM, Hz; dead_time: s, of each of both legs: they lose 2 dead_time frequency supply against the
    current; drop: V, of the two switches that conduct, against the current. ripple: A, half of the swing of the current
    in a period: within it the loss is in proportion to the mean current.
    """

    frequency: Annotated[Positive, Key(..., "of the PWM", "kHz")]
    dead_time: Annotated[NotNegative, Key(..., "of each leg", "us")] = 0.0
    drop: Annotated[NotNegative, Key(..., "of the two switches that conduct", "V")] = 0.0
    ripple: Annotated[Positive, Key(..., "half of the swing of the current in a period of the PWM", "mA")] = (
        1e-2
    )

    def __post_init__(self) -> None:
        check_positive("Bridge", frequency=self.frequency, ripple=self.ripple)
        check_not_negative("Bridge", dead_time=self.dead_time, drop=self.drop)
        must = "must be below half a period of the PWM"
        share = self.dead_time * self.frequency
        check(share < 0.5, "Bridge(dead_time)", must, f"{self.dead_time:g} s", "correct it")

    def loss(self, supply: float) -> float:
        """Mean voltage that it loses against the current.

        Parameters
        ----------
        supply
            V.

        Returns
        -------
        float
            V.
        """
        return 2.0 * self.dead_time * self.frequency * supply + self.drop


@dataclass(frozen=True, repr=False)
class Heating(Record):
    """How windings warm up, all alike: one temperature each, with a resistance to the surroundings.

    thermal_resistance: K/W; thermal_capacity: J/K; coefficient: of the resistance, 1/K, at the reference temperature,
    degC, to which the given resistance belongs; ambient: degC, also at the start; limit: degC.
    """

    thermal_resistance: Annotated[Positive, Key(..., "of a winding to the surroundings", "K_per_W")]
    thermal_capacity: Annotated[Positive, Key(..., "of a winding", "J_per_K")]
    coefficient: Annotated[
        NotNegative, Key(..., "of the resistance; that of copper unless given", "per_K")
    ] = COPPER
    reference: Annotated[float, Key(..., "to which the resistance belongs", "degC")] = 20.0
    ambient: Annotated[float, Key(..., "of the surroundings, and of the windings at the start", "degC")] = (
        20.0
    )
    limit: Annotated[float, Key(..., "that windings stand", "degC")] = np.inf

    def __post_init__(self) -> None:
        where = "Heating"
        check_positive(
            where, thermal_resistance=self.thermal_resistance, thermal_capacity=self.thermal_capacity
        )
        check_not_negative(where, coefficient=self.coefficient)
        for name in ("reference", "ambient"):
            must, value = "must be above absolute zero", getattr(self, name)
            check(value > ABSOLUTE_ZERO, f"{where}({name})", must, f"{value:g} degC", "give degrees Celsius")
        must = "must be above ambient"
        check(self.limit > self.ambient, f"{where}(limit)", must, f"{self.limit:g} degC", "correct one")
