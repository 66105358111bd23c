"""The command line."""


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    raise NotImplementedError
