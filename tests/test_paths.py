"""Every public function and class with a path takes a string, a `pathlib.Path`, and any other path object."""

import inspect
import pkgutil
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap import curves, store
from fieldmap.control.identification import make_log, read_log, write_log
from fieldmap.errors import FieldmapError
from fieldmap.interop import write_c_files, write_csv
from fieldmap.io import find_source

KINDS = {"text": str, "Path": Path}


class OtherPath:
    """A path object that only has `__fspath__`."""

    def __init__(self, path):
        self._path = str(path)

    def __fspath__(self):
        return self._path


KINDS["of another library"] = OtherPath
# These functions use only the name, or no file of the package's formats.
_NAMES_ONLY = {"checkpoint_path", "is_map_file", "is_run_file", "map_path", "refuse_directory", "whole_file"}


def readers():
    """Public functions, and class methods that make an object, whose only required argument is a path."""
    found = {}
    for module in pkgutil.walk_packages(fm.__path__, "fieldmap."):
        if any(part in module.name for part in (".cli", ".thesis", "__main__")):
            continue
        try:
            package = import_module(module.name)
        except (ImportError, FieldmapError):
            continue
        for name in getattr(package, "__all__", ()):
            thing = getattr(package, name)
            makers = vars(thing).items() if inspect.isclass(thing) else ()
            found |= {
                f"{name}.{key}": getattr(thing, key) for key, made in makers if isinstance(made, classmethod)
            }
            found[name] = thing
    return {name: one for name, one in found.items() if callable(one) and _needs_a_path(one)}


def _needs_a_path(one):
    try:
        parameters = inspect.signature(one).parameters.values()
    except (TypeError, ValueError):
        return False
    needed = [each for each in parameters if each.default is each.empty]
    if len(needed) != 1 or needed[0].kind > needed[0].POSITIONAL_OR_KEYWORD:
        return False
    said = needed[0].annotation
    return "PathLike" in (said if isinstance(said, str) else inspect.formatannotation(said))


def test_readers_name_the_file_that_is_not_there(tmp_path):
    """The message has the path as given."""
    path = tmp_path / "none.file"
    known = readers()
    assert len(known) > 20
    for name in known.keys() - _NAMES_ONLY:
        for kind in KINDS.values():
            with pytest.raises(FieldmapError) as caught:
                known[name](kind(path))
            assert caught.value.problems[0].where.startswith(str(path)), (name, kind)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_shipped_names_and_files_are_found(kind, tmp_path):
    assert fm.read_device(kind("drive_unit")).name == find_source(kind("drive_unit")).device_name
    assert fm.material(kind("steel_a3")).name == "steel_a3"
    field = fm.open_map(kind("sample"))
    path = store.write_map(kind(tmp_path / "map.h5"), store.read_map(kind("sample")))
    assert fm.open_map(kind(path)).coil_names == field.coil_names == store.read_info(kind(path)).coil_names
    ones = np.ones(len(field.coil_names))
    assert write_csv(field, kind(tmp_path / "map.csv"), ones) == tmp_path / "map.csv"
    assert write_c_files(field.at(ones), kind(tmp_path / "map.fmap"))[0] == tmp_path / "map.fmap"
    write_log(kind(tmp_path / "log.csv"), make_log(0.1, {"x": [1.0, 2.0]}, {"x": "m"}))
    assert read_log(kind(tmp_path / "log.csv"))["x"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_shapes_of_files_in_a_device(kind, tmp_path):
    """Records made in Python keep a path, and the device takes the file's hash."""
    mesh = Path(__file__).parent / "devices" / "block_of_two_regions.msh"
    (tmp_path / "solid.step").write_text("ISO-10303-21;")
    bodies = [
        fm.Body("mesh", "iron", fm.MeshFile(kind(mesh))),
        fm.Body("solid", "iron", fm.StepFile(kind(tmp_path / "solid.step")), mesh_size=0.005),
    ]
    device = fm.Device("one", "", bodies=bodies, materials={"iron": fm.LinearMaterial("iron", 100.0)})
    assert bodies[0].parts[0].shape == fm.MeshFile(mesh)
    assert {Path(name).name for name in device.included} == {"block_of_two_regions.msh", "solid.step"}
    assert len(fm.VolumeMesh.from_file(kind(mesh)).tetrahedra) > 100


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_pictures(kind, tmp_path):
    figures = pytest.importorskip("fieldmap.plot.figures")
    drawn = curves.Curves("a", "x", "y", (curves.Series("s", [0.0, 1.0], [1.0, 2.0]),))
    assert figures.save_curves(drawn, kind(tmp_path / "curves.svg")) == tmp_path / "curves.svg"
