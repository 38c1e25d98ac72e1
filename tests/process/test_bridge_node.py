"""Bridge and mock as real processes, with either base: the lease, and every cause of a stop."""

import math
import time

import pytest
from bridge_bench import MACHINE_S, Driver, Rig, braking_s, wait_for

from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.key_table import KEYS, Kind, Role, spec
from rover_ncp.wire.messages import decode, twist_stamped
from rover_ncp.wire.protocol import CommandTag
from sim.live.live_run import ROS2DDS

STOP_S = 0.5
"""Requirement 1: the rover stands so long after the last command, plus braking."""


ROS2 = {
    "mock": ["--ros2", "--model", "husky-a200"],
    "bridge": ["--model", "husky-a200", "--no-base-watchdog"],
    "base_form": ROS2DDS,
}
"""A Husky brakes harder than a Pioneer, so the Pioneer's bounds hold."""


@pytest.fixture(scope="module", params=[{}, ROS2], ids=["arcos", "ros2"])
def rig(request, tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig"), **request.param) as rig:
        rig.has_no_sonars = bool(request.param)
        yield rig


@pytest.fixture
def driver(rig):
    with Driver(rig.locator) as driver:
        yield driver
        driver.stop()  # brakes harder than giving the motors back would
        rig.stood_after(time.time_ns(), 0.1)
        driver.motors(enable=False)
        driver.stop(release=True)


def test_everything_that_the_table_promises_is_published(rig, driver):
    promised = {row for row in KEYS if row.senders == {Role.BRIDGE} and row.kind is Kind.MESSAGE}
    promised -= {spec("sonar")} if rig.has_no_sonars else {spec("imu")}
    driver.start()
    wait_for(lambda: {row.name for row in promised} <= set(driver.seen))
    for row in promised:
        assert len(driver.seen[row.name]) <= row.max_bytes
        decode(row.type, driver.seen[row.name])
    tokens = list(driver.session.liveliness().get("rover/alive/*", timeout=2.0))
    assert [str(reply.ok.key_expr) for reply in tokens] == ["rover/alive/bridge"]


def test_the_driver_drives_and_odometry_reports_it(rig, driver):
    driver.start(v=0.1)
    before = driver.odom
    driver.drive(0.5, v=0.1)
    assert driver.gate.lease == driver.lease.number
    assert driver.gate.held == ""
    assert driver.out == Velocity(0.1, 0.0)
    moved = driver.odom.pose.x - before.pose.x
    assert moved == pytest.approx((driver.odom.stamp_ns - before.stamp_ns) * 1e-9 * 0.1, rel=0.2)
    assert abs(driver.odom.stamp_ns - time.time_ns()) < 1e9


def test_a_second_driver_is_refused_and_its_commands_do_not_count(rig, driver):
    driver.start()
    with Driver(rig.locator) as other:
        reply = other.motors()
        assert (reply.granted, reply.reason) == (False, "another-driver")
        assert reply.detail == "test holds the lease"
        foreign = driver.gate.dropped.get("foreign", 0)
        for _ in range(5):
            other.send(v=-0.3)
            driver.drive(0.05)
        wait_for(lambda: driver.gate.dropped.get("foreign", 0) == foreign + 5)
        assert driver.odom.velocity.v > 0.1
        driver.motors(enable=False)
        assert other.motors().granted
        other.motors(enable=False)


def test_a_stop_is_latched_until_it_is_released(rig, driver):
    driver.start()
    asked_ns = time.time_ns()
    assert driver.stop().stopped
    driver.drive(0.5)
    assert rig.stood_after(asked_ns) < STOP_S + braking_s(0.15) + MACHINE_S
    reply = driver.motors()
    assert (reply.granted, reply.reason) == (False, "stopped")
    assert "test" in reply.detail
    assert driver.gate.stop_reason == "test"
    assert not driver.stop(release=True).stopped
    driver.start()


def test_silence_stops_the_rover(rig, driver):
    sent_ns = driver.start().drive(0.3)
    stops = driver.gate.stops.get("silence", 0)
    speed = rig.speed_at(sent_ns)
    assert speed > 0.1
    assert rig.stood_after(sent_ns) < STOP_S + braking_s(0.15) + MACHINE_S
    wait_for(lambda: driver.gate.stops.get("silence", 0) > stops)
    # The lease lapses and the motors go off without a request.
    wait_for(lambda: driver.gate.lease == 0 and driver.gate.ended == "lease-lapsed")


def test_commands_that_arrive_late_do_not_drive(rig, driver):
    driver.start()
    sent_ns = driver.drive(0.1)
    stale = driver.gate.dropped.get("stale", 0)
    for _ in range(10):
        driver.send(age_s=5.0)
        time.sleep(0.05)
    assert rig.stood_after(sent_ns) < STOP_S + braking_s(0.15) + MACHINE_S
    wait_for(lambda: driver.gate.dropped.get("stale", 0) == stale + 10)


GARBAGE = {
    "not finite": twist_stamped(Velocity(math.nan, 0.1), 1),
    "infinite": twist_stamped(Velocity(math.inf, -math.inf), 1),
    "truncated": twist_stamped(Velocity(0.2, 0.1), 1)[:-9],
    "too long": b"\0\1\0\0" + b"\0" * 100_000,
    "another type": b"\0\1\0\0" + b"\xff" * 60,
    "empty": b"",
}


def test_garbage_from_others_changes_nothing(rig, driver):
    driver.start()
    foreign = driver.gate.dropped.get("foreign", 0)
    guessed = CommandTag(driver.lease.number, 2**64 - 1, 2**63 - 1, b"o" * 16).pack()
    wrong_tags = [None, b"", b"x" * 39, b"x" * 41, guessed]
    puts = [(data, tag) for data in GARBAGE.values() for tag in wrong_tags]
    with Driver(rig.locator) as other:
        for k, (data, tag) in enumerate(puts):
            other.put(data, tag)
            if k % 5 == 0:
                driver.drive(0.05)
        # Zenoh may drop some of a flood on the way.
        for _ in range(2000):
            other.put(GARBAGE["not finite"])
        driver.drive(0.3)
        wait_for(lambda: driver.gate.dropped.get("foreign", 0) > foreign + len(puts) + 1000)
    # On a busy machine the flood can delay the base's reports, and the rover stands until they are back.
    lease = driver.lease.number
    driver.start()
    assert driver.lease.number == lease


def test_garbage_from_the_driver_stops_the_rover(rig, driver):
    for kind, data in GARBAGE.items():
        driver.start()
        reason = "not-finite" if "finite" in kind else "unreadable"
        # The bridge digests no megabytes: the signature of what is too long cannot be valid.
        dropped, held = ("foreign", "silence") if kind == "too long" else (reason, reason)
        before = driver.gate.dropped.get(dropped, 0)
        sent_ns = driver.drive(0.05)
        for _ in range(3):
            driver.put(data, driver.tag(data))
        # Zenoh may drop some: on a busy machine even those of 100 kB.
        wait_for(lambda: driver.gate.dropped.get(dropped, 0) > before)  # noqa: B023
        wait_for(lambda: driver.gate.held == held)  # noqa: B023
        assert driver.out == Velocity(0.0, 0.0)
    assert rig.stood_after(sent_ns) < STOP_S + braking_s(0.15) + MACHINE_S


def test_odometry_is_reset_only_without_a_lease(rig, driver):
    driver.start().drive(0.2)
    assert b"a driver holds the lease" in driver.ask("rover/reset_odometry", b"{}")
    driver.motors(enable=False)
    rig.stood_after(time.time_ns())
    assert abs(driver.odom.pose.x) > 0.01
    assert driver.ask("rover/reset_odometry", b"{}") == b'{"ok":true,"reason":""}'
    wait_for(lambda: max(map(abs, driver.odom.pose)) < 1e-6)


@pytest.mark.parametrize(
    ("name", "payload", "expected"),
    [
        ("rover/motors", b"", "MotorsRequest"),
        ("rover/motors", b'{"version": 2}', "enable"),
        ("rover/stop", b'{"release": 1e999}', "StopRequest"),
        ("rover/stop", b" " * 100_000, "expected at most 4096"),
        ("rover/reset_odometry", b"[]", "ResetRequest"),
    ],
)
def test_a_request_that_cannot_be_read_is_refused_by_name(rig, driver, name, payload, expected):
    assert expected in driver.ask(name, payload)
