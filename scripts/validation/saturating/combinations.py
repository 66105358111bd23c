"""The sixty machines: combinations of a device, a steel, and currents of a map.

A device file of `devices` lacks `[material.steel]`; the steel's table completes it. The currents were chosen without
looking at maps. They cover the iron from its linear range to saturation, with both signs or one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import fieldmap as fm
from fieldmap.device.model import Device
from validation.saturating.steels import STEELS, Steel

FOLDER = Path(__file__).parent / "devices"
CELLS = 4
"""Least number of cells of a map along each axis. Few suffice, because fields are compared at nodes, without an error
of the interpolant."""
# Largest spacing, m, of boxes near iron for which `fieldmap.generate` refuses a larger one.
SPACING = {
    "c_yoke": 1.75e-3,
    "c_yoke_two_coils": 1.75e-3,
    "e_core": 1.75e-3,
    "pot_core": 2.3e-3,
    "two_steels": 3.5e-3,
}

# Refinement of devices with curved parts that would be meshed finer than necessary; 1 for others.
REFINEMENT = {
    "core_and_magnet": 0.7,
    "core_in_tube": 0.7,
    "cores_in_background": 0.7,
    "eight_coils": 0.5,
    "four_cores_plate": 0.6,
    "four_cores_ring": 0.6,
    "planar5": 0.6,
    "six_cores_disk_plate": 0.5,
    "three_cores_ring": 0.7,
    "tilted_cores_gap": 0.6,
    "tilted_cores_joined": 0.5,
    "u_core_joint": 0.6,
}


@dataclass(frozen=True)
class Combination:
    """A device, a steel, and the currents of the recipe: smallest and largest, A, or keys of [currents]. changes: of
    the device file."""

    device_name: str
    steel_name: str
    currents: tuple[float, float] | Mapping[str, Any]
    changes: Mapping[str, float] = field(default_factory=dict)
    coarser: float = 1.0
    """Factor of the mesh sizes."""

    @property
    def name(self) -> str:
        """Name of the machine on the command line."""
        return f"{self.device_name}-{self.steel_name}"

    @property
    def steel(self) -> Steel:
        """The steel of that name."""
        return STEELS[self.steel_name]

    @property
    def refinement(self) -> float:
        """Refinement of the mesh."""
        return REFINEMENT.get(self.device_name, 1.0) / self.coarser

    @property
    def case(self) -> str:
        """Description of the machine."""
        return f"{self.device_name}, {self.steel_name}, {self.range}"

    @property
    def range(self) -> str:
        """Description of the currents."""
        if not isinstance(self.currents, Mapping):
            return f"{self.currents[0]:g} to {self.currents[1]:g} A"
        if "lift_and_directions" in self.currents:
            return f"lift and directions up to {self.currents['lift_and_directions']['u_A'][1]:g} A"
        lower, upper = self.currents["lower_A"], self.currents["upper_A"]
        count = len(self.currents["groups"])
        return f"{count} group{'s' * (count > 1)}, {lower:g} to {upper:g} A"

    def device(self) -> Device:
        """The device, read from its file with the steel's table."""
        text = (FOLDER / f"{self.device_name}.toml").read_text(encoding="utf-8")
        return fm.read_device(f"{text}\n{self.steel.table()}", dict(self.changes))

    def generate(self, output: Path) -> Path:
        """Make the map with the defaults of a recipe. Raises the errors of `fieldmap.generate`."""
        device = self.device()
        lower, upper = device.workspace.bounds
        return fm.generate(
            device,
            output,
            progress=False,
            spacing=np.minimum((upper - lower) / CELLS, SPACING.get(self.device_name, np.inf)),
            currents=self.currents,
            iron={"refinement": self.refinement},
        )


def lift_and_directions(lift: tuple[float, float], direction: float, n: float = 1.25) -> dict[str, Any]:
    """Keys for six coils with one lift, A, and two direction signals, each up to `direction`."""
    signals = [-direction, direction]
    return {"lift_and_directions": {"u_A": list(lift), "x": signals, "y": signals, "n": n}}


def groups(names: list[list[str]], lower: float, upper: float) -> dict[str, Any]:
    """Keys for groups of coils that carry one current, A."""
    return {"groups": names, "lower_A": lower, "upper_A": upper}


