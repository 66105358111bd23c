"""Compiled evaluation of maps: interpolants, the current model, and the inverse."""
