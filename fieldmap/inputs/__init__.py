"""Files that people write: TOML with line numbers, findings, key paths, and explanations of what is wrong.

Knows no physics.
"""
