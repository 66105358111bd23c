"""Laws of materials: each stands in a file of its own, and nothing outside the folder names one."""

import re
from pathlib import Path

import numpy as np
import pytest

import fieldmap
from fieldmap.device import materials
from fieldmap.device.materials import Material, keys_of_table, material_choices

PACKAGE = Path(fieldmap.__file__).parent
FOLDER = Path(materials.__file__).parent
CHOICES = material_choices()


@pytest.mark.parametrize("keys", CHOICES, ids=lambda keys: keys.tag)
def test_a_kind_makes_a_law_that_answers_every_question(keys):
    assert issubclass(keys.material, Material)
    assert not keys.material.__abstractmethods__
    assert keys.material.role in ("iron", "magnet", "flux barrier")
    # A law that saturates is iron: magnets and barriers keep their permeability in every model.
    assert keys.material.role == "iron" or not keys.material.saturates


def test_a_table_is_read_with_the_keys_of_its_kind():
    for keys in CHOICES:
        table = {"kind": keys.kind_of_file()} | ({"file": "steel"} if "file" in keys.model_fields else {})
        assert keys_of_table(table) is keys
    assert keys_of_table({"kind": "unobtainium"}) is None
    assert keys_of_table({}) is None


def test_the_usual_choice_comes_first_and_the_rest_in_a_fixed_order():
    tags = [keys.tag for keys in CHOICES]
    assert tags[0] == "linear"
    assert len(set(tags)) == len(tags)
    assert [keys.rank for keys in CHOICES] == sorted(keys.rank for keys in CHOICES)


def test_no_other_module_names_a_law():
    """A new law is one file. `fieldmap` and `fieldmap.device.model` offer the shipped ones to Python."""
    names = "|".join(sorted({keys.material.__name__ for keys in CHOICES}))
    for path in PACKAGE.rglob("*.py"):
        if FOLDER in path.parents or path == PACKAGE / "__init__.py":
            continue
        code = re.sub(r'""".*?"""|#.*', "", path.read_text(), flags=re.DOTALL)
        if path == PACKAGE / "device" / "model.py":
            code = re.sub(r"^from fieldmap.device.materials.*$", "", code, flags=re.MULTILINE)
        assert not re.findall(rf"\b({names})\b", code), path


def test_only_magnets_have_remanence():
    for keys in CHOICES:
        if keys.material.role != "magnet":
            assert not np.any(keys.material.remanence)
