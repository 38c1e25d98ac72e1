"""The pages in a real browser; `make test-browser` installs what this needs, `make test` leaves it out."""

import time
from base64 import b64decode

import cv2
import numpy as np
import pytest
from kit.browser import Watched, chromium
from kit.paths import DATA
from kit.recorded_drives import BEGAN_NS, TICK_NS, picture, state, write_drive
from kit.true_motion import speed, stood_after

from deploy.view.page import drive_page
from deploy.view.recorded_drive import read_drive
from rover_ncp.course.course import load_course
from rover_ncp.wire.protocol import DriverStatus
from sim.park.live import LiveRun, Process

pytestmark = pytest.mark.browser

EVIL = "<img src=x onerror=\"document.title='hacked'\"></script><script>document.title='hacked'</script>"


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.mark.parametrize("size", [(1280, 900), (400, 850)], ids=["desk", "phone"])
def test_report_is_a_page_whose_slider_moves_the_rover_and_its_neurons(browser, tmp_path, size):
    status = DriverStatus(state="fault", reason=EVIL, tick=320)
    write_drive(tmp_path / "run.mcap", more=[state(status, BEGAN_NS + 400 * TICK_NS)])
    page = tmp_path / "run.html"
    page.write_text(drive_page(read_drive(tmp_path / "run.mcap")))
    seen = Watched(browser, page.as_uri(), *size)
    seen.to(0.0)
    before, avb = seen.outline(), seen.neuron("AVB")
    seen.to(8.0)
    after = seen.outline()
    assert abs(after[0] - before[0]) + abs(after[1] - before[1]) > 0.2
    assert all(old != new for old, new in zip(avb, seen.neuron("AVB"), strict=True))
    assert "turn" in seen.page.text_content("#phases li.current")
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert EVIL in seen.page.text_content("#events")  # words of a peer stay words
    assert "hacked" not in seen.page.title()
    seen.photograph(f"report_{size[0]}")
    assert seen.complaints == []
    assert seen.foreign_requests(page.as_uri()) == []
    seen.page.close()


def test_report_shows_the_localisers_picture_of_the_moment_beside_the_path(browser, tmp_path):
    looks = {t: cv2.imencode(".jpg", np.full((480, 640), 40 * t, np.uint8))[1].tobytes() for t in (0, 3, 6)}
    taken = [picture(BEGAN_NS + 10 * t * TICK_NS, jpeg) for t, jpeg in looks.items()]
    write_drive(tmp_path / "run.mcap", more=taken)
    page = tmp_path / "run.html"
    page.write_text(drive_page(read_drive(tmp_path / "run.mcap")))
    seen = Watched(browser, page.as_uri(), 1280, 900)
    for moment, t, since in ((0.5, 0, False), (4.0, 3, False), (9.0, 6, True), (3.0, 3, False)):
        seen.to(moment)
        source = seen.page.get_attribute("#tag-view", "src")
        assert b64decode(source.removeprefix("data:image/jpeg;base64,")) == looks[t]
        assert seen.page.evaluate("document.getElementById('tag-view').naturalWidth") == 640
        assert ("none since" in seen.page.text_content("#tag-now")) == since
    path, view = (seen.page.locator(part).bounding_box() for part in ("#path", "#tags"))
    assert view["y"] == path["y"]
    assert view["x"] > path["x"] + path["width"]
    seen.photograph("report_pictures")
    assert seen.complaints == []
    assert seen.foreign_requests(page.as_uri()) == []
    seen.page.close()


def test_page_follows_a_drive_of_another_course_that_is_longer_than_its_own(browser, tmp_path):
    with LiveRun(tmp_path) as running:
        options = ["--robot", running.robot, "--port", "0", "--course", str(DATA / "short_course.yaml")]
        watch = running.start_process(lambda: Process("watch", options, running.folder))
        seen = Watched(browser, watch.wait_for_line("watching at "))
        plot = "document.getElementById('path-plot').data"
        assert seen.page.evaluate(f"{plot}[0].x.length") > 0
        end_s = load_course(DATA / "short_course.yaml").horizon_s
        running.deploy()
        seen.until(f"Number(document.getElementById('time').value) > {end_s + 2.0}")
        before = seen.outline()
        seen.until(f"Number(document.getElementById('time').value) > {end_s + 4.0}")
        assert seen.outline() != before
        assert seen.page.evaluate(f"{plot}[0].x.length") == 0
        assert "checkpoint" not in seen.page.text_content("#path-now")
        seen.photograph("watch_elsewhere")
        assert seen.complaints == []
        seen.page.close()


def test_a_running_rover_is_seen_and_stopped(browser, tmp_path):
    with LiveRun(tmp_path) as running:
        options = ["--robot", running.robot, "--port", "0"]
        watch = running.start_process(lambda: Process("watch", options, running.folder))
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
        # The plots follow, too.
        seen.until("Math.max(...document.getElementById('commands').data.flatMap(trace => trace.x)) > 4.5")
        seen.photograph("watch_1280")
        assert speed(running.truth) > 0.03

        clicked_s = seen.click("#stop")
        pressed_ns = time.monotonic_ns() - round((time.time() - clicked_s) * 1e9)
        seen.until("document.getElementById('stopnote').textContent.startsWith('Stopped until released')")
        seen.until("document.getElementById('badge').textContent === 'fault'")
        assert stood_after(running.truth, pressed_ns) < 0.5
        # The drive is over: it can be looked at.
        seen.to(4.0)
        assert "fault" in seen.page.text_content("#events")
        seen.page.click("#release")
        seen.until("document.getElementById('release').hidden")
        assert seen.complaints == []
        assert seen.foreign_requests(address) == []
        seen.page.close()
