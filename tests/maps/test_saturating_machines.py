"""The quickest twelve of the sixty machines of `scripts/validate.py --only saturating_machines`: at new states a map is
as accurate as it states and as requested. None of these machines is refused."""

import importlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"
# Factor on the mesh sizes of the study.
MACHINES = {
    "one_core-soft_ferrite": 1.0,
    "opposed_cores-two_points": 1.5,
    "two_cores_bar-cobalt_iron": 1.0,
    "c_yoke-pure_iron": 1.0,
    "c_yoke_two_coils-nickel_iron": 1.0,
    "ring_core-two_hundred_points": 1.0,
    "four_cores_plate-m19": 1.5,
    "core_in_tube-arctangent": 1.0,
    "core_and_magnet-pure_iron": 1.0,
    "cores_in_background-m19": 1.0,
    "planar5-cobalt_iron": 1.2,
    "tilted_cores_gap-mu_metal": 2.0,
}


@pytest.fixture(scope="module")
def validation():
    """module(name): a module of scripts/validation/saturating."""

    def module(name):
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(SCRIPTS))
            return importlib.import_module(f"validation.saturating.{name}")

    return module


@pytest.mark.parametrize("name", MACHINES)
def test_a_map_is_as_accurate_as_it_says(validation, name):
    machine = replace(validation("combinations").BY_NAME[name], coarser=MACHINES[name])
    trial = validation("trial").tried(machine, random=6, searched=0)
    assert not trial.refusal
    assert trial.by_stated <= 1.5
    flux, gradient = trial.by_asked
    assert flux <= 2.0
    assert gradient <= 4.0


def test_sixty_machines_can_be_read(validation):
    """Each device and each steel is in several machines."""
    machines = validation("combinations").COMBINATIONS
    assert len({machine.name for machine in machines}) == len(machines) == 60
    for kind in ("device_name", "steel_name"):
        assert min(Counter(getattr(machine, kind) for machine in machines).values()) > 1
    assert {machine.steel_name for machine in machines} == set(validation("steels").STEELS)
    folder = validation("combinations").FOLDER
    assert {machine.device_name for machine in machines} == {path.stem for path in folder.glob("*.toml")}
    for machine in machines:
        assert 1 <= len(machine.device().coils) <= 8
