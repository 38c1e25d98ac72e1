"""A browser for the tests of pages; `make test-browser` installs its driver and needs chromium."""

import contextlib
import os
import shutil
import time
from pathlib import Path

SHOTS = Path("runs/browser")
"""Where the tests leave their pictures for people to look at."""
TIMEOUT_S = 20.0
SLIDE = """t => {
  const slider = document.getElementById('time');
  slider.value = t;
  slider.dispatchEvent(new Event('input'));
}"""
CLICKED = """addEventListener('click', event => {
  window.clicked = performance.timeOrigin + event.timeStamp;
}, true);"""
VESSEL = """name => {
  const group = document.querySelector(`[data-neuron=${name}]`), level = group.querySelector('rect');
  const number = group.querySelector('.value').textContent;
  return [level.getAttribute('fill'), Number(level.getAttribute('height')), number];
}"""


@contextlib.contextmanager
def chromium():
    """Run Debian's chromium; fails where it is missing."""
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium")
    assert program, "no chromium: apt-get install chromium fonts-dejavu-core"
    # Chromium's own sandbox cannot be had by root.
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=program, args=arguments)
        yield running
        running.close()


class Watched:
    """A page together with whatever it complains of and asks for."""

    def __init__(self, browser, address, width=1280, height=900, shown="#circuit .neuron"):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.complaints, self.requests = [], []
        self.page.on("console", lambda said: self.complaints.append(f"{said.type}: {said.text}"))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda asked: self.requests.append(asked.url))
        self.page.add_init_script(CLICKED)
        self.page.goto(address)
        self.page.wait_for_selector(shown)

    def until(self, script, timeout_s=TIMEOUT_S):
        """Wait until a script says yes; playwright's own waiting needs eval, which the page forbids."""
        deadline = time.monotonic() + timeout_s
        while not self.page.evaluate(script):
            assert time.monotonic() < deadline, f"never true: {script}"
            self.page.wait_for_timeout(20)

    def click(self, selector, timeout_s=TIMEOUT_S):
        """Click; return when the browser took the click, in s since the epoch.

        What playwright does before (waiting for frames, finding the place) is no part of the page; what the
        page's own script lets the click wait for is.
        """
        self.page.click(selector, timeout=1000 * timeout_s, no_wait_after=True)
        return self.page.evaluate("window.clicked") / 1000

    def to(self, t):
        """Move the slider, and wait until the page is there."""
        self.page.evaluate(SLIDE, t)
        self.until(f"document.getElementById('clock').textContent === '{t:.1f} s'")

    def outline(self):
        """Where the plotted outline of the rover starts: its front left corner, by the estimate."""
        return self.page.evaluate("(d => [d.x[0], d.y[0]])(document.getElementById('path-plot').data[7])")

    def neuron(self, name):
        """What a neuron's vessel looks like: colour, height, number."""
        return self.page.evaluate(VESSEL, name)

    def clock(self):
        """The moment that is shown, in s."""
        return float(self.page.text_content("#clock").removesuffix(" s"))

    def photograph(self, name):
        """Leave two pictures: what one sees first, and the whole page."""
        SHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SHOTS / f"{name}_top.png")
        self.page.add_style_tag(content="#player { position: static !important; }")
        self.page.screenshot(path=SHOTS / f"{name}.png", full_page=True)

    def foreign_requests(self, own):
        """What was asked of anybody but ``own``."""
        return [url for url in self.requests if not url.startswith((own, "data:"))]
