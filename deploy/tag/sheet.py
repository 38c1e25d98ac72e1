"""Tags to print: PDF pages true to size, each with a ruler that shows whether the printer scaled them."""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from deploy.tag.board import PAGES, board_map
from deploy.tag.pattern import CELLS, pattern
from rover_ncp.core.errors import UsageError

INCH_M = 0.0254
MARGIN_M = 0.012
"""Border of a page that printers leave white."""
RULER_M = 0.1


def tag_pages(ids: Sequence[int], size: float, page: str) -> bytes:
    """Return a PDF with a tag on each page, the edge of its black square ``size`` m. Raises UsageError."""
    width, _ = PAGES[page]
    needed = size * (1.0 + 2.0 / CELLS) + 2 * MARGIN_M
    if needed > width:
        raise UsageError(
            f"--size {size:g}: with its white border the tag needs a page as wide as {needed:.3f} m, "
            f"{page} has {width:.3f} m"
        )
    sheets = [(f"tag36h11 id {tag}, {1000 * size:g} mm", [(tag, size, 0.0, 0.0)]) for tag in ids]
    return _pdf(PAGES[page], sheets)


def board_page(number: int, page: str) -> bytes:
    """Return a PDF with a board, on its side."""
    height, width = PAGES[page]
    board = board_map(number, page)
    title = f"{board.frame}: hang it upright, this line below. No second print of it in one place."
    return _pdf((width, height), [(title, [(tag.id, tag.size, tag.y, tag.z) for tag in board.tags])])


def _pdf(
    page: tuple[float, float], sheets: Sequence[tuple[str, Sequence[tuple[int, float, float, float]]]]
) -> bytes:
    """Return a page, so wide and so high in m, for each title with its tags: id, size, x and y of the centre.

    The tags' middle is the page's, above the ruler.
    """
    width, height = page
    file = io.BytesIO()
    with PdfPages(file, metadata={"Title": "AprilTags", "CreationDate": None}) as pdf:
        for title, tags in sheets:
            figure = Figure(figsize=(width / INCH_M, height / INCH_M))
            axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set(xlim=(0.0, width), ylim=(0.0, height))
            axes.axis("off")
            edges = [(x, y, 0.5 * size) for _, size, x, y in tags]
            dx = 0.5 * width - 0.5 * (min(x - h for x, _, h in edges) + max(x + h for x, _, h in edges))
            dy = 0.5 * height - 0.5 * (min(y - h for _, y, h in edges) + max(y + h for _, y, h in edges))
            for tag, size, x, y in tags:
                _draw(axes, pattern(tag), x + dx, y + dy + 0.01, size)
            y = MARGIN_M + 0.006
            axes.text(MARGIN_M, y + 0.007, title, fontsize=9)
            for mm in range(0, round(1000 * RULER_M) + 1, 10):
                x = MARGIN_M + mm / 1000
                axes.plot([x, x], [y, y + (0.005 if mm % 50 == 0 else 0.003)], "k", linewidth=0.6)
            axes.plot([MARGIN_M, MARGIN_M + RULER_M], [y, y], "k", linewidth=0.6)
            words = f"{1000 * RULER_M:g} mm: measure it. Print at 100 %, without scaling to the page."
            axes.text(MARGIN_M, y - 0.006, words, fontsize=7)
            pdf.savefig(figure)
    return file.getvalue()


def _draw(axes: Axes, cells: NDArray[np.uint8], x: float, y: float, size: float) -> None:
    cell = size / CELLS
    left, top = x - 0.5 * size, y + 0.5 * size
    # The black square first, its white cells on it: black neighbours drawn alone leave hairlines between.
    axes.add_patch(Rectangle((left, top - size), size, size, facecolor="black", edgecolor="none"))
    for row, column in np.argwhere(cells):
        corner = left + column * cell, top - (row + 1) * cell
        axes.add_patch(Rectangle(corner, cell, cell, facecolor="white", edgecolor="none"))
