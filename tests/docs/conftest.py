"""Records of the pages' pictures, and `pytest tests/docs --rewrite-pictures`, which draws the pictures anew."""

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.docs.pages import ROOT

IMAGES = ROOT / "docs" / "images"
RECORDS = IMAGES / "records.json"


def pytest_addoption(parser):
    """The option exists only if tests of this folder are named on the command line."""
    parser.addoption("--rewrite-pictures", action="store_true", help="write docs/images and its records anew")


def records() -> dict[str, dict[str, Any]]:
    """By picture: made_by, sha256 of the file, `shows` (the drawn content), `scene` (of the
    device alone), `inputs` (digests)."""
    found: dict[str, dict[str, Any]] = json.loads(RECORDS.read_text())
    return found


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _one_line(found: re.Match[str]) -> str:
    return "[" + re.sub(r",\s+", ", ", found[1]) + "]"


@pytest.fixture(scope="session")
def rewriting(request) -> bool:
    """Whether to write pictures anew."""
    return bool(request.config.getoption("--rewrite-pictures", default=False))


@pytest.fixture
def hold_picture(rewriting):
    """hold_picture(name, made_by, key, content, drawn): compare a picture's record with this content.

    drawn: the new file, which replaces the picture when pictures are written anew. share: as in `differences`.
    """
    from tests.docs.picture_record import differences

    def hold(
        name: str,
        made_by: str,
        key: str,
        content: dict[str, Any],
        drawn: Path | None = None,
        share: float = 1e-3,
    ) -> None:
        known = records() if RECORDS.is_file() else {}
        entry = known.get(name, {})
        changed = differences(entry.get(key), content, share=share)
        redrawn = drawn is None and digest(IMAGES / name) != entry.get("sha256")
        if rewriting and (changed or redrawn or entry.get("made_by") != made_by):
            if drawn is not None:
                shutil.copy(drawn, IMAGES / name)
            known[name] = {**entry, "made_by": made_by, "sha256": digest(IMAGES / name), key: content}
            text = json.dumps(dict(sorted(known.items())), indent=1)
            # Each list of numbers on one line.
            RECORDS.write_text(re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", _one_line, text) + "\n")
            return
        words = f"{name} is not what `{made_by}` draws: pytest tests/docs --rewrite-pictures draws it anew"
        assert changed == [], words
        assert entry["made_by"] == made_by

    return hold
