"""The board: a printed page of tags whose places are known from the print. Each board is a frame of its own.

The axes of the frame: x out of the page, y to the reader's right, z up, from the middle of the page's tags.
"""

from pathlib import Path

from deploy.place.place import BOARD
from deploy.tag.tag_map import IDS, Tag, TagMap
from rover_ncp.core.config import load_yaml

PAGES: dict[str, tuple[float, float]] = {
    "a4": (0.210, 0.297),
    "a3": (0.297, 0.420),
    "letter": (0.2159, 0.2794),
}
"""Width and height of an upright page, m."""
A4_M = PAGES["a4"][1]
_LARGE, _MIDDLE, _SMALL = 0.104, 0.044, 0.032
"""Edges of black squares on A4, m: for afar, for the way between, and for a camera before the page."""
LAYOUT = (
    *((_LARGE, x, 0.030) for x in (-0.0845, 0.0845)),
    *((_MIDDLE, x, -0.060) for x in (-0.1145, -0.0545, 0.0545, 0.1145)),
    *((_SMALL, 0.0, y) for y in (-0.066, -0.026, 0.014, 0.054)),
)
"""Edge of each tag's black square, and its centre to the right and up, m on A4. Other pages scale it."""
NUMBERS = range(1, IDS // len(LAYOUT))
"""Boards that can be told apart; the ids below those of board 1 are for single tags."""


def board_name(number: int, page: str) -> str:
    """Return the name of a board, which is the frame of the poses by it."""
    return f"board-{number}-{page}"


def board_map(number: int, page: str) -> TagMap:
    """Return the tags of a board in its own frame."""
    scale = PAGES[page][1] / A4_M
    first = number * len(LAYOUT)
    tags = (
        Tag(id=first + index, size=scale * size, x=0.0, y=scale * right, z=scale * up)
        for index, (size, right, up) in enumerate(LAYOUT)
    )
    return TagMap(frame=board_name(number, page), tags_on="board", tags=tuple(tags))


def board_of(name: str) -> TagMap | None:
    """Return the tags of the board of that name; None if no board has it."""
    found = BOARD.fullmatch(name)
    return board_map(int(found[1]), found[2]) if found and int(found[1]) in NUMBERS else None


def load_tags(path: Path) -> TagMap:
    """Return the tags of a board, by its name, or of a file. Raises FileError and ConfigError."""
    board = None if path.exists() else board_of(path.name)
    return load_yaml(path, TagMap) if board is None else board
