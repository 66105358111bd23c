"""Hook of mkdocs: a picture with a dark variant NAME_dark.png in its folder is followed by that variant.

The theme shows the one that fits (`#only-light`, `#only-dark`). Pages name the light picture only, so that they read
well elsewhere.
"""

import re
from pathlib import Path
from typing import Any

_IMAGE = re.compile(r'<img\b([^>]*?)\bsrc="([^"#]+)\.png"([^>]*?)(/?)>')


def on_page_content(html: str, *, page: Any, config: Any, **_: Any) -> str:
    """Called by mkdocs with each page's HTML, in which addresses are relative to the page's source."""
    return with_dark_pictures(html, (Path(config["docs_dir"]) / page.file.src_uri).parent)


def with_dark_pictures(html: str, folder: Path) -> str:
    """The HTML of a page in `folder`, with the dark variants of its pictures."""

    def both(found: re.Match[str]) -> str:
        before, name, after, end = found.groups()
        if not (folder / f"{name}_dark.png").is_file():
            return found[0]
        return (
            f'<img{before}src="{name}.png#only-light"{after}{end}>'
            f'<img{before}src="{name}_dark.png#only-dark"{after}{end}>'
        )

    return _IMAGE.sub(both, html)
