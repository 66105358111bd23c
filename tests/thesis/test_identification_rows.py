"""What the rows of S16 and S17 on identification must show."""

import numpy as np
import pytest

from tests.computed_parts import computed

PARTS = ("S16_recovery", "S17_recovery", "S16_root_locus", "S16_times_in_minutes")


def numbers_of_both():
    return [number for part in PARTS for number in computed(part).comparisons]


def part(word):
    found = [n for n in numbers_of_both() if word in n.title]
    assert found
    return {n.name: n for n in found}


@pytest.mark.parametrize(
    "word", ["Does the plant come back".lower(), "step records of the horizontal models"]
)
def test_known_plants_come_back_within_one_percent(word):
    numbers = {
        name: n
        for title in {n.title for n in numbers_of_both()}
        if word in title
        for name, n in part(title).items()
    }
    assert numbers
    assert all(abs(n.deviation) < 0.01 for n in numbers.values())


def test_table_5_2_obeys_the_unit_gain_of_integral_action():
    """Its numbers and ours of the transcription: gain (1 - zero) / prod(1 - poles) = 1 within the printed digits."""
    for gain, zero, third, pair in [
        (0.002099, 0.9969, 0.9959, 0.9740 + 0.0301j),
        (0.00125, 0.9956, 0.9896, 0.9899 + 0.0207j),
    ]:
        assert gain * (1 - zero) / ((1 - third) * abs(1 - pair) ** 2) == pytest.approx(1.0, abs=0.02)


def test_the_models_arc_is_that_of_the_table_and_minutes_bring_it_closer():
    def distance(word, gains):
        numbers = part(word)
        return np.array(
            [
                abs(
                    complex(numbers[f"pair_real[{k}]"].ours, numbers[f"pair_imaginary[{k}]"].ours)
                    - complex(numbers[f"pair_real[{k}]"].thesis, numbers[f"pair_imaginary[{k}]"].thesis)
                )
                for k in gains
            ]
        )

    model = part("the final model at the gains")
    real = [model[f"pair_real[{k}]"].ours for k in range(4)]
    assert np.all(np.diff(real) > 0)  # towards q = 1 as the gain falls, as the printed ones do
    assert distance("the final model at the gains", range(4)).max() < 0.03
    assert distance("times in minutes", (1, 2, 3)).max() < 0.0015
    assert distance("the final model at the gains", (1, 2, 3)).min() > 0.007


def test_minutes_predict_what_they_were_not_fitted_to():
    numbers = part("times in minutes")
    for name, bound in (("zero[1]", 5e-4), ("zero[2]", 5e-4), ("peak_time", 0.05), ("overshoot", 0.05)):
        assert abs(numbers[name].deviation) < bound
