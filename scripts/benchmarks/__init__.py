"""Sections of scripts/benchmark.py, one per file."""
