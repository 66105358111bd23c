"""Bands that the planar model holds against the thesis: 3 mm in the equilibria, 12 % in the gradients."""

from tests.computed_parts import numbers


def row():
    return numbers("S5")


def test_eight_equilibria_within_three_millimetres():
    equilibria = [n for n in row() if n.name.startswith("equilibrium[")]
    assert len(equilibria) == 8
    for number in equilibria:
        assert abs(number.ours - number.thesis) < 3.0, number.place + number.name
        assert any("no flux" in text for text in number.assumptions)


def test_three_gradients_within_twelve_percent():
    gradients = [n for n in row() if n.unit == "T/m" and "open_space" not in n.name]
    assert len(gradients) == 3
    assert all(abs(number.deviation) < 0.12 for number in gradients), gradients


def test_open_space_is_printed_beside_and_is_another_machine():
    free = [n for n in row() if "open_space" in n.name]
    assert len(free) == 11
    assert max(n.ours for n in free) > 90
    assert all("open space" in n.assumptions for n in free)


def test_saturating_iron_moves_them_by_less_than_three_millimetres():
    """At 1000 A the iron is far from saturation; A-3's curve differs by its initial permeability of 1569."""
    linear, curve = (
        [n.ours for n in row() if n.name.startswith(f"{word}[") and n.place == "Table 2-3"]
        for word in ("equilibrium", "equilibrium_with_curve")
    )
    assert len(linear) == len(curve) == 4
    shift = [b - a for a, b in zip(linear, curve, strict=True)]
    assert abs(shift[0]) < 0.1
    assert all(0.5 < s < 3.0 for s in shift[1:])


def test_three_points_become_one():
    counts = {n.name: n.ours for n in row() if n.place.endswith("Fig. 2-11")}
    assert counts["near"] == 3
    assert counts["near_unstable"] == 1
    assert counts["far"] == 1
    assert abs(counts["depth_of_the_change"] - 75) < 5
