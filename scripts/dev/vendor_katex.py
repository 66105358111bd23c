"""Copy KaTeX into docs/assets/katex: script, licence, and a style sheet that contains its fonts.

`npm pack katex` and `python scripts/dev/vendor_katex.py UNPACKED_PACKAGE`. The style sheet contains the fonts as data,
because a browser that opens the site from disk may refuse to read fonts from other files.
"""

import base64
import re
import shutil
import sys
from pathlib import Path

TARGET = Path(__file__).parents[2] / "docs" / "assets" / "katex"


def with_fonts(style: str, folder: Path) -> str:
    """The style sheet with its WOFF2 fonts as data, and without the fonts of older browsers."""

    def embedded(match: re.Match[str]) -> str:
        data = base64.b64encode((folder / match[1]).read_bytes()).decode()
        return f'src:url(data:font/woff2;base64,{data}) format("woff2")'

    return re.sub(r'src:url\((fonts/[\w-]+\.woff2)\) format\("woff2"\)[^}]*?(?=[;}])', embedded, style)


def main() -> None:
    """Write the three files."""
    package = Path(sys.argv[1])
    TARGET.mkdir(parents=True, exist_ok=True)
    shutil.copy(package / "dist" / "katex.min.js", TARGET)
    shutil.copy(package / "LICENSE", TARGET)
    style = with_fonts((package / "dist" / "katex.min.css").read_text(), package / "dist")
    assert "url(fonts" not in style
    (TARGET / "katex.min.css").write_text(style)


if __name__ == "__main__":
    main()
