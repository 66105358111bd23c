"""The coils' field in the iron: circulations along edges by the mesh's symmetry, against all circulations computed."""

from pathlib import Path

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.iron import generate_mesh
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.operators.assembled import assemble
from fieldmap.sources import unit_flux_densities

TWO_CORES = Path(__file__).parents[1] / "devices" / "two_cores.toml"


@pytest.mark.parametrize(("device", "operations"), [(TWO_CORES, 4), ("disk_six_cores", 12)])
def test_images_of_edges_and_coils_need_no_field(device, operations):
    """One device has two mirrors, the other has rotations and mirrors that move every coil."""
    device = read_device(device)
    mesh = generate_mesh(device, 0.4, "auto")
    assert len(mesh.symmetry.group.operations) == operations
    elements, asked = PotentialForm(assemble(mesh)).elements, []

    def field(points):
        asked.append(len(points))
        return unit_flux_densities(device.coils, points)

    exact = elements.coil_field(field)
    of_all, asked[:] = sum(asked), []
    ours = elements.coil_field(field, mesh.symmetry)
    # Edges on mirrors are images of themselves.
    assert of_all / operations <= sum(asked) < 0.4 * of_all
    scale = np.abs(exact.bubble).max()
    assert ours.bubble == pytest.approx(exact.bubble, abs=1e-11 * scale)
    assert ours.constant == pytest.approx(exact.constant, abs=1e-11 * np.abs(exact.constant).max())
