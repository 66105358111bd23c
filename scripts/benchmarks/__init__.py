"""Sections of scripts/benchmark.py, one a file."""
