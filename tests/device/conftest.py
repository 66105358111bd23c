"""A valid device file with one of everything, for tests that break or vary it."""

import pytest

VALID = """\
format = 1
name = "everything"
title = "One of everything"

[material.steel]
kind = "bh_table"
H_A_per_m = [355, 405, 470]
B_T = [0.70, 0.80, 0.90]
below = "straight line to the origin"
above = "slope mu0"

[material.iron]
kind = "linear"
mu_r = 4000

[material.barrier]
kind = "flux_barrier"

[material.magnet]
kind = "permanent_magnet"
remanence_T = [0.0, 0.0, 1.3]
mu_r = 1.05

[[body]]
name = "disk"
material = "steel"
shape = "cylinder"
radius_mm = 66
height_mm = 6
mesh_size_mm = 8
edge_size_mm = 1

[[body]]
name = "collar"
material = "iron"
shape = "ring"
inner_radius_mm = 70
outer_radius_mm = 75
height_mm = 4
position_mm = [0, 0, 100]
rotation_deg = [90, 0, 90]
mesh_size_mm = 5

[[body]]
name = "wedge"
material = "barrier"
shape = "extruded_polygon"
points_mm = [[0, 0], [10, 0], [10, 5], [0, 5]]
height_mm = 3
position_mm = [200, 0, 0]
mesh_size_mm = 5

[[body]]
name = "spindle"
material = "iron"
shape = "revolved_profile"
points_mm = [[0, 0], [4, 0], [2, 10], [0, 10]]
position_mm = [0, 200, 0]
mesh_size_mm = 2

[[body]]
name = "bracket"
material = "magnet"
mesh_size_mm = 6

[[body.part]]
shape = "box"
size_mm = [20, 20, 10]
position_mm = [0, -200, 0]

[[body.part]]
operation = "cut"
shape = "sphere"
radius_mm = 4
position_mm = [0, -200, 0]

[[coil]]
name = "round"
kind = "circular"
inner_radius_mm = 11
outer_radius_mm = 21
height_mm = 39
turns = 840
resistance_ohm = 4.25
inductance_mH = 29
position_mm = [0, 0, 60]

[[coil]]
name = "race"
kind = "rounded_rectangle"
half_width_x_mm = 16
half_width_y_mm = 20
corner_radius_mm = 15
thickness_mm = 10
height_mm = 39
turns = 840
polarity = -1
position_mm = [60, 0, 60]

[[coil]]
name = "path"
kind = "path"
corners_mm = [[-30, -30], [30, -30], [30, 30]]
corner_radius_mm = 6
thickness_mm = 8
height_mm = 10
turns = 20
position_mm = [-60, 0, 60]

[payload]
mass_g = 11.19
magnet_offset_mm = 15
inertia_g_mm2 = [300, 300, 200]
drag_N_s_per_m = 0.01

[payload.magnet]
shape = "cylinder"
diameter_mm = 10
height_mm = 10
remanence_T = 1.3

[driver]
gain_A_per_V = 0.355
current_limit_A = 3.55
supply_voltage_V = 40

[workspace]
shape = "box"
lower_mm = [-20, -20, -140]
upper_mm = [20, 20, -76]

[[reference]]
quantity = "Bz"
at_mm = [0, 0, -87]
currents_A = [1, 0, 0]
value_T = 1e-4
source = "an example"

[[reference]]
quantity = "dBz/dz"
at_mm = [0, 0, -87]
currents_A = [1, 0, 0]
value_T_per_m = 1e-3
mu_r = 4000
tolerance = 1e-3
source = "an example"

[material.powder]
kind = "froehlich"
mu_r = 400
saturation_polarisation_T = 1.6

[material.sheet]
kind = "arctangent"
mu_r = 5000
saturation_polarisation_T = 2.0

[material.lamination]
kind = "marrocco"
eps = 2e-4
alpha = 5.5
tau = 5e4
c = 1.0

[[section]]
name = "across"
centre_mm = [0, 0, 3]
normal = [1, 0, 0]

[[section]]
name = "window"
centre_mm = [10, 0, 3]
normal = [1, 0, 1]
bodies = ["disk", "wedge"]
half_widths_mm = [1, 20, 5]

[provenance]
"body.disk.radius_mm" = "an example"
"coil.*.turns" = "an example"
"body.bracket.part.2.radius_mm" = "an example"
"""


@pytest.fixture
def valid_text() -> str:
    return VALID
