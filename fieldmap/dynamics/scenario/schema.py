"""What a scenario file may hold: the tables of the TOML file, with their rules. Lengths in mm, as their keys say."""

from typing import Annotated, Literal

from pydantic import Field, Tag, model_validator

from fieldmap.dynamics.scenario.controller_schema import AxisController, CoupledController, FeedforwardKeys
from fieldmap.errors import ScenarioError
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import (
    Format,
    NotNegative,
    Point,
    Positive,
    Table,
    Text,
    Vector,
    broken,
    chosen_by,
)
from fieldmap.instruments.converter import USUAL_RANGE

ASSUMED_MM_PER_V = 2.0
"""Of the sensors' outputs in a scenario that has a converter and does not say."""
MOST_PERIODS = 5_000_000
"""Of a run, which then takes some 2.5 GB."""
MOST_STEPS = 1_000_000
"""Of the mechanics in one control period."""
Count = Annotated[int, Field(ge=1)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class FieldKeys(Table):
    """How the map's field follows the currents."""

    scale: Positive = Field(default=1.0, description="calibration: the map's field is multiplied by it")
    iron: Literal["auto", "linearised", "model", "table"] = Field(
        default="auto",
        description="of saturating iron: its model solved whenever currents change, a table over lift and directions, "
        "which takes seconds to make and pays in hundreds of runs, or linearised about the currents of the operating "
        "point; auto: the model, or the table if its nodes are given",
    )
    table: Annotated[list[Annotated[int, Field(ge=4)]], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="nodes of that table for u, x and y, each at least 4; as many as it needs unless given",
    )


class BodyKeys(Table):
    """The body around the device's magnet."""

    turning: Literal["free", "upright"] = Field(
        default="free", description="free: six degrees of freedom; upright: it does not turn"
    )
    radius_mm: Positive | None = Field(default=None, description="of the cylinder; the magnet's unless given")
    height_mm: Positive | None = Field(default=None, description="of the cylinder; the magnet's unless given")
    below_mm: Positive | None = Field(default=None, description="magnet's centre above the lower face")
    centre_of_mass_mm: float = Field(default=0.0, description="above the magnet's centre")
    magnet_offset_mm: NotNegative | None = Field(
        default=None, description="magnet's centre below the sensed point; the device's unless given"
    )
    finite_magnet: bool = Field(default=False, description="the magnet's volume instead of a point dipole")


class DragKeys(Table):
    """Resistance of the air."""

    linear_N_s_per_m: Vector = Field(default=[0.0] * 3, description="along the map's x, y, z")
    body_linear_N_s_per_m: Vector = Field(default=[0.0] * 3, description="along the body's axes")
    body_quadratic_N_s2_per_m2: Vector = Field(default=[0.0] * 3, description="along the body's axes")
    turning_N_m_s: Vector = Field(default=[0.0] * 3, description="about the body's axes")


class PlateKeys(Table):
    """A conducting plate."""

    conductivity_S_per_m: Positive = Field(description="3.5e7 for aluminium")
    thickness_mm: Positive = Field(description="thickness")
    face_mm: Point = Field(description="[x, y, z] of a point of the face that the magnet sees")
    normal: Vector = Field(default=[0.0, 0.0, 1.0], description="of that face, to the side of the magnet")


class WallKeys(Table):
    """What the body can touch."""

    floor_mm: float | None = Field(default=None, description="z of a floor")
    ceiling_mm: float | None = Field(default=None, description="z of a ceiling")
    tube_radius_mm: Positive | None = Field(default=None, description="of an upright tube about the z axis")
    restitution: Annotated[float, Field(gt=0, le=1)] = Field(default=0.3, description="of a bounce")
    friction: NotNegative = Field(default=0.3, description="Coulomb's coefficient")
    end: list[Literal["floor", "ceiling", "tube"]] = Field(
        default=["floor", "ceiling", "tube"], description="contacts that end the run"
    )


class CoilKeys(Table):
    """Windings and amplifiers."""

    dynamics: bool = Field(
        default=True, description="R and L of the device's coils; false: currents follow at once"
    )
    lowest_voltage_V: float | None = Field(
        default=None, description="at a winding; minus the supply's unless given"
    )
    time_constant_ms: NotNegative = Field(default=0.0, description="of the amplifier's own answer")
    noise_A: NotNegative = Field(default=0.0, description="standard deviation of the current")
    output_bits: Annotated[int, Field(ge=1, le=32)] | None = Field(
        default=None, description="of the output converter"
    )
    output_range_V: Positive = Field(
        default=USUAL_RANGE, description="of the output converter, to both sides; assumed unless given"
    )
    end_beyond_table: bool = Field(
        default=False, description="currents beyond the table of the iron, or its model's domain, end the run"
    )
    longest_saturation_s: NotNegative = Field(
        default=0.0, description="a limit that holds longer ends the run; 0 for never"
    )


class SensorKeys(Table):
    """Position sensors."""

    deviation_mm: Vector = Field(
        default=[0.0] * 3, description="noise of the two crossed sensors and the vertical one"
    )
    angle_deg: float = Field(default=0.0, description="of the crossed sensors against x and y")
    zero_depth_mm: float = Field(
        default=0.0, description="depth below the map's origin at which the vertical sensor reads 0"
    )
    step_mm: NotNegative = Field(default=0.0, description="resolution of the sensors")
    input_bits: Annotated[int, Field(ge=1, le=32)] | None = Field(
        default=None, description="of the input converter"
    )
    input_range_V: Positive = Field(
        default=USUAL_RANGE, description="of the input converter, to both sides; assumed unless given"
    )
    mm_per_V: Positive = Field(
        default=ASSUMED_MM_PER_V,
        description="of the sensors' outputs, for input_bits; assumed unless given",
    )
    input_noise_V: NotNegative = Field(default=0.0, description="of the input converter")
    scan_rate_Hz: NotNegative = Field(default=0.0, description="0: shows what is at each sample")
    averages: Count | Annotated[list[Count], Field(min_length=3, max_length=3)] = Field(
        default=1, description="scans whose mean is shown; one number, or one for each sensor"
    )
    deviation_averages: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="averages with which deviation_mm was measured; `averages` unless given"
    )
    latency_scans: Annotated[int, Field(ge=0)] = Field(default=0, description="by which a mean comes late")


