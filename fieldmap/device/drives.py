"""The drive of coils, chosen by the same keys in device and scenario files: controller of the current, bridge, and
warming of the windings. docs/theory/electrical.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.arguments import check, check_numbers, check_positive
from fieldmap.inputs.declared import Key, check_fields, table_of
from fieldmap.inputs.tables import NotNegative, Positive, broken
from fieldmap.records import Record
from fieldmap.typing import Array

Celsius = Annotated[float, Field(gt=-273.15)]
"""Rule for a temperature in degrees Celsius."""
COUPLED = ("current_controller", "voltage", "bridge")
"""Drives that give voltages, with the coils coupled by the map."""
COPPER = 3.93e-3
"""Temperature coefficient of the resistance of copper at 20 degC, 1/K: IEC 60028."""


def _with_proportional(integral: float | None, info: ValidationInfo) -> None:
    bandwidth, proportional = (info.data.get(name) for name in ("bandwidth_Hz", "proportional_V_per_A"))
    given = [one is not None for one in (bandwidth, proportional, integral)]
    if given not in ([True, False, False], [False, True, True]):
        must = "must be given with proportional, and both without bandwidth; or bandwidth alone"
        received = f"bandwidth {bandwidth}, proportional {proportional}, integral {integral}"
        raise broken(must, received, "correct them")


def _below_half_a_period(dead_time: float, info: ValidationInfo) -> None:
    frequency = info.data.get("frequency_kHz")
    if frequency is not None and 1e-3 * dead_time * frequency >= 0.5:
        raise broken("must be below half a period of the PWM", f"{dead_time:g} us", "correct it")


def _above_ambient(limit: float | None, info: ValidationInfo) -> None:
    if limit is not None and limit <= info.data.get("ambient_degC", limit - 1.0):
        raise broken("must be above ambient", f"{limit:g} degC", "correct one")


@dataclass(frozen=True, repr=False)
class CurrentController(Record):
    """A PI controller for the current of each coil: voltage = P error + I times the integral of the error.

    bandwidth: Hz, of the closed loop of a coil by itself, which sets P = 2 pi bandwidth L and I = 2 pi bandwidth R; or
    both gains: proportional, V/A; integral, V/(A s). While the supply limits the voltage, the integral takes the
    reference that just needs this voltage (back-calculation).
    """

    bandwidth: Annotated[
        Positive | None, Key(..., "of the loop of a coil by itself; or proportional and integral", "Hz")
    ] = None
    proportional: Annotated[Positive | None, Key(..., "gain", "V_per_A")] = None
    integral: Annotated[
        NotNegative | None, Key(..., "gain of the integral", "V_per_A_s", check=_with_proportional)
    ] = None

    def __post_init__(self) -> None:
        check_fields(self)

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
    """An H-bridge at each coil, averaged over PWM periods: voltage = duty times supply, minus the loss of the bridge.

    frequency: of the PWM, Hz; dead_time: s, of each leg; the two legs lose 2 dead_time frequency supply, against the
    current; drop: V, of the two conducting switches, against the current. ripple: A, half of the peak-to-peak current
    ripple; the loss is proportional to the mean current where that is smaller than the ripple.
    """

    frequency: Annotated[Positive, Key(..., "of the PWM", "kHz")]
    dead_time: Annotated[NotNegative, Key(..., "of each leg", "us", check=_below_half_a_period)] = 0.0
    drop: Annotated[NotNegative, Key(..., "of the two switches that conduct", "V")] = 0.0
    ripple: Annotated[Positive, Key(..., "half of the swing of the current in a period of the PWM", "mA")] = (
        1e-2
    )

    def __post_init__(self) -> None:
        check_fields(self)

    def loss(self, supply: float) -> float:
        """Mean loss of voltage, against the current.

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
    """Warming of windings: each has one temperature, and all have the same constants.

    thermal_resistance: of a winding to the surroundings, K/W; thermal_capacity: J/K; coefficient: of the resistance,
    1/K, at `reference`, degC, the temperature of the stated resistance; ambient: degC, also the temperature at the
    start; limit: highest permitted temperature, degC.
    """

    thermal_resistance: Annotated[Positive, Key(..., "of a winding to the surroundings", "K_per_W")]
    thermal_capacity: Annotated[Positive, Key(..., "of a winding", "J_per_K")]
    coefficient: Annotated[
        NotNegative, Key(..., "of the resistance; that of copper unless given", "per_K")
    ] = COPPER
    reference: Annotated[Celsius, Key(..., "to which the resistance belongs", "degC")] = 20.0
    ambient: Annotated[Celsius, Key(..., "of the surroundings, and of the windings at the start", "degC")] = (
        20.0
    )
    limit: Annotated[float, Key(..., "that windings stand", "degC", check=_above_ambient)] = np.inf

    def __post_init__(self) -> None:
        check_fields(self)

    def time_to_limit(self, resistance: float, *, current: float = 0.0, voltage: float = 0.0) -> float:
        """Time from the ambient temperature to the limit, at a lasting current or a lasting voltage.

        Parameters
        ----------
        resistance
            Of the winding at the reference temperature, ohm.
        current, voltage
            A or V: one of them.

        Returns
        -------
        float
            s; infinite where the winding never reaches the limit.

        Raises
        ------
        InputError
            For a resistance that is not positive, and for both a current and a voltage.

        Examples
        --------
        >>> round(Heating(10.0, 50.0, 0.0, limit=120.0).time_to_limit(5.0, current=2.0))  # 500 s times ln 2
        347
        """
        where, remedy = "Heating.time_to_limit", "give one of them"
        check_positive(where, resistance=resistance)
        check_numbers(where, current=current, voltage=voltage)
        received = f"{current:g} A and {voltage:g} V"
        check(current * voltage == 0.0, where, "must have a current or a voltage", received, remedy)

        def rate(degrees: Array | float) -> Any:
            ohms = resistance * (1.0 + self.coefficient * (np.asarray(degrees) - self.reference))
            power = current**2 * ohms + voltage**2 / ohms
            return (power - (degrees - self.ambient) / self.thermal_resistance) / self.thermal_capacity

        if np.isinf(self.limit) or min(rate(self.ambient), rate(self.limit)) <= 0.0:
            return float(np.inf)
        # The time is the integral of 1 / rate over the temperature. The variable of Gauss's rule is the logarithm of a
        # rate that falls linearly with the temperature, in which the integrand is smooth near the limit, too.
        nodes, weights = np.polynomial.legendre.leggauss(32)
        fall = float(np.log(rate(self.limit) / rate(self.ambient))) or 1e-9
        shares, span = 0.5 * (1.0 + nodes), (self.limit - self.ambient) / np.expm1(fall)
        degrees = self.ambient + span * np.expm1(fall * shares)
        return float(0.5 * weights @ (span * fall * np.exp(fall * shares) / rate(degrees)))


