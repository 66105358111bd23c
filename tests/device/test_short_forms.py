"""Short forms of device files: repetition, mirrors, parameters, defaults, included files; the places of mistakes."""

import time
import tomllib

import numpy as np
import pytest

from fieldmap.device import read_device, recorded_device
from fieldmap.errors import DeviceFileError

HEAD = 'format = 1\nname = "short"\ntitle = "Short forms"\n'
SHORT = (
    HEAD
    + """
[parameters]
radius = 44.0
bore = 11.0
outer = "= bore + 10"
heights = [30.0, 31.0, 32.0, 33.0]

[defaults.coil]
kind = "circular"
inner_radius_mm = "= bore"
outer_radius_mm = "= outer"
turns = 840

[[coil]]
name = "c{k}"
repeat = { count = 4, about = "z", h = "= heights", ohm = [1.0, 2.0, 3.0, 4.0] }
height_mm = "= h"
resistance_ohm = "= ohm"
position_mm = ["= radius", 0.0, 26.0]
rotation_deg = [0.0, 90.0, 0.0]

[[coil]]
name = "row{k}"
repeat = { count = 2, step_mm = [0.0, 0.0, 50.0] }
mirror = { plane = "z", name = "{name}_below" }
height_mm = 20
position_mm = [0.0, 0.0, 100.0]

[material.steel]
kind = "linear"
mu_r = "= 40*100"

[[body]]
name = "post"
material = "steel"
shape = "box"
size_mm = [10.0, 10.0, "= 2*bore"]
position_mm = [200.0, 100.0, 0.0]
mirror = ["x", "y"]
mesh_size_mm = 5
"""
)


def problems(text):
    with pytest.raises(DeviceFileError) as caught:
        read_device(text)
    return caught.value.problems


def line_of(text, part):
    return text[: text.index(part)].count("\n") + 1