class CompensatorKeys(Table):
    """A push of the vertical reference when the horizontal one moves."""

    push_mm: float = Field(description="how far the reference is pushed")
    duration_ms: Positive = Field(description="how long the push lasts")
    axis: Literal["x", "y"] = Field(default="x", description="whose reference sets it off")


class ControlKeys(Table):
    """The controllers and their clock."""

    period_ms: Positive = Field(default=2.0, description="of the control task")
    delay_ms: NotNegative = Field(default=0.0, description="from sample to command, at most one period")
    step_ms: Positive = Field(default=0.1, description="of the mechanics")
    allocation: Literal["lift_and_directions", "least_power"] | None = Field(
        default=None,
        description="how lift, x and y become currents: those of six coils in two rows of three, or by least power "
        "about the start; unless given as the map was made for, and by least power with any other map",
    )
    allocation_n: Positive | None = Field(
        default=None,
        description="n of lift_and_directions: how much more the two coils in the middles of the rows follow x; that "
        "of the map unless given",
    )
    z: AxisController | None = Field(default=None, description="depth in mm to lift voltage")
    x: AxisController | None = Field(default=None, description="x in mm to x signal")
    y: AxisController | None = Field(default=None, description="y in mm to y signal")
    coupled: CoupledController | None = Field(
        default=None, description="one controller of all axes, instead of x, y and z"
    )
    feedforward: FeedforwardKeys | None = Field(
        default=None, description="along the reference, by the inverse map"
    )
    compensator: CompensatorKeys | None = Field(default=None, description="push of the vertical reference")

    @model_validator(mode="after")
    def _axes_or_coupled(self) -> "ControlKeys":
        given = [axis for axis in "zxy" if getattr(self, axis) is not None]
        if len(given) != (0 if self.coupled is not None else 3):
            received = ", ".join(given + (["coupled"] if self.coupled is not None else [])) or "none"
            must = "must have either z, x and y, or coupled"
            raise broken(must, received, "give every axis a controller, or one for all")
        steps = self.period_ms / self.step_ms
        if steps > MOST_STEPS:
            must = f"step_ms must be at least a part of {MOST_STEPS} of period_ms"
            raise broken(must, f"{self.step_ms:g} of {self.period_ms:g}", "take a larger step")
        return self


