"""Lease and causes of a stop with either base: on a virtual clock, and one test of real processes."""

import math
import time

import pytest
from kit.bridge_bench import MACHINE_S, PERIOD_S, Driver, Rig, braking_s, wait_for
from kit.virtual_bench import VirtualDriver, VirtualRig

from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
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


@pytest.mark.parametrize("options", [{}, ROS2], ids=["arcos", "ros2"])
def test_real_processes_drive_and_stop(options, tmp_path):
    promised = {row for row in KEYS if row.senders == {Role.BRIDGE} and row.kind is Kind.MESSAGE}
    promised -= {spec("sonar")} if options else {spec("imu")}
    with Rig(tmp_path, **options) as rig, Driver(rig.locator) as driver:
        driver.start(v=0.1)
        before = driver.odom
        sent_ns = driver.drive(0.5, v=0.1)
        assert driver.gate.lease == driver.lease.number
        assert driver.gate.held == ""
        assert driver.out == Velocity(0.1, 0.0)
        moved = driver.odom.pose.x - before.pose.x
        assert moved == pytest.approx((driver.odom.stamp_ns - before.stamp_ns) * 1e-9 * 0.1, rel=0.2)
        assert abs(driver.odom.stamp_ns - time.time_ns()) < 1e9

        assert rig.stood_after(sent_ns) < STOP_S + braking_s(0.1) + MACHINE_S
        wait_for(lambda: driver.gate.lease == 0 and driver.gate.ended == "lease-lapsed")

        wait_for(lambda: {row.name for row in promised} <= set(driver.seen))
        for row in promised:
            assert len(driver.seen[row.name]) <= row.max_bytes
            decode(row.type, driver.seen[row.name])
        tokens = list(driver.session.liveliness().get("rover/alive/*", timeout=2.0))
        assert [str(reply.ok.key_expr) for reply in tokens] == ["rover/alive/bridge"]


@pytest.fixture(params=["p3at-sh", "husky-a200"], ids=["arcos", "ros2"])
def rig(request):
    return VirtualRig(load_description(request.param))


@pytest.fixture
def driver(rig):
    return VirtualDriver(rig)


def test_a_second_driver_is_refused_and_its_commands_do_not_count(rig, driver):
    driver.start()
    other = VirtualDriver(rig)
    reply = other.motors()
    assert (reply.granted, reply.reason) == (False, "another-driver")
    assert reply.detail == "test holds the lease"
    for _ in range(5):
        other.send(v=-0.3)
        driver.drive(0.05)
    driver.drive(0.3)
    assert driver.gate.dropped == {"foreign": 5}
    assert driver.odom.velocity.v > 0.1
    driver.motors(enable=False)
    assert other.motors().granted


def test_a_stop_is_latched_until_it_is_released(rig, driver):
    driver.start()
    assert driver.stop().stopped
    driver.drive(0.5)
    assert rig.stands_after(braking_s(0.15))
    reply = driver.motors()
    assert (reply.granted, reply.reason) == (False, "stopped")
    assert "test" in reply.detail
    assert driver.gate.stop_reason == "test"
    assert not driver.stop(release=True).stopped
    driver.start()


def test_silence_stops_the_rover(rig, driver):
    driver.start().drive(0.3)
    assert rig.rover.velocity.v > 0.1
    assert rig.stands_after(STOP_S + braking_s(0.15) - PERIOD_S)
    assert driver.gate.stops == {"silence": 1}
    # The lease lapses and the motors go off without a request.
    rig.wait_for(lambda: driver.gate.lease == 0 and driver.gate.ended == "lease-lapsed")


def test_commands_that_arrive_late_do_not_drive(rig, driver):
    driver.start().drive(0.1)
    for _ in range(10):
        driver.send(age_s=5.0)
        rig.sleep(PERIOD_S)
    assert rig.stands_after(braking_s(0.15))
    assert driver.gate.dropped == {"stale": 10}


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
    guessed = CommandTag(driver.lease.number, 2**64 - 1, 2**63 - 1, b"o" * 16).pack()
    wrong_tags = [None, b"", b"x" * 39, b"x" * 41, guessed]
    puts = [(data, tag) for data in GARBAGE.values() for tag in wrong_tags]
    other = VirtualDriver(rig)
    for k, (data, tag) in enumerate(puts):
        other.put(data, tag)
        if k % 5 == 0:
            driver.drive(0.05)
    for _ in range(2000):
        other.put(GARBAGE["not finite"])
    driver.drive(0.3)
    assert driver.gate.dropped == {"foreign": len(puts) + 2000}
    assert driver.gate.held == ""
    assert driver.odom.velocity.v > 0.1


def test_garbage_from_the_driver_stops_the_rover(rig, driver):
    for kind, data in GARBAGE.items():
        driver.start()
        reason = "not-finite" if "finite" in kind else "unreadable"
        # The bridge digests no megabytes: the signature of what is too long cannot be valid.
        dropped, held = ("foreign", "silence") if kind == "too long" else (reason, reason)
        before = driver.gate.dropped.get(dropped, 0)
        driver.drive(0.05)
        for _ in range(3):
            driver.put(data, driver.tag(data))
        rig.wait_for(lambda: driver.gate.held == held, STOP_S)  # noqa: B023
        assert driver.gate.dropped[dropped] == before + 3
        assert driver.out == Velocity(0.0, 0.0)
    assert rig.stands_after(braking_s(0.15))


def test_odometry_is_reset_only_without_a_lease(rig, driver):
    driver.start().drive(0.2)
    assert b"a driver holds the lease" in driver.ask("rover/reset_odometry", b"{}")
    driver.motors(enable=False)
    assert rig.stands_after(1.0)
    assert abs(driver.odom.pose.x) > 0.01
    assert driver.ask("rover/reset_odometry", b"{}") == b'{"ok":true,"reason":""}'
    rig.wait_for(lambda: max(map(abs, driver.odom.pose)) < 1e-6)


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
