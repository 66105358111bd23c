"""Linear iron that carries more than iron can: a linear solution knows no saturation, so somebody must look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.materials import Material
from fieldmap.device.model import Device
from fieldmap.iron.solution import LinearSolution
from fieldmap.records import Record

WORTH_SAYING = 0.01
"""Share of a body's volume: at sharp edges |B| grows without bound as the mesh is refined."""

MOST_OF_ANY_IRON = 2.45
"""Polarisation of saturated iron-cobalt, T, the largest of any known material (Bozorth, Ferromagnetism, ch. 6)."""


@dataclass(frozen=True, repr=False)
class BodyBeyondSaturation(Record):
    """A body of linear iron in which |B| exceeds the largest polarisation its material can have.

    most: that polarisation, T; largest: |B| of the element with most, T; share: of the body's volume above `most`.
    """

    body: str
    material: str
    most: float
    largest: float
    share: float


def largest_polarisation(material: Material) -> float:
    """The polarisation B - mu0 H, T, that a law ends with or tends to; that of saturated iron-cobalt where the device
    file knows no law, or one that never saturates.

    >>> from fieldmap.device.model import Froehlich
    >>> largest_polarisation(Froehlich("iron", mu_r=1000.0, saturation=1.5))
    1.5
    """
    most = material.largest_polarisation
    return most if np.isfinite(most) else MOST_OF_ANY_IRON


def bodies_beyond_saturation(
    solution: LinearSolution, device: Device, currents: ArrayLike
) -> tuple[BodyBeyondSaturation, ...]:
    """Bodies of a linear solution with |B| above what they can polarise, in over a hundredth of their volume (of
    their surface, in the surface form).

    device: the one that was solved. currents (n_coils,), A. In soft iron, whose mu0 H is small beside B, |B| stands for
    the polarisation. At such currents the answer of linear iron does not hold: solve a nonlinear state.

    >>> import fieldmap as fm
    >>> device = fm.read_device("loop_and_sphere")
    >>> unit = fm.solve_linear(device)
    >>> bodies_beyond_saturation(unit, device, [1.0]), len(bodies_beyond_saturation(unit, device, [1e6]))
    ((), 1)
    """
    samples = solution.flux_density_samples(np.asarray(currents, dtype=float))
    found = []
    for body in device.bodies:
        material = device.materials[body.material]
        if material.role != "iron" or body.name not in samples.body_names:
            continue
        mine = samples.body == samples.body_names.index(body.name)
        most = largest_polarisation(material)
        weight = samples.weight[mine]
        share = float(weight[samples.size[mine] > most].sum() / weight.sum())
        if share > WORTH_SAYING:
            found.append(
                BodyBeyondSaturation(body.name, material.name, most, float(samples.size[mine].max()), share)
            )
    return tuple(found)
