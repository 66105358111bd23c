"""Coils, laws, shapes and interpolants of an installed package: declared as entry points, used by name."""

import subprocess
import sys
from pathlib import Path

MODULES = {
    "ring_of_wire": """
from dataclasses import dataclass
from typing import ClassVar
from fieldmap.device.coils.circular import CircularCoil

@dataclass(frozen=True, repr=False)
class Wire(CircularCoil):
    kind: ClassVar[str] = "ring_of_wire"
""",
    "hyperbolic": """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from fieldmap.device.materials.base import TwoConstantLaw

@dataclass(frozen=True, repr=False)
class Hyperbolic(TwoConstantLaw):
    '''Hyperbolic tangent of the field.'''
    kind: ClassVar[str] = "hyperbolic"
    title: ClassVar[str] = "hyperbolic law"
    def polarisation(self, x):
        return self.saturation * np.tanh(x)
    def susceptibility(self, x):
        return (self.mu_r - 1) / np.cosh(np.minimum(x, 300.0)) ** 2
""",
    "plinth": """
from dataclasses import dataclass
from typing import Annotated, ClassVar
from fieldmap.device.shapes import Shape
from fieldmap.device.shapes.prisms import Box
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length

@dataclass(frozen=True, repr=False)
class Plinth(Shape):
    '''Square block.'''
    kind: ClassVar[str] = "plinth"
    side: Annotated[float, Key(Length, "side of the square", "mm")]
    rise: Annotated[float, Key(Length, "height", "mm")]

    @property
    def primitive(self):
        return Box((self.side, self.side, self.rise))
""",
    "other_cells": """
from dataclasses import replace
from fieldmap.interpolants.hermite import INTERPOLANT as HERMITE
INTERPOLANT = replace(HERMITE, name="other cells")
""",
}
GROUPS = {
    "fieldmap.coils": "ring_of_wire",
    "fieldmap.materials": "hyperbolic",
    "fieldmap.shapes": "plinth",
    "fieldmap.interpolants": "other_cells",
}

DEVICE = """
format = 1
name = "d"
title = "d"
[[coil]]
kind = "ring_of_wire"
name = "c"
inner_radius_mm = 10
outer_radius_mm = 12
height_mm = 4
turns = 100
[material.iron]
kind = "hyperbolic"
mu_r = 1000
saturation_polarisation_T = 2
[[body]]
name = "b"
material = "iron"
shape = "plinth"
side_mm = 5
rise_mm = 4
mesh_size_mm = 2
"""

PROGRAM = f"""
import numpy as np
import fieldmap as fm
from fieldmap.interpolants import INTERPOLANTS
device = fm.read_device({DEVICE!r})
assert type(device.coils[0]).__name__ == "Wire" and device.coils[0].outer_radius == 0.012
law = device.materials["iron"]
assert type(law).__name__ == "Hyperbolic" and law.polarisation(np.array([1.0]))[0] == 2.0 * np.tanh(1.0)
again = fm.read_device(device.to_toml())
assert again.coils[0].kind == "ring_of_wire" and again.bodies[0].parts[0].shape.kind == "plinth"
assert device.bodies[0].mirrored("x").parts[0].shape.hull()[:, 2].max() == 0.004
assert "other cells" not in INTERPOLANTS
m = fm.open_map("maps/sample.h5", kind="other cells")
same = fm.open_map("maps/sample.h5", kind="hermite")
point = 0.5 * (m.lower + m.upper) + 1e-3
assert np.array_equal(m.field(point, np.ones(len(m.coil_names))), same.field(point, np.ones(len(m.coil_names))))
"""


def test_an_installed_package_adds_a_coil_a_law_a_shape_and_an_interpolant(tmp_path):
    for name, text in MODULES.items():
        (tmp_path / f"{name}.py").write_text(text)
    info = tmp_path / "magnets-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: magnets\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "\n".join(f"[{group}]\n{name} = {name}" for group, name in GROUPS.items())
    )
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r})" + PROGRAM
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parents[1]
    )
    assert done.returncode == 0, done.stderr