@dataclass(frozen=True, repr=False, kw_only=True)
class DriveChoice(Record):
    """The drive that a device or a scenario names.

    mode: None takes the mode of the device in a scenario, and "ideal" in a device. controller, bridge, heating: None
    takes those of the device, if any. slope: fastest change of the reference, A/s for currents, V/s for voltages.
    """

    mode: Annotated[
        Literal["ideal", "current_controller", "voltage", "bridge"] | None,
        Key(
            ...,
            "ideal: a source of current; the others give voltages to coils, which the linkages of the map couple "
            "with each other and with the magnet. A scenario takes what it does not give from the device, whose "
            "default is ideal",
            name="drive",
            examples=("bridge",),
        ),
    ] = None
    controller: Annotated[
        CurrentController | None,
        Key(table_of(CurrentController) | None, "of the current, for current_controller"),
    ] = None
    bridge: Annotated[Bridge | None, Key(table_of(Bridge) | None, "at each coil, for bridge")] = None
    heating: Annotated[Heating | None, Key(table_of(Heating) | None, "how coupled windings warm up")] = None
    slope: Annotated[
        float | None,
        Key(
            Positive | None,
            "fastest change of what a coupled drive is asked for, A/s, or V/s of voltages",
            "per_s",
        ),
    ] = None

    def over(self, other: DriveChoice) -> dict[str, Any]:
        """The fields of a choice, from `other` where this one has none.

        Parameters
        ----------
        other
            The choice of the device.

        Returns
        -------
        dict[str, Any]
            The fields by their names; a mode that neither names is "ideal".
        """
        mine = {each.name: getattr(self, each.name) for each in fields(DriveChoice)}
        found = {name: getattr(other, name) if value is None else value for name, value in mine.items()}
        return found | {"mode": found["mode"] or "ideal"}


def lacking(
    chosen: Mapping[str, Any], supply: Any, without: Sequence[str]
) -> tuple[str, str, str, str] | None:
    """The first requirement of a chosen drive that is not met, for device and scenario files.

    Parameters
    ----------
    chosen
        mode, controller and bridge, by their names.
    supply
        Of the driver, V; None for none.
    without
        Names of the coils that have no resistance.

    Returns
    -------
    tuple[str, str, str, str] | None
        The key of the finding, what must hold, what was received, and the remedy; None if nothing is missing.
    """
    mode = chosen["mode"]
    if mode not in COUPLED:
        return None
    if without:
        must = "needs the resistance of every coil"
        return "drive", must, f"none of {', '.join(without)}", "add resistance_ohm to each"
    table = {"current_controller": "controller", "bridge": "bridge"}.get(mode)
    if table is not None and chosen[table] is None:
        return table, f'must be there with drive = "{mode}"', "none", "add the table"
    if mode == "bridge" and not supply:
        return "drive", "needs a supply", "a bridge without", "add driver.supply_voltage_V to the device"
    return None
