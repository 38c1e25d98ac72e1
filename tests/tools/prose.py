"""Find the words that this project does not use; run by ``make lint``.

A line that needs one says why at its end: ``# prose: REASON`` (``//`` and ``<!--`` also open such a comment).
"""

import re
import subprocess
import sys
from pathlib import Path

SUFFIXES = {".py", ".md", ".yaml", ".toml", ".js", ".html"}
WORDS = """
    nobody, whoever, somebody, lest, mishap, mishaps, spoilt, hearken,  # prose: the list itself
    of late, in vain, let fall, lets fall, let go of, knows better,  # prose: the list itself
    what became of, is told, are told, was told  # prose: the list itself
"""
PHRASES = [phrase.split() for phrase in re.sub("#.*", "", WORDS).replace("\n", " ").split(",")]
# A phrase may be broken by the end of a line, and the next line may begin with a comment sign.
PATTERN = re.compile(
    r"\b(" + "|".join(r"\s(?:\s|#|//)*".join(words) for words in PHRASES) + r")\b", re.IGNORECASE
)
REASON = re.compile(r"(#|//|<!--) prose: \w")


def found(text: str) -> list[tuple[int, str]]:
    """Return the line number and the words of each match whose line gives no reason."""
    lines = text.split("\n")
    numbered = [(text.count("\n", 0, match.start()) + 1, match[0]) for match in PATTERN.finditer(text)]
    return [
        (number, " ".join(words.split()))
        for number, words in numbered
        if not REASON.search(lines[number - 1])
    ]


def tracked(root: Path) -> list[Path]:
    """Return the text files that git tracks below ``root``, but those of ``docs/lab``."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True)
    paths = [root / name for name in listed.stdout.split("\0") if name and not name.startswith("docs/lab/")]
    return [path for path in paths if (path.suffix in SUFFIXES or path.name == "Makefile") and path.is_file()]


def main(root: Path) -> int:
    """Print each match as ``file:line: words``; return 1 if there are any."""
    matches = [
        f"{path.relative_to(root)}:{number}: {words}"
        for path in tracked(root)
        for number, words in found(path.read_text(encoding="utf-8"))
    ]
    print("\n".join(matches), end="\n" if matches else "")
    return 1 if matches else 0


if __name__ == "__main__":
    sys.exit(main(Path.cwd()))
