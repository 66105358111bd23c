"""Steels for the study of many machines, as tables of a device file.

Each table has the shape of a typical data sheet, from general knowledge; "like" in a title means that it is no product.
The curves differ widely: highest permeability from 64 to 72 000, saturation from 0.45 to 2.4 T, a straight or a curved
foot, 2 to 200 points.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from validation.row import Array

MU0 = 4e-7 * np.pi
TO_SATURATION = "towards saturation"


@dataclass(frozen=True)
class Steel:
    """A steel with the keys of its table `[material.steel]` and a descriptive title."""

    name: str
    title: str
    keys: dict[str, str | float | list[float]] = field(hash=False)

    def table(self) -> str:
        """Text for a device file."""
        lines = [f"{key} = {_toml(value)}" for key, value in self.keys.items()]
        return "\n".join([f"# {self.title}", "[material.steel]", *lines, ""])


def _toml(value: str | float | list[float]) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def by_table(
    name: str,
    title: str,
    field_strength: list[float],
    flux_density: list[float],
    saturation: float | None = None,
) -> Steel:
    """A B-H table, A/m and T. saturation: polarisation, T, approached beyond the last point; None: no law there."""
    keys = {
        "kind": "bh_table",
        "H_A_per_m": field_strength,
        "B_T": flux_density,
        "below": "straight line to the origin",
        "above": "slope mu0" if saturation is None else TO_SATURATION,
    }
    return Steel(
        name, title, keys if saturation is None else keys | {"saturation_polarisation_T": saturation}
    )


def by_shipped_table(name: str, title: str) -> Steel:
    """A material file of the package."""
    keys = {
        "kind": "bh_table",
        "file": f"materials/{name}.toml",
        "below": "straight line to the origin",
        "above": "slope mu0",
    }
    return Steel(name, title, keys)


def sampled(
    name: str, title: str, field_strength: Array, polarisation: Callable[[Array], Array], digits: int = 9
) -> Steel:
    """A table of points of a smooth law J(H), T."""
    flux_density = MU0 * field_strength + polarisation(field_strength)
    return by_table(name, title, field_strength.round(6).tolist(), flux_density.round(digits).tolist())


def langevin(field_strength: Array) -> Array:
    """Polarisation, T, by Langevin's function: saturation 1.9 T, initial permeability about 1700."""
    ratio = field_strength / 300.0
    return 1.9 * (1.0 / np.tanh(ratio) - 1.0 / ratio)


def two_humps(field_strength: Array) -> Array:
    """Polarisation, T, of a soft phase of 0.9 T and a hard phase of 0.8 T; the permeability falls in two steps."""
    chi, hard = 4000.0 * MU0 * field_strength, 60.0 * MU0 * field_strength
    return chi / (1.0 + (chi / 0.9) ** 2) ** 0.5 + hard / (1.0 + (hard / 0.8) ** 2) ** 0.5


