"""Errors of wrong input, by what their first problem says."""

from contextlib import contextmanager

import pytest


@contextmanager
def refused(error, **parts):
    """A block that must raise this error. parts: where, received: how these texts of its first problem end, in whole
    words; must_hold, remedy: what they contain. Gives what pytest has caught."""
    with pytest.raises(error) as caught:
        yield caught
    problem = caught.value.problems[0]
    for name, words in parts.items():
        text = getattr(problem, name)
        ends = f" {text}".endswith(f" {words.lstrip(': ')}")
        assert ends if name in ("where", "received") else words in text, (name, text, words)