class StartKeys(Table):
    """Where the run begins, in equilibrium unless said otherwise."""

    depth_mm: float | None = Field(
        default=None,
        description="reading of the vertical sensor; the middle of the map, or next to it where the coils carry the "
        "body easily, unless given",
    )
    x_mm: float | None = Field(default=None, description="left out: where the x signal lets the body float")
    y_mm: float | None = Field(default=None, description="left out: where the y signal lets the body float")
    shift_mm: Vector = Field(default=[0.0] * 3, description="away from equilibrium: x, y, depth")
    velocity_mm_per_s: Vector = Field(default=[0.0] * 3, description="x, y, z")
    lean_deg: float = Field(default=0.0, description="about x, away from equilibrium")


class StepKeys(Table):
    """A step, or equal steps one after the other."""

    kind: Literal["step"] = Field(description="a step")
    axis: Literal["x", "y", "depth"] = Field(description="whose reference")
    at_s: NotNegative = Field(description="when")
    by_mm: float = Field(description="by how much")
    times: Annotated[int, Field(ge=1, le=MOST_PERIODS)] = Field(default=1, description="how many of them")
    every_s: Positive = Field(default=1.0, description="time from one to the next")


class RampKeys(Table):
    """A ramp."""

    kind: Literal["ramp"] = Field(description="a ramp")
    axis: Literal["x", "y", "depth"] = Field(description="whose reference")
    at_s: NotNegative = Field(description="when it begins")
    by_mm: float = Field(description="by how much in all")
    rate_mm_per_s: Positive = Field(description="how fast")


class SineKeys(Table):
    """A sine."""

    kind: Literal["sine"] = Field(description="a sine")
    axis: Literal["x", "y", "depth"] = Field(description="whose reference")
    at_s: NotNegative = Field(default=0.0, description="when it begins")
    amplitude_mm: float = Field(description="amplitude")
    frequency_Hz: Positive = Field(description="frequency")


class BinaryKeys(Table):
    """A pseudo-random binary sequence."""

    kind: Literal["prbs"] = Field(description="a pseudo-random binary sequence")
    axis: Literal["x", "y", "depth"] = Field(description="whose reference")
    at_s: NotNegative = Field(default=0.0, description="when it begins")
    amplitude_mm: float = Field(description="0 and this, by turns")
    bit_ms: Positive = Field(description="length of a bit")
    order: Annotated[int, Field(ge=3, le=16)] = Field(default=8, description="of the shift register")


class CircleKeys(Table):
    """A circle in x and y about the starting reference."""

    kind: Literal["circle"] = Field(description="a circle in x and y")
    at_s: NotNegative = Field(
        default=0.0, description="when it begins; the reference is at x = radius from there on"
    )
    out_at_s: NotNegative | None = Field(
        default=None, description="when it leaves for x = radius; at at_s, in one step, unless given"
    )
    out_mm_per_s: Positive = Field(default=1.0, description="how fast it goes there")
    radius_mm: Positive = Field(description="radius")
    rate_rad_per_s: float = Field(description="angular velocity")


