"""Keys of controllers: of an axis, from depth in mm to lift in V and from x or y in mm to its signal; of all axes."""

from typing import Annotated, Literal

from pydantic import Field, Tag, model_validator

from fieldmap.inputs.tables import NotNegative, Positive, Table, Vector, broken, chosen_by

Matrix = list[list[float]]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
LIMITS = (
    "0 to 10 V, -0.4 to 0.4 for lift and directions; else 0 to what the amplifiers give, or from minus that where "
    "something that no current drives lifts as well, -1 to 1, unless given"
)
Lengths = Annotated[list[Positive], Field(min_length=3, max_length=3)]


class PidKeys(Table):
    """A sampled PID controller; without Ti_s a PD controller."""

    kind: Literal["pid"] = Field(description="PID")
    Kc: float = Field(description="gain, output per mm")
    Ti_s: Positive | None = Field(default=None, description="integral time in seconds; none: no integral")
    Td_s: NotNegative = Field(default=0.0, description="derivative time in seconds")
    lower: float | None = Field(default=None, description="limit of the output")
    upper: float | None = Field(default=None, description="limit of the output")
    integration: Literal["rectangular", "trapezoidal"] = Field(
        default="trapezoidal", description="of the error"
    )
    anti_windup: Literal["none", "hold", "track"] = Field(
        default="none", description="behaviour of the integral at a limit"
    )
    derivative: Literal["error", "measurement"] = Field(default="error", description="of what")

    @model_validator(mode="after")
    def _limits_rise(self) -> "PidKeys":
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise broken("lower must be below upper", f"{self.lower:g} and {self.upper:g}", "swap them")
        return self


class ConstantKeys(Table):
    """Open loop."""

    kind: Literal["constant"] = Field(description="a constant output")
    output: float | None = Field(
        default=None, description="its value; that of the equilibrium at the start unless given"
    )


class RegulatorKeys(Table):
    """Optimal state feedback with an estimator and an integrator, on one axis."""

    kind: Literal["regulator"] = Field(description="LQR with a Kalman estimator")
    A: Matrix = Field(description="continuous model of the axis, mm and V: states by states")
    B: list[float] = Field(description="input of that model")
    C: list[float] = Field(description="output of that model, mm")
    Q: list[float] | Matrix = Field(
        description="weights of the states and of the integral of the deviation: their diagonal, or the matrix"
    )
    R: Positive = Field(description="weight of the input")
    process_noise: Positive = Field(description="variance of the input's disturbance")
    measurement_noise: Positive = Field(description="variance of the measurement, mm^2")
    equilibrium: Pair | None = Field(
        default=None,
        description="[V, V/mm]: lift that carries the body; that of the equilibrium at the start unless given",
    )
    equilibrium_at: Literal["reference", "measured"] = Field(
        default="reference", description="where it is taken"
    )
    estimate: Literal["predicted", "filtered", "delayed"] = Field(
        default="filtered", description="what is fed back"
    )
    divisor: Positive = Field(default=1.0, description="of the feedback")
    lower: float | None = Field(default=None, description="limit of the output")
    upper: float | None = Field(default=None, description="limit of the output")

    @model_validator(mode="after")
    def _fits(self) -> "RegulatorKeys":
        n = len(self.A)
        square = all(len(row) == n for row in self.A)
        weights = all(len(row) == n + 1 for row in self.Q if isinstance(row, list)) and len(self.Q) == n + 1
        if not (square and len(self.B) == n == len(self.C) and weights):
            received = f"A with {n} rows, B {len(self.B)}, C {len(self.C)}, Q {len(self.Q)}"
            raise broken(
                "A must be square, B and C as long as it, Q one longer (the integral)",
                received,
                "correct the matrices",
            )
        return self


