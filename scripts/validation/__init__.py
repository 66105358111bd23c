"""Studies of scripts/validate.py, grouped by their references."""
