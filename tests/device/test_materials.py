"""Laws of materials: each is in a file of its own, and no module outside the folder names one."""

import re
from pathlib import Path

import numpy as np
import pytest

import fieldmap
from fieldmap.device.coils import COIL_KEYS
from fieldmap.device.materials import MATERIAL_KEYS, Material, keys_of_table

PACKAGE = Path(fieldmap.__file__).parent
CHOICES = MATERIAL_KEYS.values()
LAWS = [keys.makes for keys in CHOICES]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_a_kind_makes_a_law_that_answers_every_question(law):
    assert issubclass(law, Material)
    assert not law.__abstractmethods__
    assert law.role in ("iron", "magnet", "flux barrier")
    # A law that saturates is iron: magnets and barriers keep their permeability in every model.
    assert law.role == "iron" or not law.saturates
    assert law.role == "magnet" or not np.any(law.remanence)


def test_a_table_is_read_with_the_keys_of_its_kind():
    for keys in CHOICES:
        table = {"kind": keys.makes.kind} | ({"file": "steel"} if "file" in keys.model_fields else {})
        assert keys_of_table(table) is keys
    assert keys_of_table({"kind": "unobtainium"}) is None
    assert keys_of_table({"kind": ["linear"]}) is None
    assert keys_of_table({}) is None


@pytest.mark.parametrize(("folder", "choices"), [("materials", MATERIAL_KEYS), ("coils", COIL_KEYS)])
def test_no_other_module_names_a_class_of_a_folder(folder, choices):
    """A new law or coil is one file. `fieldmap` and `fieldmap.device.model` export the shipped classes; the magpylib
    modules build a rounded rectangle from blocks, and a coil from magpylib currents."""
    names = "|".join(sorted({keys.makes.__name__ for keys in choices.values()}))
    shown = ["__init__.py"] + ["sources/magpylib_objects.py", "device/magpylib_model.py"] * (
        folder == "coils"
    )
    for path in PACKAGE.rglob("*.py"):
        if PACKAGE / "device" / folder in path.parents or path in [PACKAGE / name for name in shown]:
            continue
        code = re.sub(r'""".*?"""|#.*', "", path.read_text(), flags=re.DOTALL)
        if path == PACKAGE / "device" / "model.py":
            code = re.sub(rf"^from fieldmap.device.{folder}.*$", "", code, flags=re.MULTILINE)
        assert not re.findall(rf"\b({names})\b", code), path
