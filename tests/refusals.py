"""Errors of wrong input, checked by the texts of their first problem."""

from contextlib import contextmanager

import pytest


@contextmanager
def refused(error, **parts):
    """A block that must raise this error. parts of its first problem: where and received end with these texts, in whole
    words; must_hold and remedy contain them. Yields pytest's caught error."""
    with pytest.raises(error) as caught:
        yield caught
    problem = caught.value.problems[0]
    for name, words in parts.items():
        text = getattr(problem, name)
        ends = f" {text}".endswith(f" {words.lstrip(': ')}")
        assert ends if name in ("where", "received") else words in text, (name, text, words)
