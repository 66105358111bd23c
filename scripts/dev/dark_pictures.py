"""For the site: a picture that has a dark variant beside it, NAME_dark.png, is followed by that one.

The theme shows the one of both that fits (`#only-light`, `#only-dark`). Pages name the light one alone, so that they
read well elsewhere.
"""

import re
from pathlib import Path
from typing import Any

_IMAGE = re.compile(r'<img\b([^>]*?)\bsrc="([^"#]+)\.png"([^>]*?)(/?)>')


def on_page_content(html: str, *, page: Any, config: Any, **_: Any) -> str:
    """Called by mkdocs with each page's HTML, in which addresses are relative to the page's source."""
    return with_dark_pictures(html, (Path(config["docs_dir"]) / page.file.src_uri).parent)


def with_dark_pictures(html: str, folder: Path) -> str:
    """html: of a page in `folder`."""

    def both(found: re.Match[str]) -> str:
        before, name, after, end = found.groups()
        if not (folder / f"{name}_dark.png").is_file():
            return found[0]
        return (
            f'<img{before}src="{name}.png#only-light"{after}{end}>'
            f'<img{before}src="{name}_dark.png#only-dark"{after}{end}>'
        )

    return _IMAGE.sub(both, html)
