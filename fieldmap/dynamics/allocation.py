"""Control allocation: from the outputs of a controller to the input voltages of the coils' amplifiers.

An allocation is a current parametrisation, or a matrix, for example that of least power for any number of coils:
docs/theory/closed_loop.md (23)..(25).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_positive, check_signal
from fieldmap.core.machine import Allocation
from fieldmap.currents import CurrentParametrisation, LiftAndDirections
from fieldmap.levitation.lift import idle_note, signal_pushes
from fieldmap.records import Record
from fieldmap.typing import Array

SIGNALS = ("lift_V", "x_signal", "y_signal")
"""Names of the outputs for the lift and for the forces along x and y."""


class ControlAllocation(ABC):
    """Map from outputs (m,) to the voltages (n,) of n coils.

    names (m,): of the outputs. idle: axes whose output has no effect. assumptions: of the allocation.
    """

    names: tuple[str, ...]
    idle: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    @property
    @abstractmethod
    def coils(self) -> int:
        """Number of voltages."""

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names (m,) of the outputs."""
        return self.names

    @abstractmethod
    def voltages(self, outputs: Array) -> Array:
        """Voltages of outputs.

        Parameters
        ----------
        outputs
            Outputs (m,) of the controller.

        Returns
        -------
        Array
            Voltages (n,), V.
        """

    @abstractmethod
    def derivative(self, outputs: Array) -> Array:
        """Derivative of the voltages with respect to the outputs.

        Parameters
        ----------
        outputs
            Outputs (m,) of the controller.

        Returns
        -------
        Array
            d voltages / d outputs (n, m).
        """

    @abstractmethod
    def nearest(self, voltages: Array) -> Array:
        """Outputs whose voltages are nearest to given voltages.

        Parameters
        ----------
        voltages
            Voltages (n,), V.

        Returns
        -------
        Array
            Outputs (m,).
        """

    @abstractmethod
    def numbers(self) -> Allocation:
        """The numbers for compiled loops."""


@dataclass(frozen=True, eq=False, repr=False)
class ParametrisedAllocation(Record, ControlAllocation):
    """Allocation by a current parametrisation: the outputs are its signals, its currents in A are the voltages in V.

    names (m,): of the outputs; by default the names of the signals.
    """

    parametrisation: CurrentParametrisation
    names: tuple[str, ...] = ()

    @property
    def coils(self) -> int:
        """Number of voltages."""
        return self.parametrisation.coil_count

    @property
    def output_names(self) -> tuple[str, ...]:
        """The given names, or the names of the signals."""
        return self.names or self.parametrisation.signal_names

    def voltages(self, outputs: Array) -> Array:
        """Voltages (n,), V."""
        return self.parametrisation.currents(outputs)

    def derivative(self, outputs: Array) -> Array:
        """d voltages / d outputs (n, m)."""
        return self.parametrisation.derivative(outputs)

    def nearest(self, voltages: Array) -> Array:
        """Outputs (m,): the nearest signals of the parametrisation."""
        return self.parametrisation.nearest(voltages).values

    def numbers(self) -> Allocation:
        """The numbers for compiled loops."""
        kernel = self.parametrisation.kernel()
        return Allocation(int(kernel.division), kernel.exponent, kernel.matrix, np.zeros(self.coils))


def lift_and_directions(n: float) -> ParametrisedAllocation:
    """Allocation from lift (V), x and y to the voltages of six coils in two rows of three: `LiftAndDirections`.

    Parameters
    ----------
    n
        Exponent of the division.

    Returns
    -------
    ParametrisedAllocation
        The allocation.
    """
    return ParametrisedAllocation(LiftAndDirections(n), SIGNALS)


@dataclass(frozen=True, eq=False, repr=False)
class MatrixAllocation(Record, ControlAllocation):
    """Allocation by a matrix: voltages = matrix (n, m) @ outputs (m,) + constant (n,).

    names (m,): of the outputs; by default "output_0" and so on. idle: axes whose output has no effect. assumptions:
    of the allocation.
    """

    matrix: Array
    constant: Array
    names: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    @property
    def coils(self) -> int:
        """Rows of the matrix."""
        return len(self.matrix)

    @property
    def output_names(self) -> tuple[str, ...]:
        """The given names, or numbers."""
        return self.names or tuple(f"output_{k}" for k in range(self.matrix.shape[1]))

    def voltages(self, outputs: Array) -> Array:
        """Voltages (n,), V."""
        return self.matrix @ outputs + self.constant

    def derivative(self, outputs: Array) -> Array:
        """The matrix."""
        return np.asarray(self.matrix, float)

    def nearest(self, voltages: Array) -> Array:
        """Outputs (m,) by least squares."""
        return np.asarray(np.linalg.pinv(self.matrix) @ (voltages - self.constant), float)

    def numbers(self) -> Allocation:
        """The numbers for compiled loops."""
        constant = np.array(np.broadcast_to(self.constant, (self.coils,)), float)
        return Allocation(0, 1.0, np.ascontiguousarray(self.matrix, float), constant)


def least_power_allocation(force_per_ampere: ArrayLike, shares: ArrayLike, volts: float) -> MatrixAllocation:
    """Allocation of least power from lift (V), x and y to the voltages of n coils.

    If the coils alone cannot push along x or y, the signal of that axis has no effect, and the assumptions say so.

    Parameters
    ----------
    force_per_ampere
        Derivatives (3, n) of the force with respect to the currents at the operating point, N/A.
    shares
        Shares (n,) of the coils in the lift voltage, such as `lift_shares`.
    volts
        Lift at the operating point. An x signal of 1 adds this voltage to the coil with the largest share. The shares
        are those of least power for a force along x only.

    Returns
    -------
    MatrixAllocation
        The allocation.

    Raises
    ------
    InputError
        For arguments that do not fit.

    Examples
    --------
    >>> allocation = least_power_allocation([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]], [1.0, 1.0], 2.0)
    >>> allocation.matrix.round(9).tolist(), allocation.idle
    ([[1.0, 2.0, 0.0], [1.0, -2.0, 0.0]], ('y',))
    """
    force = np.asarray(force_per_ampere, dtype=float)
    check_positive("least_power_allocation", volts=volts)
    lift = check_signal("least_power_allocation(shares)", shares)
    fits, must = lift.shape == force.shape[1:], f"must be ({force.shape[1]},)"
    check(fits, "least_power_allocation(shares)", must, lift.shape, "give one per coil")
    pushes, idle = signal_pushes(force)
    shown = ", ".join(f"{share:.3g}" for share in lift)
    pushed = " or ".join(axis for axis in "xy" if axis not in idle)
    signals = f"; a signal {pushed} of 1 adds {volts:.3g} V to a coil" if pushed else ""
    notes = (f"coils by least power: lift in the shares {shown}{signals}", *map(idle_note, idle))
    matrix = np.column_stack([lift, volts * pushes])
    return MatrixAllocation(matrix, np.zeros(len(lift)), SIGNALS, idle, notes)
