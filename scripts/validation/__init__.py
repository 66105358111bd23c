"""Studies of scripts/validate.py, grouped by what they are held against."""