def test_everything_is_written_out():
    device = read_device(SHORT)
    assert device.coil_names == ("c1", "c2", "c3", "c4", "row1", "row2", "row1_below", "row2_below")
    assert [coil.height for coil in device.coils[:4]] == [0.030, 0.031, 0.032, 0.033]
    assert [coil.resistance for coil in device.coils[:4]] == [1.0, 2.0, 3.0, 4.0]
    assert {coil.outer_radius for coil in device.coils} == {0.021}
    at = np.array([coil.placement.position for coil in device.coils])
    assert np.array_equal(at[:4, :2], 0.044 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]))
    assert at[4:, 2].tolist() == [0.1, 0.15, -0.1, -0.15]
    axes = np.array([coil.placement.rotation[:, 2] for coil in device.coils])
    assert np.array_equal(axes[:4], [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    assert np.array_equal(axes[4:, 2], [1, 1, -1, -1])
    names = [body.name for body in device.bodies]
    assert names == ["post", "post mirrored x", "post mirrored y", "post mirrored x mirrored y"]
    places = {tuple(body.parts[0].placement.position[:2]) for body in device.bodies}
    assert places == {(0.2, 0.1), (-0.2, 0.1), (0.2, -0.1), (-0.2, -0.1)}
    assert device.bodies[0].parts[0].shape.size[2] == 0.022
    assert device.materials["steel"].mu_r == 4000.0


def test_the_text_that_a_map_records_makes_it_again():
    device = read_device(SHORT)
    assert recorded_device(device.text).coil_names == device.coil_names
    unit = read_device("drive_unit")
    assert "include" not in tomllib.loads(unit.text)
    again = recorded_device(unit.text, solids=True)
    assert len(again.bodies) == len(unit.bodies)
    assert again.payload == unit.payload


@pytest.mark.parametrize(
    ("old", "new", "line_at", "path", "received"),
    [
        ("turns = 840", "turns = -840", "turns = -840", "coil.c1.turns", "-840"),
        ('"= h"', '"= h - 40"', "height_mm", "coil.c1.height_mm", "h - 40"),
        ("ohm = [1.0, 2.0, 3.0, 4.0]", "ohm = [1.0, 2.0, -3.0, 4.0]", "resistance", "coil.c3.resistance_ohm", "-3"),
        ('"c{k}"', '"c"', 'name = "c"', "coil.2.name", '"c"'),
        ('"c{k}"', '"c{q}"', 'name = "c{q}"', "coil.c{q}.name", '"q"'),
        ('"c{k}"', '"c{k"', 'name = "c{k"', "coil.c{k.name", "c{k"),
        ('"= bore + 10"', '"= bore + outer"', "outer =", "parameters.outer", "outer -> outer"),
        ('"= bore + 10"', '"= bohr + 10"', "outer =", "parameters.outer", '"bohr"'),
        ("bore = 11.0", "bore = { a = 1 }", "bore =", "parameters.bore", "a table"),
        ("bore = 11.0", '"bore mm" = 11.0', '"bore mm"', "parameters.bore mm", "bore mm"),
        ("count = 4, about", "count = 0, about", "repeat", "coil.c{k}.repeat.count", "0"),
        ("count = 4, about", "count = 5, about", "repeat", "coil.c{k}.repeat", "4 values"),
        ("count = 4, about", "count = 1e9, about", "repeat", "coil.c{k}.repeat.count", "1000000000"),
        ('about = "z"', 'about = "w"', "repeat", "coil.c{k}.repeat.about", '"w"'),
        ('about = "z", h', 'abuot = "z", h', "repeat", "coil.c{k}.repeat.abuot", '"z"'),
        ("step_mm = [0.0, 0.0, 50.0]", "step_mm = 50", "step_mm", "coil.row{k}.repeat.step_mm", "50"),
        ('mirror = ["x", "y"]', "mirror = 3", "mirror = 3", "body.post.mirror", "3"),
        ("[defaults.coil]", "[defaults.coils]", "[defaults.coils]", "defaults.coils", "a table"),
        ('"= 40*100"', '"= 40/0"', "mu_r", "material.steel.mu_r", "division by zero"),
    ],
)  # fmt: skip
def test_mistakes_are_told_at_their_line_and_path(old, new, line_at, path, received):
    assert SHORT.count(old) >= 1
    text = SHORT.replace(old, new, 1)
    found = [problem for problem in problems(text) if problem.where.rpartition(": ")[2].startswith(path)]
    assert found, "\n".join(map(str, problems(text)))
    assert f":{line_of(text, line_at)}: " in found[0].where
    assert received in found[0].received
    assert all((found[0].must_hold, found[0].remedy))


def test_every_copy_with_a_mistake_is_told_once_for_its_expression():
    found = problems(SHORT.replace('"= h"', '"= h*unknown"'))
    assert len(found) == 1


def test_an_included_file_keeps_its_lines_and_gives_way(tmp_path):
    (tmp_path / "base.toml").write_text(SHORT)
    main = HEAD + 'include = "base.toml"\n[parameters]\nbore = 12.0\n[[coil]]\nname = "c2"\nturns = 100\n'
    (tmp_path / "main.toml").write_text(main)
    device = read_device(tmp_path / "main.toml")
    assert [coil.turns for coil in device.coils[:3]] == [840, 100, 840]
    assert device.coils[0].inner_radius == 0.012
    (tmp_path / "base.toml").write_text(SHORT.replace("turns = 840", "turns = -840"))
    (tmp_path / "main.toml").write_text(main.replace("turns = 100", "turns = -100"))
    with pytest.raises(DeviceFileError) as caught:
        read_device(tmp_path / "main.toml")
    where = [problem.where for problem in caught.value.problems]
    assert where[0] == f"{tmp_path / 'main.toml'}:{line_of(main, 'turns')}: coil.c2.turns"
    assert f"{tmp_path / 'base.toml'}:{line_of(SHORT, 'turns')}: coil.c1.turns" in where
    assert len(where) == 8


def test_files_beside_an_included_file_are_found(tmp_path):
    folder = tmp_path / "parts"
    folder.mkdir()
    curve = 'format = 1\nname = "curve"\ntitle = "Two points"\nH_A_per_m = [100, 1000]\nB_T = [1.0, 1.6]\n'
    (folder / "curve.toml").write_text(curve)
    steel = '[material.steel]\nkind = "bh_table"\nfile = "curve.toml"\n'
    steel += 'below = "straight line to the origin"\nabove = "slope mu0"\n'
    (folder / "steel.toml").write_text(steel)
    coil = '[[coil]]\nname = "a"\nkind = "circular"\ninner_radius_mm = 1\nouter_radius_mm = 2\n'
    coil += "height_mm = 3\nturns = 4\n"
    (tmp_path / "main.toml").write_text(HEAD + 'include = "parts/steel.toml"\n' + coil)
    device = read_device(tmp_path / "main.toml")
    assert device.materials["steel"].b.tolist() == [1.0, 1.6]
    assert list(device.included) == ["parts/curve.toml"]


@pytest.mark.parametrize("name", ["self.toml", "there is none.toml", 3])
def test_files_that_cannot_be_included(name, tmp_path):
    path = tmp_path / "self.toml"
    given = f'"{name}"' if isinstance(name, str) else name
    path.write_text(HEAD + f"include = {given}\n")
    with pytest.raises(DeviceFileError) as caught:
        read_device(path)
    assert caught.value.problems[0].where == f"{path}:4: include"


def test_a_chain_of_files_ends(tmp_path):
    for k in range(12):
        (tmp_path / f"{k}.toml").write_text(HEAD + f'include = "{k + 1}.toml"\n')
    with pytest.raises(DeviceFileError):
        read_device(tmp_path / "0.toml")


@pytest.mark.parametrize(
    "hostile",
    [
        "a = [" + "[" * 900 + "]" * 901,
        "\n".join(f'p{k} = "= p{k + 1} + p{k + 1}"' for k in range(2000)) + "\np2000 = 1",
        "\n".join(f'p{k} = "= p{(k + 1) % 40}"' for k in range(40)),
        'p = "= 9**9**9**9"',
        'p = "= ' + "(" * 190 + '"',
    ],
    ids=["nested", "long chain", "circle", "power", "brackets"],
)
def test_hostile_parameters_give_a_message_at_once(hostile):
    begin = time.process_time()
    assert problems(HEAD + "[parameters]\n" + hostile + '\n[[coil]]\nname = "= p"\n')
    assert time.process_time() - begin < 1.0


LEFT_OUT = """
include = "base.toml"
without = ["coil.c2", "coil.row*", "coil.*.resistance_ohm", "body.post mirrored x"]
[parameters]
bore = 12.0
[[coil]]
name = "c{n}"
repeat = { n = [1, 3] }
turns = "= 100*n"
"""


def test_included_things_are_left_out(tmp_path):
    (tmp_path / "base.toml").write_text(
        SHORT + '[provenance]\n"coil.row*.height_mm" = "gone"\n"coil.c*.turns" = "here"\n'
    )
    (tmp_path / "main.toml").write_text(HEAD + LEFT_OUT)
    device = read_device(tmp_path / "main.toml")
    assert device.coil_names == ("c1", "c3", "c4")
    assert [coil.turns for coil in device.coils] == [100, 300, 840]
    assert {coil.resistance for coil in device.coils} == {None}
    at = np.array([coil.placement.position for coil in device.coils])
    assert np.array_equal(at[:, :2], 0.044 * np.array([[1, 0], [-1, 0], [0, -1]]))
    assert [body.name for body in device.bodies] == ["post", "post mirrored y", "post mirrored x mirrored y"]
    assert dict(device.provenance) == {"coil.c*.turns": "here"}


def test_what_follows_something_left_out_is_told_at_its_line(tmp_path):
    text = SHORT.replace("heights = [30.0, 31.0, 32.0, 33.0]", "heights = [30.0, 31.0, 32.0, -33.0]")
    (tmp_path / "base.toml").write_text(text)
    (tmp_path / "main.toml").write_text(HEAD + 'include = "base.toml"\nwithout = "coil.c2"\n')
    with pytest.raises(DeviceFileError) as caught:
        read_device(tmp_path / "main.toml")
    (problem,) = caught.value.problems
    assert problem.where == f"{tmp_path / 'base.toml'}:{line_of(text, 'height_mm')}: coil.c4.height_mm"
    assert "h" in problem.received


@pytest.mark.parametrize("wrong", ['"coil.c9"', "3", '["coil.c1", 3]', '"parameters.bore"', '"*"', '""'])
def test_what_cannot_be_left_out(wrong, tmp_path):
    (tmp_path / "base.toml").write_text(SHORT)
    (tmp_path / "main.toml").write_text(HEAD + f'include = "base.toml"\nwithout = {wrong}\n')
    with pytest.raises(DeviceFileError) as caught:
        read_device(tmp_path / "main.toml")
    assert caught.value.problems[0].where == f"{tmp_path / 'main.toml'}:5: without"


TETRAHEDRON = """
[material.steel]
kind = "linear"
mu_r = 100
[[body]]
name = "b"
material = "steel"
shape = "triangle_surface"
points_mm = [[0, 0, 0], [10, 0, 0], [0, 20, 0], [0, 0, 30]]
triangles = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
mesh_size_mm = 5
mirror = "x"
"""


def test_a_surface_is_turned_over_in_a_mirror():
    body, image = read_device(HEAD + TETRAHEDRON).bodies
    at = [one.parts[0].placement.to_device(one.parts[0].shape.points) for one in (body, image)]
    assert np.array_equal(at[1], at[0] * [-1, 1, 1])


def test_what_cannot_be_mirrored_is_told(tmp_path):
    (tmp_path / "block.msh").write_text("")
    shape = TETRAHEDRON.partition("shape")[0] + 'shape = "mesh_file"\nfile = "block.msh"\nmirror = "x"\n'
    (tmp_path / "main.toml").write_text(HEAD + shape)
    with pytest.raises(DeviceFileError) as caught:
        read_device(tmp_path / "main.toml")
    assert caught.value.problems[0].where.endswith("body.b.mirror")
    assert caught.value.problems[0].received == "a mesh file"
