"""The files and commands that a tutorial shows."""

import re
from pathlib import Path

from kit.paths import ROOT

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
_BLOCK = re.compile(r"^```(\w+) ?(?:title=\"([^\"]+)\")?\n(.*?)^```", re.MULTILINE | re.DOTALL)


def steps(page: Path) -> list[tuple[str | None, str]]:
    """Return the blocks of a page in order: the name of a file and its content, or None and commands."""
    return [(name or None, content) for _, name, content in _BLOCK.findall(page.read_text())]


def write_files(page: Path, folder: Path) -> None:
    """Write all files of a page."""
    for name, content in steps(page):
        if name is not None:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(content)