FERRITE = by_table(
    "soft_ferrite",
    "MnZn power ferrite, N87 like: initial permeability 2200, 0.45 T",
    [10, 20, 40, 60, 100, 150, 250, 500, 1000, 2000],
    [0.0276, 0.075, 0.20, 0.28, 0.35, 0.385, 0.41, 0.43, 0.445, 0.455],
)
PURE_IRON = by_table(
    "pure_iron",
    "Annealed pure iron, ARMCO like: a curved foot, then permeability 8000",
    [20, 40, 60, 80, 100, 150, 200, 300, 500, 800, 1500, 3000, 6000, 12000, 25000, 50000],
    [0.02, 0.08, 0.30, 0.60, 0.82, 1.10, 1.23, 1.36, 1.48, 1.55, 1.61, 1.69, 1.79, 1.94, 2.10, 2.19],
)
M19 = by_table(
    "m19",
    "Electrical sheet, M-19 like",
    [
        *[
            15.1,
            22.7,
            27.8,
            31.9,
            35.4,
            38.6,
            41.7,
            44.9,
            48.1,
            51.4,
            55.0,
            58.8,
            62.8,
            67.2,
            72.1,
            77.4,
            83.4,
        ],
        *[90.0, 97.5, 106.2, 116.3, 128.5, 143.8, 163.8, 191.9, 234.8, 306.5, 435.3, 674.9, 1108, 1813, 2801],
        *[4054, 5591, 7448, 9709, 12487, 16041, 21249, 31313, 53589, 88477, 124329],
    ],
    [round(0.05 * k, 2) for k in range(1, 44)],
)
STEEL_1010 = by_table(
    "steel_1010",
    "Low-carbon steel, 1010 like",
    [238.7, 318.3, 358.1, 437.7, 477.5, 636.6, 795.8, 1114, 1273, 1592, 2228, 3183, 4775, 6366, 7958]
    + [15916, 31831, 47746, 63662, 79577, 159155],
    [0.200, 0.320, 0.400, 0.501, 0.561, 0.791, 0.931, 1.101, 1.202, 1.302, 1.403, 1.524, 1.626, 1.698, 1.730]
    + [1.870, 1.990, 2.040, 2.070, 2.095, 2.200],
)
COBALT_IRON = by_table(
    "cobalt_iron",
    "50 % cobalt-iron strip, Vacoflux 50 like: steep up to 1.4 T, 2.36 T",
    [30, 60, 100, 150, 200, 300, 500, 800, 1600, 3000, 8000, 16000, 40000, 100000],
    [0.12, 0.55, 1.05, 1.38, 1.55, 1.74, 1.94, 2.07, 2.19, 2.25, 2.31, 2.35, 2.40, 2.49],
)
MU_METAL = by_table(
    "mu_metal",
    "77 % nickel-iron, mu-metal like: permeability 60 000 and more, 0.8 T",
    [0.4, 0.8, 1.5, 2.5, 4, 6, 10, 20, 50, 150, 500, 2000],
    [0.03, 0.07, 0.135, 0.22, 0.33, 0.43, 0.53, 0.62, 0.69, 0.74, 0.77, 0.80],
)
NICKEL_IRON = by_table(
    "nickel_iron",
    "50 % nickel-iron, square loop like: a foot, then permeability 100 000, sharp at 1.5 T",
    [2, 4, 6, 8, 10, 14, 20, 40, 100, 400, 2000, 10000],
    [0.01, 0.05, 0.25, 0.70, 1.05, 1.25, 1.36, 1.43, 1.48, 1.52, 1.56, 1.60],
)
HARD_STEEL = by_table(
    "hard_steel",
    "Unannealed tool steel: 200 A/m at 0.1 T, rising late",
    [200, 500, 1000, 1500, 2000, 3000, 5000, 10000, 20000, 50000],
    [0.10, 0.32, 0.68, 0.90, 1.04, 1.20, 1.36, 1.54, 1.70, 1.85],
)
CAST_IRON = by_table(
    "cast_iron",
    "Grey cast iron like: low permeability, to 1.7 T beyond its table",
    [200, 400, 800, 1500, 3000, 6000, 12000, 24000],
    [0.06, 0.16, 0.34, 0.50, 0.66, 0.83, 1.02, 1.23],
    saturation=1.7,
)
TWO_POINTS = by_table("two_points", "A table of two points: a sharp knee at 1.2 T", [200, 2000], [1.2, 1.6])
LANGEVIN = sampled(
    "two_hundred_points", "200 points of Langevin's function, 1.9 T", np.geomspace(1.0, 2e5, 200), langevin
)
TWO_PHASES = sampled(
    "two_phases",
    "60 points of two phases, of 0.9 T soft and 0.8 T hard",
    np.geomspace(2.0, 1e5, 60),
    two_humps,
)
STEEL_A3 = by_shipped_table("steel_a3", "The shipped steel of the drive unit")
STEEL_FOOT = by_shipped_table("steel_foot", "The shipped low-carbon steel with an S-shaped foot")
FROEHLICH = Steel(
    "froehlich",
    "Froehlich-Kennelly law, initial permeability 2000, 1.9 T",
    {"kind": "froehlich", "mu_r": 2000, "saturation_polarisation_T": 1.9},
)
ARCTANGENT = Steel(
    "arctangent",
    "Arctangent law, initial permeability 8000, 1.5 T",
    {"kind": "arctangent", "mu_r": 8000, "saturation_polarisation_T": 1.5},
)
MARROCCO = Steel(
    "marrocco",
    "Marrocco's reluctivity: permeability 5000 up to a sharp knee",
    {"kind": "marrocco", "eps": 2e-4, "alpha": 5.5, "tau": 5e4, "c": 1.0},
)
STEELS = {
    steel.name: steel
    for steel in (
        *[FERRITE, PURE_IRON, M19, STEEL_1010, COBALT_IRON, MU_METAL, NICKEL_IRON, HARD_STEEL, CAST_IRON],
        *[TWO_POINTS, LANGEVIN, TWO_PHASES, STEEL_A3, STEEL_FOOT, FROEHLICH, ARCTANGENT, MARROCCO],
    )
}
