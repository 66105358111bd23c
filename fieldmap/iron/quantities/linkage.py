"""Flux linkage and co-energy of the iron, from the fields inside it: docs/theory/forces.md (4), (5)."""

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0

from fieldmap.iron.forms.bh_law import law_values
from fieldmap.iron.forms.magnetisation import Magnetisation

Array = NDArray[np.float64]


def linkage_and_coenergy(
    volume: Array, material: Magnetisation, strength: Array, coils: Array, unit: Array
) -> tuple[Array, Array]:
    """What the iron adds to flux linkages (c, s) in Wb and to the co-energy (s,) in J.

    At the four points of every element, in T: strength (s, e, 4, 3), mu0 H of s solved sources; coils (s, e, 4, 3):
    field of their coils alone; unit (c, e, 4, 3): field of one ampere in each of c coils. The linkage is the exact
    derivative of the discrete co-energy, so both agree on any mesh.
    """
    sources = len(strength)
    linkage, coenergy = np.zeros((len(unit), sources)), np.zeros(sources)
    weight = 0.25 * volume / mu_0
    for s in range(sources):
        remanence = material.remanence[s]
        for q in range(4):
            h, t = strength[s, :, q], coils[s, :, q]
            size = np.linalg.norm(h, axis=1)
            b, stored = law_values(material.tables, material.law, size)
            slope = np.divide(b, size, out=np.ones_like(b), where=size > 1e-30)
            flux = slope[:, None] * h + remanence
            added = flux - h
            linkage[:, s] += np.einsum("e,ced,ed->c", weight, unit[:, :, q], added)
            local = np.sum(remanence * h - 0.5 * flux * h + 0.5 * added * t, axis=1)
            coenergy[s] += weight @ (stored + local)
    return linkage, coenergy
