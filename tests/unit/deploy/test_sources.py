"""A second publisher of an input, by ids and by stamps."""

import random

import pytest

from deploy.drive.link import STEPS_BACK, Sources

S = 10**9


def noted(messages, topic="odom"):
    sources = Sources()
    for source, stamp_ns in messages:
        sources.note(topic, source, stamp_ns)
    return sources.second


def test_one_publisher_is_one_also_after_a_restart_with_another_id_or_clock():
    assert noted([("a", k) for k in range(100)]) == {}
    assert noted([("a", k) for k in range(50)] + [("b", k) for k in range(50)]) == {}
    assert noted([("", k) for k in range(50)] + [("", k - S) for k in range(50)]) == {}


@pytest.mark.parametrize("ids", [("a", "b"), ("", "b"), ("a", ""), ("a", "b", "c"), ("a", *"bcdefghij")])
def test_ids_that_come_back_are_two_publishers(ids):
    found = noted([(ids[k % len(ids)], k) for k in range(2 * len(ids))])
    assert found["odom"] == "two publishers send odom"


def test_imu_comes_from_the_bridge_as_odom_does():
    sources = Sources()
    for k in range(5):
        sources.note("odom", "bridge", k)
        sources.note("imu", "bridge", k)
        sources.note("pose", "localiser", k)
    assert sources.second == {}
    for k in range(5, 10):
        sources.note("odom", "another bridge", k)
        sources.note("imu", "another bridge", k)
    assert sources.second == {}
    sources.note("imu", "", 10)
    sources.note("odom", "another bridge", 10)
    assert sources.second == {"odom and imu": "two publishers send odom and imu"}


def test_publishers_without_an_id_are_noticed_by_stamps_that_go_back():
    found = noted([("", k * S - (k % 2) * 5 * S) for k in range(20)], "pose")
    assert found == {"pose": "two publishers send pose, or one sends it out of order"}
    # A bad stamp, and now and then a message that is late.
    assert noted([("", k * S + 9 * S * (k == 7)) for k in range(100)]) == {}
    assert noted([("", k * S - 3 * S * (k % 10 == 0)) for k in range(100)]) == {}


def test_memory_is_bounded():
    sources, draw = Sources(), random.Random(1)
    for k in range(10_000):
        sources.note("pose", str(draw.random()), k)
    assert sources.second == {}
    assert len(sources._seen["pose"]) <= 16
    assert sum(sources._stamps["pose"][1]) < STEPS_BACK
