"""The files and commands that a tutorial shows."""

import re
from pathlib import Path

from kit.paths import ROOT

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
_BLOCK = re.compile(r"^```(\w+) ?(?:title=\"([^\"]+)\")?\n(.*?)^```", re.MULTILINE | re.DOTALL)
_SAVED = re.compile(r"\]\(([\w/.]+\.(?:yaml|py))\)")


def steps(page: Path) -> list[tuple[str | None, str]]:
    """Return the blocks of a page in order: the name of a file and its content, or None and commands."""
    return [(name or None, content) for _, name, content in _BLOCK.findall(page.read_text())]


def write_files(page: Path, folder: Path) -> None:
    """Write the files that a page shows, and those that its reader saves."""
    for name in _SAVED.findall(page.read_text()):
        (folder / Path(name).name).write_bytes((page.parent / name).read_bytes())
    for name, content in steps(page):
        if name is not None:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(content)
