"""The live page in a real browser, while a mock rover drives."""

import time
from types import SimpleNamespace

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.browser import Watched, chromium

from rover_ncp import cli
from sim.live.live_run import LiveRun
from sim.live.processes import Process

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


def watch(running):
    """Start the live page of a run; return its process and its address."""
    options = ["--robot", running.robot, "--port", "0"]
    process = running.start_process(lambda: Process("watch", options, running.folder))
    return process, process.wait_for_line("watching at ")


def test_a_running_rover_is_seen_and_stopped(browser, tmp_path):
    with LiveRun(tmp_path) as running:
        process, address = watch(running)
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
        # The plots follow, too.
        seen.until("Math.max(...document.getElementById('commands').data.flatMap(trace => trace.x)) > 4.5")
        seen.photograph("watch_1280")
        assert running.truth.speed() > 0.03

        clicked_s = seen.click("#stop")
        pressed_ns = time.monotonic_ns() - round((time.time() - clicked_s) * 1e9)
        seen.until("document.getElementById('stopnote').textContent.startsWith('Stopped until released')")
        seen.until("document.getElementById('badge').textContent === 'fault'")
        assert running.truth.stood_after(pressed_ns) < 0.5
        # The drive is over: it can be looked at, and its pairs are there.
        seen.to(4.0)
        seen.until("document.getElementById('signs').checkVisibility()")
        assert "fault" in seen.page.text_content("#events")
        assert "turn" in seen.page.text_content("#phases")
        seen.page.click("#release")
        seen.until("document.getElementById('release').hidden")
        assert seen.complaints == []
        assert seen.foreign_requests(address) == []
        seen.page.close()

        phone = Watched(browser, address, 400, 850)
        phone.until("document.getElementById('events').textContent.includes('fault')")
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= 400
        phone.photograph("watch_400")
        process.stop()
        phone.until("document.getElementById('badge').textContent === 'no connection'")
        assert phone.page.is_disabled("#stop")
        phone.page.close()


TABS = 20


def test_stop_reaches_the_gate_from_any_of_many_tabs(browser, tmp_path, record_property):
    """A browser has six HTTP connections to a host; every tab gets updates and can stop."""
    with LiveRun(tmp_path) as running, Driver(running.robot) as bridge:
        _, address = watch(running)
        # Tabs of one window share its connections.
        window = browser.new_context(viewport={"width": 400, "height": 850})
        tabs = SimpleNamespace(new_page=lambda viewport: window.new_page())
        pages = [Watched(tabs, address) for _ in range(TABS)]
        for seen in pages:
            seen.until("!document.getElementById('stop').disabled")
        took_s = []
        for seen in (pages[0], pages[TABS // 2], pages[-1]):
            seen.page.bring_to_front()
            for top in ("0", "document.body.scrollHeight", "document.body.scrollHeight / 2"):
                seen.page.evaluate(f"window.scrollTo(0, {top})")
                clicked_s = seen.click("#stop", timeout_s=2.0)
                wait_for(lambda: bridge.gate.held == "stopped", what=f"the gate to stop, {took_s}")
                took_s.append(time.time() - clicked_s)
                seen.until("document.getElementById('stopnote').textContent.startsWith('Stopped until')")
                seen.page.click("#release")
                wait_for(lambda: bridge.gate.held != "stopped")
        record_property("stop_s", took_s)
        print(f"{TABS} tabs, from click to latched gate: at most {1000 * max(took_s):.0f} ms")
        assert all(seen.complaints == [] for seen in pages)
        window.close()


@pytest.mark.parametrize(("width", "height"), [(400, 850), (1280, 900)])
def test_stop_is_on_the_screen_wherever_the_page_is_scrolled(browser, tmp_path, width, height):
    with LiveRun(tmp_path) as running:
        _, address = watch(running)
        seen = Watched(browser, address, width, height)
        port = address.rstrip("/").rpartition(":")[2]
        assert f"ssh -N -L {port}:127.0.0.1:{port} " in seen.page.text_content("header")
        for top in ("0", "document.body.scrollHeight / 2", "document.body.scrollHeight"):
            seen.page.evaluate(f"window.scrollTo(0, {top})")
            box = seen.page.evaluate("document.getElementById('stop').getBoundingClientRect().toJSON()")
            assert 0 <= box["left"] < box["right"] <= width
            assert 0 <= box["top"] < box["bottom"] <= height
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
        seen.page.close()


def test_who_may_only_look_sees_that(browser, tmp_path):
    keys = tmp_path / "keys"
    assert cli.run(["keys", "--out", str(keys)]) == 0
    listen = ["--listen", "tls/127.0.0.1:0", "--zenoh-config", str(keys / "bridge.json5")]
    with LiveRun(tmp_path / "rig", bridge=listen) as rig:
        options = ["--robot", rig.robot, "--port", "0", "--zenoh-config", str(keys / "viewer.json5")]
        with Process("watch", options, tmp_path) as process:
            seen = Watched(browser, process.wait_for_line("watching at "))
            seen.until("document.getElementById('stopnote').textContent.includes('not authorised to stop')")
            assert seen.page.is_disabled("#stop")
            assert seen.complaints == []
            seen.page.close()
