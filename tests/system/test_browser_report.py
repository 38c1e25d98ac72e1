"""The report in a real browser; `make test-browser` installs what this needs, `make test` leaves it out."""

import pytest
from kit.browser import Watched, chromium
from kit.recorded_drives import BEGAN_NS, TICK_NS, write_drive

from deploy.view.page import drive_page
from deploy.view.recorded_drive import read_drive
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire import messages
from rover_ncp.wire.protocol import DriverStatus, dump_json
from sim.explain.explain import explain
from sim.explain.files import page as explanation_page

pytestmark = pytest.mark.browser

SHORT = "tests/data/short_course.yaml"

EVIL = "<img src=x onerror=\"document.title='hacked'\"></script><script>document.title='hacked'</script>"
STROKES = (
    "[...document.querySelectorAll('#circuit path[stroke-width]')].map(p => p.getAttribute('stroke-width'))"
)
FONT_SIZES = """[...document.querySelectorAll('main p, main li, main dd, main td, #caption')]
  .map(e => parseFloat(getComputedStyle(e).fontSize))"""
CUT_TABLES = """[...document.querySelectorAll('.table .scroll')]
  .filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent)"""
LABELS_COVER = """(() => {
  const box = (e) => e.getBoundingClientRect(), plot = box(document.getElementById('path-plot'));
  const texts = [...document.querySelectorAll('#path-plot .annotation-text')];
  const labels = texts.map(e => [e.textContent, box(e)]);
  const cut = labels.filter(([, a]) => a.right > plot.right || a.left < plot.left);
  const over = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const covering = labels.filter(([, a], k) => labels.slice(k + 1).some(([, b]) => over(a, b)));
  return [...cut, ...covering].map(([words]) => words);
})()"""
FOCUSED = "(e => e.dataset.neuron || e.id || e.closest('[id]')?.id)(document.activeElement)"


def written(recording):
    page = recording.with_suffix(".html")
    page.write_text(drive_page(read_drive(recording)))
    return page


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder / "run.mcap")
    return written(folder / "run.mcap")


@pytest.fixture
def opened(browser, drive, request):
    watched = Watched(browser, drive.as_uri(), *getattr(request, "param", ()))
    watched.to(0.0)
    yield watched
    watched.page.close()
    assert watched.complaints == []
    assert watched.foreign_requests(drive.as_uri()) == []


def test_the_slider_moves_the_rover_and_changes_the_neurons(opened):
    before, avb, lft = opened.outline(), opened.neuron("AVB"), opened.neuron("LFT")
    opened.to(8.0)
    after = opened.outline()
    assert abs(after[0] - before[0]) + abs(after[1] - before[1]) > 0.2
    for old, new in ((avb, opened.neuron("AVB")), (lft, opened.neuron("LFT"))):
        assert new[0] != old[0]
        assert new[1] > old[1] + 5
        assert new[2] != old[2]
    widths = opened.page.evaluate(STROKES)
    opened.to(14.0)
    assert widths != opened.page.evaluate(STROKES)


def test_the_words_follow_the_slider(opened):
    opened.to(5.0)
    assert "Left turn" in opened.page.text_content("#caption")
    assert opened.page.locator("#phases li.current").count() == 1
    assert "left turn" in opened.page.get_attribute("#time", "aria-valuetext")
    opened.to(12.0)
    assert "Right turn" in opened.page.text_content("#phases li.current")
    assert "θ" in opened.page.text_content("#path-now")


