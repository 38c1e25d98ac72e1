"""Recorded sessions of third-party clients with a third-party robot (tests/data/arcos), for several tests."""

import json
import re
from dataclasses import dataclass
from functools import cached_property

from kit.paths import DATA

FOLDER = DATA / "arcos"
VECTORS = json.loads((FOLDER / "vectors.json").read_text())

ARIA_LINE = re.compile(
    r"(?P<label>.*) pose (?P<x>\S+) (?P<y>\S+) (?P<th>\S+) vel (?P<vel>\S+) l (?P<l>\S+) r (?P<r>\S+) "
    r"rot (?P<rot>\S+) .* flags (?P<flags>\S+) stall (?P<stall>\S+)"
)
PLAYER_LINE = re.compile(
    r"cmd .* pose (?P<x>\S+) (?P<y>\S+) (?P<th>\S+) vel (?P<vel>\S+) (?P<omega>\S+) stall"
)


@dataclass(frozen=True)
class Capture:
    """One session: what went which way when."""

    name: str

    @property
    def model(self) -> str:
        return "p3at" if self.name.endswith("p3at") else "p3at-sh"

    @cached_property
    def _records(self) -> list[dict]:
        text = (FOLDER / "captures" / f"{self.name}.jsonl").read_text()
        return [json.loads(line) for line in text.splitlines()]

    def chunks(self, direction: str) -> list[tuple[float, bytes]]:
        """Return (time in s, bytes as they arrived); direction is c2r or r2c."""
        return [
            (record["t"], bytes.fromhex(record.get("out", record["hex"])))
            for record in self._records
            if record.get("dir") == direction and "hex" in record
        ]

    def said(self, pattern: re.Pattern[str]) -> list[dict[str, str]]:
        """Return what the third-party client printed about the robot, line by line."""
        text = (FOLDER / "captures" / f"{self.name}.expected.txt").read_text()
        return [found.groupdict() for line in text.splitlines() if (found := pattern.match(line))]


CAPTURES = [Capture(path.stem) for path in sorted((FOLDER / "captures").glob("*.jsonl"))]
