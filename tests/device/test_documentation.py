"""The reference page of the format: it is complete, names no unknown key, and its example is read."""

import json
import re
from pathlib import Path

from fieldmap.device import read_device
from fieldmap.device.schema import DeviceFile, MaterialFile
from fieldmap.io.json_schema import json_schema
from fieldmap.shipped import shipped_folder, shipped_names

ROOT = Path(__file__).parents[2]
PAGE = "".join((ROOT / "docs" / name).read_text() for name in ("device_files.md", "device_tables.md"))
UNIT = r"(mm|deg|g|T|A_m2|g_mm2|N_s_per_m|A_per_V|A|V|ohm|mH|A_per_m|T_per_m)"


def keys_of_the_format() -> set[str]:
    keys: set[str] = set()

    def collect(schema) -> None:
        if isinstance(schema, dict):
            keys.update(schema.get("properties", {}))
            for value in schema.values():
                collect(value)
        elif isinstance(schema, list):
            for value in schema:
                collect(value)

    for root in (DeviceFile, MaterialFile):
        collect(json.loads(json.dumps(json_schema(root))))
    return keys


def test_every_key_is_on_the_page():
    written = set(re.findall(r"`(\w+)`", PAGE))
    assert keys_of_the_format() - written == set()


def test_every_key_with_a_unit_on_the_page_exists():
    written = {match[0] for match in re.finditer(rf"\b[a-zA-Z]\w*_{UNIT}\b", PAGE)}
    assert len(written) > 30
    assert written - keys_of_the_format() == set()


def test_the_example_is_a_device_file(tmp_path):
    example = re.search(r"```toml\n(#:schema.*?)```", PAGE, re.DOTALL)[1]
    (tmp_path / "example.toml").write_text(example)
    assert read_device(tmp_path / "example.toml").coil_names == ("1",)


def test_the_list_of_shipped_devices_is_complete():
    listed = set(re.findall(r"`([\w/]+)\.toml`", (shipped_folder("geometry") / "README.md").read_text()))
    assert listed == {*shipped_names("geometry"), *shipped_names("geometry", "materials")}
