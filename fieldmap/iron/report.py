"""What a solve cost and how well it went."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SolverReport:
    """Counts, times and residuals of one linear solve.

    tetrahedra, surface_faces, charged_faces: size of the problem; magnetic_bodies: connected pieces of iron;
    seconds: wall time per step; iterations and residual: of the worst source; matrix_bytes: memory of the dense
    matrix; assumptions: everything the result rests on that the device file or the caller chose.
    """

    tetrahedra: int
    surface_faces: int
    charged_faces: int
    magnetic_bodies: int
    iterations: int
    residual: float
    matrix_bytes: int
    seconds: dict[str, float]
    assumptions: tuple[str, ...]

    @property
    def total_seconds(self) -> float:
        """Wall time of the whole solve."""
        return sum(self.seconds.values())

    def __str__(self) -> str:
        steps = ", ".join(f"{name} {value:.1f} s" for name, value in self.seconds.items())
        return (
            f"{self.tetrahedra} tetrahedra, {self.surface_faces} surface faces, {self.magnetic_bodies} magnetic "
            f"bodies; {self.iterations} iterations to {self.residual:.1e}; {self.total_seconds:.1f} s ({steps})"
        )
