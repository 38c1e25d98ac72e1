"""Write the moving picture of the README from the page of a drive: ``pictures.py RUN.html OUT.webp``."""

import io
import sys
from pathlib import Path

from kit.browser import Watched, chromium
from PIL import Image

STEP_S, FRAME_MS = 0.4, 100
"""Time of the drive between frames, and time that a frame is shown."""
WIDTH, QUALITY, MAX_BYTES = 720, 40, 600_000
STYLE = """
section { display: none; } #path, #brain { display: block; }
#path .control, .now, .legend, #player .bar { display: none; } #circuit svg { max-height: 500px; }
main, header, #caption { max-width: 1080px; }
"""


def main(page: Path, out: Path) -> None:
    frames = []
    with chromium() as browser:
        watched = Watched(browser, page.resolve().as_uri(), 1100, 720)
        watched.page.add_style_tag(content=STYLE)
        watched.page.evaluate("window.dispatchEvent(new Event('resize'))")
        end = float(watched.page.get_attribute("#time", "max"))
        for step in range(int(end / STEP_S) + 1):
            watched.to(step * STEP_S)
            frame = Image.open(io.BytesIO(watched.page.screenshot())).convert("RGB")
            frame.thumbnail((WIDTH, WIDTH))
            frames.append(frame)
    frames[0].save(
        out, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, quality=QUALITY, method=6
    )
    size = out.stat().st_size
    if size > MAX_BYTES:
        sys.exit(f"{out}: {size} bytes (limit {MAX_BYTES}): lower the quality or the width")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
