"""Words on a picture: where they hang, and where they stand."""

from types import SimpleNamespace

import pytest

pytest.importorskip("pyvista")
from vtkmodules.vtkRenderingCore import vtkTextProperty

from fieldmap.plot.scales import add_words


@pytest.mark.parametrize(
    ("height", "place"), [(0.98, "Top"), (0.51, "Top"), (0.5, "Bottom"), (0.02, "Bottom")]
)
def test_words_hang_from_their_place_in_the_upper_half_and_stand_on_it_below(height, place):
    drawn = SimpleNamespace(prop=vtkTextProperty())
    given = {}
    scene = SimpleNamespace(add_text=lambda words, **how: given.update(how, words=words) or drawn)
    add_words(scene, "one\ntwo", (0.03, height), 15)
    assert drawn.prop.GetVerticalJustificationAsString() == place
    assert (given["words"], given["position"], given["font_size"]) == ("one\ntwo", (0.03, height), 15)
    assert given["viewport"]
