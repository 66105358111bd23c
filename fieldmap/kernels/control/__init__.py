"""Compiled controllers, instruments and identification, sample by sample."""
