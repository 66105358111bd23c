"""Controllers and instruments for compiled loops of numba, sample by sample."""