LEVEL_AND_RISING = [["c1", "c3"], ["c2", "c4"], ["c5", "c7"], ["c6", "c8"]]
COMBINATIONS = (
    # Open circuits.
    Combination("one_core", "soft_ferrite", (-5, 5)),
    Combination("one_core", "hard_steel", (0, 25)),
    Combination("one_core", "mu_metal", (-10, 10)),
    Combination("opposed_cores", "pure_iron", (-10, 10)),
    Combination("opposed_cores", "two_points", (-25, 25)),
    Combination("opposed_cores", "steel_foot", (0, 12)),
    Combination("three_cores_ring", "steel_1010", (-10, 10)),
    Combination("three_cores_ring", "nickel_iron", (-12, 12)),
    Combination("four_cores_ring", "cobalt_iron", (-20, 20)),
    Combination("four_cores_ring", "two_phases", (-10, 10)),
    Combination("four_cores_ring", "mu_metal", (0, 8)),
    Combination("planar5", "cobalt_iron", (-8, 8)),
    Combination("planar5", "soft_ferrite", (-4, 4)),
    Combination("planar5", "two_hundred_points", (0, 30)),
    Combination("eight_coils", "steel_a3", (-10, 10)),
    Combination("eight_coils", "cobalt_iron", (-20, 20)),
    Combination("eight_coils", "froehlich", groups(LEVEL_AND_RISING, -15, 15)),
    # Over plates, on a bar, in a tube.
    Combination("tilted_cores_joined", "cobalt_iron", (-8, 8)),
    Combination("tilted_cores_joined", "nickel_iron", (-5, 5)),
    Combination("tilted_cores_joined", "pure_iron", (-10, 10)),
    Combination("tilted_cores_joined", "steel_a3", (0, 15)),
    Combination("tilted_cores_gap", "cobalt_iron", (-8, 8)),
    Combination("tilted_cores_gap", "mu_metal", (-4, 4), {"parameters.gap": 0.5}),
    Combination("tilted_cores_gap", "marrocco", (-5, 15)),
    Combination("four_cores_plate", "m19", (-6, 6)),
    Combination("four_cores_plate", "two_points", (-12, 12)),
    Combination("four_cores_plate", "hard_steel", (0, 10)),
    Combination("four_cores_plate", "froehlich", groups([["c1", "c3"], ["c2", "c4"]], -10, 10)),
    Combination("two_cores_bar", "cobalt_iron", (-8, 8)),
    Combination("two_cores_bar", "m19", (0, 6)),
    Combination("two_cores_bar", "cast_iron", (-10, 10)),
    Combination("two_steels", "cobalt_iron", (-6, 6)),
    Combination("two_steels", "steel_1010", (-2, 10)),
    Combination("core_in_tube", "arctangent", (-8, 8)),
    Combination("core_in_tube", "soft_ferrite", (-6, 6)),
    # Yokes.
    Combination("c_yoke", "pure_iron", (-8, 8)),
    Combination("c_yoke", "steel_foot", (-3, 12)),
    Combination("c_yoke", "soft_ferrite", (0, 6)),
    Combination("c_yoke_two_coils", "cobalt_iron", (-10, 10)),
    Combination("c_yoke_two_coils", "nickel_iron", groups([["lower", "upper"]], 0, 8)),
    Combination("e_core", "m19", (-8, 8)),
    Combination("e_core", "cast_iron", (0, 12)),
    Combination("e_core", "arctangent", (-15, 15)),
    Combination("pot_core", "soft_ferrite", (-5, 5)),
    Combination("pot_core", "cobalt_iron", (0, 20)),
    Combination("u_core_joint", "two_points", (-10, 10)),
    Combination("u_core_joint", "m19", (0, 8)),
    # Closed circuits.
    Combination("ring_core", "mu_metal", (-2, 2)),
    Combination("ring_core", "two_hundred_points", (-12, 12)),
    Combination("frame", "marrocco", (-10, 10)),
    Combination("frame", "hard_steel", (-20, 20)),
    Combination("six_cores_disk_plate", "steel_a3", lift_and_directions((0.5, 2.0), 0.4)),
    Combination("six_cores_disk_plate", "cobalt_iron", lift_and_directions((0.2, 1.5), 0.5, n=1.0)),
    Combination("six_cores_disk_plate", "steel_foot", groups([["1", "6"], ["2", "5"], ["3", "4"]], -2, 2)),
    Combination("six_cores_disk_plate", "pure_iron", (-1.5, 1.5)),
    # Magnets and a background.
    Combination("core_and_magnet", "pure_iron", (-8, 8)),
    Combination("core_and_magnet", "mu_metal", (-6, 6)),
    Combination("core_and_magnet", "two_phases", (-15, 15)),
    Combination("cores_in_background", "m19", (-8, 8)),
    Combination("cores_in_background", "nickel_iron", (-8, 8)),
)
BY_NAME = {one.name: one for one in COMBINATIONS}
