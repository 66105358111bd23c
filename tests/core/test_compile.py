"""The systems that the core is compiled for, and the names of their wheels."""

import runpy
import struct
from pathlib import Path

import pytest

from fieldmap.core.compile import compile_libraries, libraries, wheel_tag

WHEELS = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "dev" / "wheels.py"))
PLATFORMS = {
    "x86_64-linux": "manylinux_2_17_x86_64",
    "aarch64-linux": "manylinux_2_17_aarch64",
    "x86_64-darwin": "macosx_13_0_x86_64",
    "aarch64-darwin": "macosx_13_0_arm64",
    "x86_64-win32": "win_amd64",
    "aarch64-win32": "win_arm64",
}


def test_wheels_are_built_for_these_systems():
    assert set(WHEELS["TARGETS"]) == set(PLATFORMS)


@pytest.mark.parametrize("target", PLATFORMS)
def test_a_wheel_is_for_one_system_and_all_pythons_from_the_oldest_on(target):
    assert wheel_tag(*target.split("-")) == f"cp311-abi3-{PLATFORMS[target]}"


@pytest.mark.parametrize("target", PLATFORMS)
def test_zig_is_told_the_system_and_the_folder_of_what_differs_there(target, monkeypatch, tmp_path):
    commands = []

    def compiled(command, **options):
        commands.append(command)
        Path(command[command.index("-o") + 1]).touch()
        return type("Done", (), {"returncode": 0})

    monkeypatch.setattr("fieldmap.core.compile.FOLDER", tmp_path)
    monkeypatch.setattr("fieldmap.core.compile.subprocess.run", compiled)
    machine, system = target.split("-")
    assert compile_libraries(machine, system, None, tmp_path / "other") == list(
        libraries(machine, system).values()
    )
    assert sorted(tmp_path.iterdir()) == sorted(libraries(machine, system).values())
    name = {"linux": "linux-gnu.2.17", "darwin": "macos.13.0", "win32": "windows-gnu"}[system]
    for command in commands:
        assert command[command.index("-target") + 1] == f"{machine}-{name}"
        assert command[command.index("-isystem") + 1] == str(tmp_path / "other" / "include")
        assert (str(tmp_path / "other" / "libs" / "python3.lib") in command) == (system == "win32")


@pytest.mark.parametrize("target", PLATFORMS)
def test_a_library_for_another_processor_or_system_is_seen(target):
    machine, system = target.split("-")
    begin, numbers = {
        "linux": (b"\x7fELF".ljust(18, b"\0"), {"x86_64": b"\x3e\0", "aarch64": b"\xb7\0"}),
        "darwin": (b"\xcf\xfa\xed\xfe", {"x86_64": b"\x07\0\0\x01", "aarch64": b"\x0c\0\0\x01"}),
        "win32": (
            b"MZ".ljust(60, b"\0") + struct.pack("<I", 64) + b"PE\0\0",
            {"x86_64": b"\x64\x86", "aarch64": b"\x64\xaa"},
        ),
    }[system]
    rest = b"\0PyInit_library\0GLIBC_2.14\0".ljust(80, b"\0")
    assert WHEELS["of_library"](begin + numbers.pop(machine) + rest, machine, system).startswith("0.00 MB")
    (other,) = numbers.values()
    with pytest.raises(RuntimeError, match="not a library for"):
        WHEELS["of_library"](begin + other + rest, machine, system)


def test_a_library_that_needs_a_newer_c_library_is_seen():
    content = b"\x7fELF".ljust(18, b"\0") + b"\x3e\0PyInit_library\0GLIBC_2.14\0GLIBC_2.29\0"
    with pytest.raises(RuntimeError, match=r"glibc 2\.29"):
        WHEELS["of_library"](content, "x86_64", "linux")
