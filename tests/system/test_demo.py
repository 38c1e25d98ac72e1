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
def seen(browser, pages):
    page = pages / "course.html"
    watched = Watched(browser, page.as_uri(), 1300, 900)
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


def test_rover_drives_as_in_the_simulator_with_and_without_a_neuron(seen):
    policy, rover = load_policy("course"), default_rover(delay_v_s=0.15, delay_omega_s=0.15)
    for driver in (policy, without_neuron(policy, "AVB")):
        expected = rollout(driver, load_course("longer"), rover)
        assert verdict(seen) == expected.verdict.words
        driven = seen.page.evaluate("demo.drive.poses.map(({x, y, theta}) => [x, y, theta])")
        assert np.abs(np.array(driven) - expected.poses).max() < 0.002
        seen.page.click("[data-neuron=AVB]")


def test_rover_parks_recovers_from_a_push_and_needs_its_neuron(seen):
    assert verdict(seen) == "parked"
    seen.photograph("demo_parked")
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
    seen.photograph("demo_pushed")
    assert verdict(seen) == "parked"
    seen.page.click("[data-neuron=AVB]")
    assert "AVB" in seen.page.text_content("#silenced")
    assert verdict(seen) == "not parked"
    seen.photograph("demo_silenced")
    seen.page.click("#wake")
    assert verdict(seen) == "parked"
