"""The demo in a real browser; `make test-browser` installs what this needs."""

import numpy as np
import pytest
from demo.build import demo_page
from kit.browser import Watched, chromium

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.course.course import load_course
from sim.explain.what_if import without_neuron
from sim.learn.rollout import rollout
from sim.world.described import default_rover

pytestmark = pytest.mark.browser

MAX_BYTES = 400_000
TICKS = """observations => observations.map(values => {
  const {core} = demo, command = core.tick(values);
  return [...core.potentials, ...command];
})"""
CENTER = """() => {
  const {x, y, width, height} = document.querySelector('#rover polygon').getBoundingClientRect();
  const {a} = document.getElementById('ground').getScreenCTM();
  return [x + width / 2, y + height / 2, a];
}"""
DOT = """() => {
  const {e, f} = document.getElementById('now').transform.baseVal.consolidate().matrix;
  return [e, f];
}"""
REDRAWN = """() => {
  window.redrawn = 0;
  new MutationObserver(() => window.redrawn += 1).observe(
    document.getElementById('rover'), {attributes: true, attributeFilter: ['transform']});
}"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    for name in ("course", "parking"):
        (folder / f"{name}.html").write_text(demo_page(name))
    return folder


@pytest.fixture
def seen(browser, pages, request):
    page = pages / "course.html"
    watched = Watched(browser, page.as_uri(), *getattr(request, "param", (1300, 900)))
    watched.until("!!window.demo")
    yield watched
    assert watched.complaints == []
    assert watched.foreign_requests(page.as_uri()) == []
    watched.page.close()


def pose(seen):
    return np.array(seen.page.evaluate("(({x, y, theta}) => [x, y, theta])(demo.drive.pose)"))


def drive_until(seen, time_s):
    """Drive at the page's own pace, then pause."""
    seen.page.click("#park")
    seen.until(f"demo.drive.time > {time_s}")
    seen.page.click("#park")
    assert seen.page.text_content("#badge") == "paused"


def verdict(seen):
    seen.page.click("#end")
    return seen.page.text_content("#badge")


@pytest.mark.parametrize("name", ["course", "parking"])
def test_circuit_gives_the_bits_of_the_core(browser, pages, name):
    policy = load_policy(name)
    observations = np.random.default_rng(7).uniform(-0.5, 1.0, (100, len(policy.sensing.inputs)))
    runner, expected = Runner(policy), []
    for observation in observations:
        command = runner.tick(observation)
        expected.append([*runner.potentials, *command])
    watched = Watched(browser, (pages / f"{name}.html").as_uri())
    watched.until("!!window.demo")
    assert watched.page.evaluate(TICKS, observations.tolist()) == expected
    watched.page.close()


def test_page_is_small(pages):
    assert (pages / "course.html").stat().st_size <= MAX_BYTES


def test_rover_drives_as_in_the_simulator_with_and_without_a_neuron(seen):
    policy, rover = load_policy("course"), default_rover(delay_v_s=0.15, delay_omega_s=0.15)
    for driver in (policy, without_neuron(policy, "AVB")):
        expected = rollout(driver, load_course("longer"), rover)
        assert verdict(seen) == expected.verdict.words
        driven = seen.page.evaluate("demo.drive.poses.map(({x, y, theta}) => [x, y, theta])")
        assert np.abs(np.array(driven) - expected.poses).max() < 0.002
        seen.page.click("[data-neuron=AVB]")


@pytest.mark.parametrize("seen", [(1300, 900), (400, 850)], ids=["desk", "phone"], indirect=True)
def test_rover_parks_recovers_from_a_push_and_needs_its_neuron(seen):
    width = seen.page.viewport_size["width"]
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
    assert verdict(seen) == "parked"
    seen.photograph(f"demo_parked_{width}")
    seen.page.select_option("#speed", "4")
    drive_until(seen, 8.0)
    before = pose(seen)
    assert np.hypot(*before[:2] - seen.page.evaluate(DOT)) < 0.05
    x, y, scale = seen.page.evaluate(CENTER)
    seen.page.mouse.move(x, y)
    seen.page.mouse.down()
    seen.page.mouse.move(x, y - 0.2 * scale, steps=4)
    seen.page.mouse.up()
    assert np.abs(pose(seen) - before - [0.0, 0.2, 0.0]).max() < 0.02
    seen.photograph(f"demo_pushed_{width}")
    assert verdict(seen) == "parked"
    seen.page.click("[data-neuron=AVB]")
    assert "AVB" in seen.page.text_content("#silenced")
    assert verdict(seen) == "not parked"
    seen.photograph(f"demo_silenced_{width}")
    seen.page.click("#wake")
    assert verdict(seen) == "parked"


def test_every_course_is_driven_and_a_touched_car_is_named(seen):
    for course in ("longer", "bay", "parking", "mirrored", "turn"):
        seen.page.select_option("#course", course)
        assert verdict(seen) == "parked"
    seen.page.select_option("#course", "bay")
    seen.page.click("[data-neuron=AVB]")
    assert verdict(seen) == "not parked"
    assert "touched a car" in seen.page.text_content("#headline")


def test_sliders_change_the_robot(seen):
    before = pose(seen)
    for name, value in (("delay", 0.3), ("gain", 80), ("slip", 20), ("noise", 10)):
        seen.page.locator(f"#{name}").fill(str(value))
        shown = seen.page.text_content(f"#{name}-value")
        assert verdict(seen) == "parked", name
        assert np.abs(pose(seen) - before).max() > 1e-4, name
        assert str(value) in shown
        before = pose(seen)
    seen.page.locator("#gain").fill("40")
    assert verdict(seen) == "not parked"
    seen.page.click("#defaults")
    assert verdict(seen) == "parked"


def test_keyboard_parks_pushes_and_silences(seen):
    keyboard = seen.page.keyboard
    seen.page.focus("#rover")
    for _ in range(4):
        keyboard.press("ArrowUp")
    assert np.allclose(pose(seen), [0.0, 0.2, 0.0])
    keyboard.press("Tab")
    keyboard.press("Space")
    seen.until("demo.drive.time > 0.2")
    assert seen.page.text_content("#badge") == "driving"
    keyboard.press("Space")
    seen.page.focus("[data-neuron=AVB]")
    keyboard.press("Enter")
    assert seen.page.get_attribute("[data-neuron=AVB]", "aria-pressed") == "true"
    seen.page.focus("#gain")
    keyboard.press("ArrowLeft")
    assert seen.page.text_content("#gain-value") == "95 %"


def test_reduced_motion_redraws_about_once_a_second(seen):
    seen.page.emulate_media(reduced_motion="reduce")
    seen.page.click("#park")
    seen.until("demo.drive.time > 3.5")
    seen.page.evaluate(REDRAWN)
    seen.page.wait_for_timeout(2500)
    assert 1 <= seen.page.evaluate("window.redrawn") <= 3
