"""The controllers of an axis: from depth in mm to lift in V, from x or y in mm to a signal of the division."""

from typing import Annotated, Literal

from pydantic import Field, Tag, model_validator

from fieldmap.device.schema.base import NotNegative, Positive, Table, broken, chosen_by

Matrix = list[list[float]]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class PidKeys(Table):
    """The sampled PID of thesis (5-10); without Ti_s it is a PD controller."""

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
        default="none", description="what the integral does at a limit"
    )
    derivative: Literal["error", "measurement"] = Field(default="error", description="of what")

    @model_validator(mode="after")
    def _limits_rise(self) -> "PidKeys":
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise broken("lower must be below upper", f"{self.lower:g} and {self.upper:g}", "swap them")
        return self


class ConstantKeys(Table):
    """Open loop."""

    kind: Literal["constant"] = Field(description="an output that does not listen")
    output: float | None = Field(default=None, description="its value; what rests at the start unless given")


class RegulatorKeys(Table):
    """Optimal state feedback with an estimator and an integrator, thesis (7-15)..(7-21), on one axis."""

    kind: Literal["regulator"] = Field(description="LQR with a Kalman estimator")
    A: Matrix = Field(description="continuous model of the axis, mm and V: states by states")
    B: list[float] = Field(description="input of that model")
    C: list[float] = Field(description="output of that model, mm")
    Q: list[float] = Field(description="weights of the states and of the integral of the deviation")
    R: Positive = Field(description="weight of the input")
    process_noise: Positive = Field(description="variance of the input's disturbance")
    measurement_noise: Positive = Field(description="variance of the measurement, mm^2")
    equilibrium: Pair | None = Field(
        default=None,
        description="[V, V/mm]: lift that carries the body; what rests at the start unless given",
    )
    equilibrium_at: Literal["reference", "measured"] = Field(
        default="reference", description="where it is taken"
    )
    estimate: Literal["predicted", "filtered", "delayed"] = Field(
        default="filtered", description="what is fed back"
    )
    divisor: Positive = Field(default=1.0, description="of the feedback, 0.69 in (7-21)")
    lower: float | None = Field(default=None, description="limit of the output")
    upper: float | None = Field(default=None, description="limit of the output")

    @model_validator(mode="after")
    def _fits(self) -> "RegulatorKeys":
        n = len(self.A)
        square = all(len(row) == n for row in self.A)
        if not (square and len(self.B) == n == len(self.C) and len(self.Q) == n + 1):
            received = f"A with {n} rows, B {len(self.B)}, C {len(self.C)}, Q {len(self.Q)}"
            raise broken(
                "A must be square, B and C as long as it, Q one longer (the integral)",
                received,
                "correct the matrices",
            )
        return self


AxisController = Annotated[
    Annotated[PidKeys, Tag("pid")]
    | Annotated[ConstantKeys, Tag("constant")]
    | Annotated[RegulatorKeys, Tag("regulator")],
    chosen_by("kind"),
]