def test_play_runs_and_pause_holds(opened):
    opened.page.click("#play")
    opened.until("document.getElementById('time').value > 2")
    opened.page.click("#play")
    # The moment of the last frame before the pause is drawn in the next one.
    opened.page.evaluate(
        "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )
    held = opened.clock()
    opened.page.wait_for_timeout(300)
    assert opened.clock() == held
    # How long the drive takes is the shipped policy's affair.
    end = float(opened.page.get_attribute("#time", "max"))
    assert end > 20
    opened.to(round(end - 0.5, 1))
    opened.page.click("#play")
    opened.until("document.getElementById('play').textContent === 'Play'")
    assert opened.clock() == pytest.approx(end, abs=0.051)


def test_everything_can_be_done_with_the_keyboard(opened):
    page = opened.page
    page.focus("#time")
    page.keyboard.press("ArrowRight")
    opened.until("document.getElementById('clock').textContent === '0.1 s'")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    opened.until("document.getElementById('clock').textContent === '0.2 s'")
    page.keyboard.press(" ")
    opened.until("document.getElementById('play').textContent === 'Pause'")
    page.keyboard.press(" ")
    opened.until("document.getElementById('play').textContent === 'Play'")
    reached = set()
    page.focus(".skip")
    for _ in range(90):
        page.keyboard.press("Tab")
        reached.add(page.evaluate(FOCUSED))
    expected = "AVB RGT phases events paint play time speed"
    assert {*expected.split()} <= reached
    page.focus("[data-neuron=AVB]")
    page.keyboard.press("Enter")
    assert page.get_attribute("[data-neuron=AVB]", "aria-pressed") == "true"
    assert "AVB" in page.text_content("#neuron-now")
    assert page.evaluate("document.getElementById('path-plot').data[4].marker.size.length") == 320


def test_a_phase_and_a_click_into_a_plot_go_to_their_moment(opened):
    opened.page.click("#phases li:nth-child(3) button")
    opened.until("document.getElementById('time').value > 8")
    lanes = opened.page.locator("#lanes")
    lanes.click(position={"x": 52 + (lanes.bounding_box()["width"] - 62) / 2, "y": 100})  # half way in time
    opened.until("Math.abs(document.getElementById('time').value - 15.95) < 0.3")


@pytest.mark.parametrize("opened", [(1280, 900), (400, 850)], indirect=True, ids=["desk", "phone"])
def test_the_page_fits_and_is_photographed(opened):
    page = opened.page
    opened.to(7.0)
    width = page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(LABELS_COVER) == []
    sizes = page.evaluate(FONT_SIZES)
    assert min(sizes) >= 12
    drawn = page.evaluate("document.querySelector('#circuit .name').getBoundingClientRect().height")
    assert drawn >= 11
    opened.photograph(f"report_{width}")


def test_a_window_that_gets_narrow_does_not_scroll_sideways(browser, drive):
    watched = Watched(browser, drive.as_uri(), 500)
    widths = """(() => { const e = document.documentElement; return e.scrollWidth <= innerWidth; })()"""
    watched.page.set_viewport_size({"width": 400, "height": 3000})
    assert watched.page.evaluate(widths)
    watched.page.close()


@pytest.mark.parametrize("width", [1280, 800, 400])
def test_an_explanation_is_a_page(browser, tmp_path, width):
    found = explain("parking", SHORT)
    (tmp_path / "why.html").write_text(explanation_page(found))
    watched = Watched(browser, (tmp_path / "why.html").as_uri(), width)
    watched.to(2.0)
    assert watched.page.locator(".table tbody tr").count() == len(found.knock_outs) + 25
    watched.page.focus("[data-neuron=AVB]")
    watched.page.keyboard.press("Enter")
    assert "AVB" in watched.page.text_content("#neuron-now")
    assert watched.page.evaluate("document.documentElement.scrollWidth") <= width
    assert watched.page.evaluate(CUT_TABLES) == []
    watched.page.select_option("#pair-from", "AVA")
    assert watched.page.text_content("#pair-words").startswith("AVA to ")
    watched.page.locator("#signs button").first.click()
    first = watched.page.get_attribute("#signs button >> nth=0", "aria-label")
    assert watched.page.text_content("#pair-words").startswith(first.partition(",")[0])
    watched.photograph(f"explain_{width}")
    assert watched.complaints == []
    assert watched.foreign_requests((tmp_path / "why.html").as_uri()) == []
    watched.page.close()


def test_words_of_a_peer_stay_words(browser, tmp_path):
    ns = BEGAN_NS + 400 * TICK_NS
    status = DriverStatus(state="fault", reason=EVIL, tick=320)
    more = [
        Recorded("rover/status", "std_msgs/msg/String", messages.text(dump_json(status).decode()), ns, ns)
    ]
    write_drive(tmp_path / "run.mcap", more=more)
    watched = Watched(browser, written(tmp_path / "run.mcap").as_uri())
    assert EVIL in watched.page.text_content("#events")
    assert "hacked" not in watched.page.title()
    assert watched.page.locator("#events img").count() == 0
    assert watched.complaints == []
    watched.page.close()
