"""A version has one number; built archives hold the right files; workflow files call existing commands."""

import re
import tomllib
from importlib.metadata import distributions
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

import fieldmap

yaml = pytest.importorskip("yaml", reason='PyYAML is not installed (pip install "fieldmap[mag-manip]")')
ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_number_is_the_same_everywhere():
    number = PROJECT["version"]
    assert fieldmap.__version__ == number
    assert yaml.safe_load(read("CITATION.cff"))["version"] == number
    assert set(re.findall(r"fieldmap-([\d.]+)-cp311-abi3-\w+\.whl", read("docs/installation.md"))) == {number}
    assert set(re.findall(r"fieldmap (\d[\d.]*)", read("fieldmap/cli/__init__.py"))) == {number}


def test_the_citation_says_what_the_package_says():
    cited = yaml.safe_load(read("CITATION.cff"))
    assert cited["cff-version"] == "1.2.0"
    assert (cited["title"], cited["license"]) == (PROJECT["name"], PROJECT["license"])
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in PROJECT["authors"]]
    assert set(cited["keywords"]) == set(PROJECT["keywords"])


def test_every_requirement_has_a_lower_bound():
    extras = PROJECT["optional-dependencies"]
    for one in [*PROJECT["dependencies"], *(one for of in extras.values() for one in of)]:
        assert one.startswith("fieldmap[") or re.match(r"[\w.-]+(\[\w+\])?>=\d", one), one


def test_pinned_versions_take_the_oldest_python_that_the_package_takes():
    """By their own metadata, if installed in the pinned version."""
    oldest = PROJECT["requires-python"].removeprefix(">=") + ".0"
    pinned = dict(re.findall(r"^([\w.-]+)==(\S+)$", read("constraints.txt"), re.MULTILINE))
    pinned = {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pinned.items()}
    asked = {
        name: found.metadata.get("Requires-Python", "")
        for found in distributions()
        if pinned.get(name := re.sub(r"[-_.]+", "-", found.name).lower()) == found.version
    }
    assert len(asked) > 30
    assert {name: versions for name, versions in asked.items() if oldest not in SpecifierSet(versions)} == {}


def test_all_is_every_extra_that_is_small():
    extras = PROJECT["optional-dependencies"]
    (inside,) = (re.findall(r"[\w-]+", one)[1:] for one in extras["all"])
    others = {"mujoco", "jax", "video", "xarray", "optuna"}
    ours = {"bench", "docs", "test", "mutants", "all"}
    assert set(inside) == set(extras) - others - ours
    assert extras["xarray"][0] in extras["studies"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_run_what_there_is(path):
    jobs = yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"]
    lines = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert lines
    targets = set(re.findall(r"^([\w-]+):", read("Makefile"), re.MULTILINE))
    for line in lines:
        for word in line.split():
            if word.startswith(("tests/", "scripts/", ".ci/")):
                assert (ROOT / word).exists(), f"{path.name}: {word}"
        for target in re.findall(r"\bmake ([\w-]+)", line):
            assert target in targets, f"{path.name}: make {target}"


def test_there_are_workflows_for_three_systems():
    jobs = yaml.safe_load(read(".github/workflows/tests.yml"))["jobs"]
    systems = {"ubuntu-latest", "macos-latest", "windows-latest"}
    assert set(jobs["systems"]["strategy"]["matrix"]["os"]) == systems
    assert len(WORKFLOWS) == 3
