"""The live page in a real browser, while a mock rover drives."""

import csv
import time

import pytest
from bridge_bench import Rig
from browser import Watched, chromium

from rover_ncp import cli
from sim.live.live_run import LiveRun
from sim.live.processes import Process

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


def truth(folder):
    """Times in ns and speeds of the mock, as far as whole lines are written."""
    with (folder / "truth.csv").open() as file:
        return [(int(row["t_ns"]), float(row["v"])) for row in csv.DictReader(file) if row["contact"]]


def test_a_running_rover_is_seen_and_stopped(browser, tmp_path):
    with LiveRun(tmp_path) as running:
        watch = Process("watch", ["--robot", running.robot, "--port", "0"], tmp_path)
        running.processes.append(watch)
        address = watch.wait_for_line("watching at ")
        seen = Watched(browser, address)
        seen.until("!document.getElementById('stop').disabled")
        assert seen.page.text_content("#badge") == "waiting"
        running.deploy()
        seen.until("document.getElementById('badge').textContent === 'driving'")
        seen.until("Number(document.getElementById('time').value) > 3.2")
        before = seen.outline(), seen.neuron("AVB"), seen.clock()
        seen.until("Number(document.getElementById('time').value) > 5.5")
        after = seen.outline(), seen.neuron("AVB"), seen.clock()
        assert all(old != new for old, new in zip(before, after, strict=True))
        assert "turn" in seen.page.text_content("#phases")
        # The plots follow, too.
        seen.until("Math.max(...document.getElementById('commands').data.flatMap(trace => trace.x)) > 4.5")
        seen.photograph("watch_1280")
        assert truth(tmp_path)[-1][1] > 0.03

        pressed_ns = time.time_ns()
        seen.page.click("#stop")
        seen.until("document.getElementById('stopnote').textContent.startsWith('Stopped until released')")
        seen.until("document.getElementById('badge').textContent === 'fault'")
        deadline = time.monotonic() + 5
        while truth(tmp_path)[-1][0] < pressed_ns + 1_000_000_000:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        moving = [t for t, v in truth(tmp_path) if t >= pressed_ns and abs(v) > 0.002]
        assert (max(moving) - pressed_ns) * 1e-9 < 0.5
        # The drive is over: it can be looked at, and its pairs are there.
        seen.to(4.0)
        seen.until("document.getElementById('signs').checkVisibility()")
        assert "fault" in seen.page.text_content("#events")
        seen.page.click("#release")
        seen.until("document.getElementById('release').hidden")
        assert seen.complaints == []
        assert seen.foreign_requests(address) == []
        seen.page.close()

        phone = Watched(browser, address, 400, 850)
        phone.until("document.getElementById('events').textContent.includes('fault')")
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= 400
        phone.photograph("watch_400")
        watch.stop()
        phone.until("document.getElementById('badge').textContent === 'no connection'")
        assert phone.page.is_disabled("#stop")
        phone.page.close()


def test_who_may_only_look_sees_that(browser, tmp_path):
    keys = tmp_path / "keys"
    assert cli.run(["keys", "--out", str(keys)]) == 0
    listen = ["--listen", "tls/127.0.0.1:0", "--zenoh-config", str(keys / "bridge.json5")]
    (tmp_path / "rig").mkdir()
    with Rig(tmp_path / "rig", bridge=listen) as rig:
        options = ["--robot", rig.locator, "--port", "0", "--zenoh-config", str(keys / "viewer.json5")]
        watch = Process("watch", options, tmp_path)
        try:
            seen = Watched(browser, watch.wait_for_line("watching at "))
            seen.until("document.getElementById('stopnote').textContent.includes('not authorised to stop')")
            assert seen.page.is_disabled("#stop")
            assert seen.complaints == []
            seen.page.close()
        finally:
            watch.stop()
