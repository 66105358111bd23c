"""Files that people write: TOML with line numbers, kinds, findings, key paths, JSON Schema, and explanations of what
is wrong.

Knows no physics: a package that reads files of its own registers their kind (`kinds.register`).
"""