class TableKeys(Table):
    """A reference from a CSV file: time in s, then x, y and depth in mm, with a line of names."""

    kind: Literal["csv"] = Field(description="a CSV file")
    file: Text = Field(description="path, relative to the scenario")


Reference = Annotated[
    Annotated[StepKeys, Tag("step")]
    | Annotated[RampKeys, Tag("ramp")]
    | Annotated[SineKeys, Tag("sine")]
    | Annotated[BinaryKeys, Tag("prbs")]
    | Annotated[CircleKeys, Tag("circle")]
    | Annotated[TableKeys, Tag("csv")],
    chosen_by("kind"),
]


class SignalKeys(Table):
    """A step of an output that no controller sets: an axis in open loop."""

    output: Literal["lift_V", "x", "y"] = Field(description="of which output")
    at_s: NotNegative = Field(description="when")
    by: float = Field(description="by how much")


class DisturbanceKeys(Table):
    """A force on the body."""

    force_mN: Vector = Field(description="x, y, z")
    from_s: NotNegative = Field(description="when it begins")
    until_s: NotNegative = Field(description="when it ends")

    @model_validator(mode="after")
    def _lasts(self) -> "DisturbanceKeys":
        if self.until_s <= self.from_s:
            received = f"from_s = {self.from_s:g}, until_s = {self.until_s:g}"
            raise broken("until_s must be later than from_s", received, "swap or correct them")
        return self


class RecordKeys(Table):
    """What is recorded of a run."""

    every: Annotated[int, Field(ge=1, le=MOST_PERIODS)] = Field(
        default=1, description="control periods from row to row"
    )


class NoiseKeys(Table):
    """Where noise comes from."""

    seed: Annotated[int, Field(ge=0)] | None = Field(default=0, description="equal seeds give equal runs")
    off: bool = Field(default=False, description="true: no noise at all")


class ScenarioFile(Table):
    """A scenario."""

    format: Format
    title: Text = Field(description="one line about the run")
    map: Text = Field(description="map file, relative to the scenario; or its name in maps/out")
    device: Text | None = Field(
        default=None,
        description="device file, relative to the scenario, or name of a shipped device; the map's own unless given",
    )
    duration_s: Positive = Field(description="length of the run")
    control: ControlKeys = Field(description="controllers and their clock")
    start: StartKeys = Field(default=StartKeys(), description="where the run begins")
    field: FieldKeys = Field(default=FieldKeys(), description="how the field follows the currents")
    body: BodyKeys = Field(default=BodyKeys(), description="the body around the magnet")
    drag: DragKeys = Field(default=DragKeys(), description="resistance of the air")
    plate: PlateKeys | None = Field(default=None, description="a conducting plate")
    walls: WallKeys | None = Field(default=None, description="walls that the body can touch")
    coils: CoilKeys = Field(default=CoilKeys(), description="windings and amplifiers")
    sensors: SensorKeys = Field(default=SensorKeys(), description="position sensors")
    reference: list[Reference] = Field(default=[], description="changes of the references")
    signal: list[SignalKeys] = Field(default=[], description="steps of outputs in open loop")
    disturbance: list[DisturbanceKeys] = Field(default=[], description="forces on the body")
    noise: NoiseKeys = Field(default=NoiseKeys(), description="where noise comes from")
    record: RecordKeys = Field(default=RecordKeys(), description="the recorded samples")

    @model_validator(mode="after")
    def _of_bounded_length(self) -> "ScenarioFile":
        periods = 1e3 * self.duration_s / self.control.period_ms
        if periods > MOST_PERIODS:
            must = f"a run has at most {MOST_PERIODS} control periods: duration_s over control.period_ms"
            raise broken(must, f"{periods:.4g}", "shorten the run")
        return self


SCENARIO = FileKind(
    "scenario",
    ScenarioFile,
    ScenarioError,
    "maps",
    "scenarios",
)
