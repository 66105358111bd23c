"""Parts of scripts/studies/remembering_study.py."""
