"""Laws that no iron follows are refused before they are used: a device made in Python has passed no reader."""

import numpy as np
from scipy.constants import mu_0

from fieldmap.device.marrocco import marrocco_end
from fieldmap.device.model import BHTable, Marrocco, SaturatingMaterial
from fieldmap.errors import InputError, Problem

# Device files are held to the slope of free space. Here stands what the solver bears: formulas in B, such as the law of
# tests/reference/axisymmetric_saturated.csv, dip to 0.62 of it.
_SMALLEST_SLOPE = 0.5 * mu_0


def require_physical(material: SaturatingMaterial) -> None:
    """Raise InputError unless dB/dH is nowhere below that of free space and the polarisation ends somewhere."""
    if isinstance(material, BHTable):
        fault = _table_fault(material)
    elif isinstance(material, Marrocco):
        constants = material.eps, material.c, material.alpha, material.tau
        positive = 0 < material.eps < 1 and material.alpha >= 1 and material.tau > 0
        finite = positive and np.isfinite(marrocco_end(*constants))
        text = "the slope dB/dH must be positive and fall to that of free space"
        fault = None if finite else (text, f"eps, c, alpha, tau = {constants}")
    else:
        sound = material.mu_r > 1 and 0 < material.saturation < np.inf
        text = "mu_r must be above 1 and the saturation polarisation a finite number above 0"
        fault = None if sound else (text, f"mu_r = {material.mu_r}, saturation = {material.saturation}")
    if fault is not None:
        where = f"material '{material.name}'"
        raise InputError(Problem(where, *fault, "correct the law; docs/device_files.md describes them"))


def _table_fault(material: BHTable) -> tuple[str, str] | None:
    h, b = (np.asarray(values, dtype=float) for values in (material.h, material.b))
    if h.ndim != 1 or h.shape != b.shape or len(h) < 2 or not np.isfinite([h, b]).all():
        return "H and B must be as many finite numbers, two at least", f"shapes {h.shape} and {b.shape}"
    steps = np.diff(h, prepend=0.0)
    if (steps <= 0).any():
        return "H must be strictly increasing from above 0", f"{h[np.argmax(steps <= 0)]:g} A/m out of order"
    slope = np.diff(b, prepend=0.0) / steps
    if (slope < _SMALLEST_SLOPE).any():
        k = int(np.argmax(slope < _SMALLEST_SLOPE))
        text = "the slope dB/dH must nowhere be below that of free space, mu0 = 1.2566e-6 T m/A"
        return text, f"{slope[k]:.4g} T m/A up to point {k + 1}"
    if material.saturation is not None:
        polarisation = b[-2:] - mu_0 * h[-2:]
        if not polarisation[0] < polarisation[1] < material.saturation:
            text = "B - mu0 H must rise at the table's end and end below the saturation polarisation"
            return text, f"{polarisation[0]:.4g} and {polarisation[1]:.4g} T before {material.saturation:g} T"
    return None
