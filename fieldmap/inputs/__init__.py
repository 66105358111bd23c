"""Files that people write: TOML with line numbers, kinds, findings, key paths, JSON Schema, and explanations of errors.

The package knows no physics. `kinds.MARKS` lists all kinds of file; the schema of a kind is in the package that reads
it.
"""