class CoupledKeys(Table):
    """What regulators of all axes are designed for: deviations that count alike, and noise. x, y and depth."""

    allowed_mm: Lengths = Field(
        default=[0.3, 0.3, 0.3], description="deviations of x, y, depth that count alike"
    )
    allowed_mm_per_s: Lengths = Field(default=[10.0, 10.0, 30.0], description="velocities that count as much")
    noise_mm: Lengths | None = Field(
        default=None, description="deviation of the readings of x, y and depth; by default from [sensors]"
    )
    shaking_mN: Lengths = Field(
        default=[0.02, 0.02, 0.1], description="noise of the force on the body, per root of Hz"
    )
    drift_mN: Lengths = Field(
        default=[0.5, 0.5, 2.0], description="of forces that are not known, per root of s"
    )
    lower: Vector | None = Field(default=None, description=f"lowest lift in V, x and y signals; {LIMITS}")
    upper: Vector | None = Field(default=None, description=f"highest lift in V, x and y signals; {LIMITS}")

    @model_validator(mode="after")
    def _limits_rise(self) -> "CoupledKeys":
        both = self.lower is not None and self.upper is not None
        if both and not all(a < b for a, b in zip(self.lower or (), self.upper or (), strict=True)):
            raise broken("lower must be below upper", f"{self.lower} and {self.upper}", "swap them")
        return self


class LqgKeys(CoupledKeys):
    """A regulator of all axes on physical states from the linearised machine, scheduled over the depth."""

    kind: Literal["lqg"] = Field(
        description="LQR with a Kalman filter on position, velocity and unknown force"
    )
    allowed_outputs: Lengths = Field(
        default=[1.0, 0.1, 0.1], description="lift in V, x and y that count as much"
    )
    depths_mm: Pair | None = Field(
        default=None, description="from where to where it is designed; at the start alone unless given"
    )
    designs: Annotated[int, Field(ge=2, le=100)] = Field(
        default=11, description="how many, evenly between them"
    )

    @model_validator(mode="after")
    def _depths_rise(self) -> "LqgKeys":
        if self.depths_mm is not None and self.depths_mm[0] >= self.depths_mm[1]:
            raise broken("the first of depths_mm must be less", f"{self.depths_mm}", "swap them")
        return self


class LinearisationKeys(CoupledKeys):
    """Feedback linearisation: a regulator of a free mass, whose forces the inverse map turns into outputs."""

    kind: Literal["feedback_linearisation"] = Field(description="forces by the inverse map at every sample")
    allowed_mN: Lengths = Field(default=[5.0, 5.0, 20.0], description="forces that count as much")
    rounds: Annotated[int, Field(ge=1, le=20)] = Field(
        default=2, description="of Newton's method at a sample"
    )


class OwnKeys(Table):
    """A function in the place of all controllers: `fieldmap.simulate(..., controller=function)`, or `fieldmap simulate
    --controller FILE.py:NAME`."""

    kind: Literal["own"] = Field(description="a function of one's own, which the caller gives")


CoupledController = Annotated[
    Annotated[LqgKeys, Tag("lqg")]
    | Annotated[LinearisationKeys, Tag("feedback_linearisation")]
    | Annotated[OwnKeys, Tag("own")],
    chosen_by("kind"),
]


class FeedforwardKeys(Table):
    """Outputs along the reference by the inverse map, beside any controller."""

    field_error: Annotated[float, Field(gt=-0.9, lt=9.0)] = Field(
        default=0.0,
        description="share by which its field is larger than the machine's: a model that is wrong",
    )
    fastest_mm_per_s: Positive = Field(
        default=50.0, description="beyond it a change of the reference is a step"
    )
    largest_m_per_s2: Positive = Field(default=3.0, description="acceleration that is fed forward at most")
    lower: Vector | None = Field(default=None, description=f"lowest lift in V, x and y signals; {LIMITS}")
    upper: Vector | None = Field(default=None, description=f"highest lift in V, x and y signals; {LIMITS}")


AxisController = Annotated[
    Annotated[PidKeys, Tag("pid")]
    | Annotated[ConstantKeys, Tag("constant")]
    | Annotated[RegulatorKeys, Tag("regulator")],
    chosen_by("kind"),
]
