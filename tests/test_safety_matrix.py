"""The safety matrix: every fault at every layer, with real processes, and the measured time to standstill.

The bounds are the requirement itself: 0.5 s plus braking, and the base's watchdog (2 s) plus braking where
the bridge is dead or hung. What the machine adds has to fit in.
"""

import math
import signal
import time

import pytest
from safety_stack import SPEED, STOP_S, WALL, WATCHDOG_S, Stack, record, wait_for

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.core.messages import odometry, text, twist_stamped

BAD_PAYLOADS = {
    "not a number": twist_stamped(Velocity(math.nan, 0.0), 0),
    "infinite": twist_stamped(Velocity(0.1, -math.inf), 0),
    "truncated": twist_stamped(Velocity(0.2, 0.0), 0)[:-5],
    "oversized": twist_stamped(Velocity(0.2, 0.0), 0) + bytes(500_000),
    "of another type": odometry(Pose(0.2, 0.2, 0.2), Velocity(0.2, 0.2), 0),
    "of no type": text("forward!"),
}


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    with Stack(tmp_path_factory.mktemp("stack"), "freeze-odometry@2-4") as stack:
        yield stack


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A rover whose hardware fails: first under a circuit, then under a steady hand."""
    faults = ["jump-odometry@2-4", "mute@8-8.8", "bumper@10.5-10.8", "stall@13-13.3"]
    faults += ["stop-button@15.5-15.8", "low-battery=10@18-21"]
    with Stack(tmp_path_factory.mktemp("other"), *faults) as stack:
        yield stack


def ended(deploy, code=4):
    done = deploy.wait(15.0)
    assert done.code == code, done
    return done.result


# The base.


def test_odometry_that_freezes_and_odometry_that_jumps(stack, other):
    deploys = [rig.deploy() for rig in (stack, other)]
    faults = ("odometry frozen, SIPs go on", "odometry jumps by 0.5 m")
    for rig, deploy, fault in zip((stack, other), deploys, faults, strict=True):
        assert ended(deploy)["stopped_by"] == "estimator"
        began_ns = rig.first_enabled_ns + 2_000_000_000
        speed = rig.at(began_ns)
        assert speed > 0.05
        record("base", fault, rig.stood(began_ns), speed)


def test_what_the_base_itself_reports(other):
    with other.hand() as hand:
        for fault, reason, begins_s, bound_s in (
            ("mute (no SIPs)", "no-base", 8.0, STOP_S),
            ("bumper", "bumper", 10.5, STOP_S),
            ("stall", "stall", 13.0, STOP_S),
            ("stop button", "stop-button", 15.5, STOP_S),
            ("low battery (2 s below 11 V)", "low-battery", 18.0, 2.0 + STOP_S),
        ):
            other.under_way(hand)
            began_ns = other.first_enabled_ns + round(begins_s * 1e9)
            assert time.time_ns() < began_ns, "the machine is too slow for the schedule of faults"
            time.sleep(max(0.0, (began_ns - time.time_ns()) * 1e-9))
            wait_for(lambda reason=reason: hand.gate.ended == reason)
            record("base", fault, other.stood(began_ns, 8.0), SPEED, bound_s)


def test_a_wall_in_the_way(tmp_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text("sonar_stop_m: 0.6\n")
    # The wall is 1 m ahead; two sonars 0.245 m before the centre look at it, 10 degrees from straight on.
    near_m = 1.0 - 0.245 - 0.6 * math.cos(math.radians(10.0))
    options = {"mock": ["--course", str(WALL)], "bridge": ["--limits", str(limits)]}
    with Stack(tmp_path, **options) as stack, stack.hand() as hand:
        stack.under_way(hand)
        wait_for(lambda: stack.truth.read()[-1].x >= near_m)
        near_ns = next(row.wall_ns for row in stack.truth.read() if row.x >= near_m)
        record("base", "a wall within `sonar_stop_m`", stack.stood(near_ns), stack.at(near_ns))
        assert (hand.gate.held, hand.gate.stops["sonar"]) == ("sonar", 1)
        assert hand.gate.driver == hand.id.hex()
        stack.under_way(hand, -SPEED)  # and back is free


# The driver.


def test_two_deploys_and_one_that_is_killed(stack):
    deploys = [stack.deploy() for _ in range(2)]
    wait_for(lambda: not all(deploy.running for deploy in deploys), 20.0)
    second, first = sorted(deploys, key=lambda deploy: deploy.running)
    assert ended(second, 3)["kind"] == "AnotherDriver"
    stack.driven(first)
    killed_ns = time.time_ns()
    first.send_signal(signal.SIGKILL)
    record("deploy", "killed (SIGKILL)", stack.stood(killed_ns), stack.at(killed_ns))


def test_a_deploy_that_is_stopped_and_goes_on_later(stack):
    deploy = stack.deploy()
    stack.driven(deploy)
    stopped_ns = time.time_ns()
    deploy.send_signal(signal.SIGSTOP)
    record("deploy", "stopped (SIGSTOP)", stack.stood(stopped_ns), stack.at(stopped_ns))
    resumed_ns = time.time_ns()
    deploy.send_signal(signal.SIGCONT)
    assert stack.stood(resumed_ns) == 0.0
    ended(deploy)


def test_a_deploy_that_hangs(stack):
    deploy = stack.deploy()
    stack.driven(deploy)
    hung_ns = time.time_ns()
    deploy.send_signal(signal.SIGUSR1)
    record("deploy", "hung, the interpreter's lock held", stack.stood(hung_ns), stack.at(hung_ns))
    deploy.send_signal(signal.SIGKILL)


def test_a_deploy_whose_link_holds_everything_back(stack):
    deploy = stack.deploy(robot=stack.spoilt)
    stack.driven(deploy)
    held_ns = time.time_ns()
    stack.proxy.hold()
    record("link", "deploy's link held back", stack.stood(held_ns), stack.at(held_ns))
    released_ns = time.time_ns()
    stack.proxy.release()
    ended(deploy)
    assert stack.stood(released_ns) == 0.0


# A steady hand, which never stops by itself: what stops the rover is the gate.


def test_a_link_that_delivers_five_seconds_late(stack):
    # With a lease that long Zenoh itself notices nothing, and every old command does arrive.
    with stack.hand(stack.spoilt, lease_s=30.0) as hand:
        stack.under_way(hand)
        dropped = sum(hand.gate.dropped.values())
        held_ns = time.time_ns()
        stack.proxy.hold()
        hand.greedy = False  # so that all it sends are commands
        record("link", "commands 5 s late, all arrive", stack.stood(held_ns), SPEED)
        time.sleep(max(0.0, held_ns * 1e-9 + 5.0 - time.time()))
        hand.silent = True
        released_ns = time.time_ns()
        stack.proxy.release()
        wait_for(lambda: sum(hand.gate.dropped.values()) - dropped > 70)
        assert stack.stood(released_ns) == 0.0


def test_a_link_that_is_cut(stack):
    with stack.hand(stack.spoilt) as hand:
        stack.under_way(hand)
        cut_ns = time.time_ns()
        stack.proxy.cut()
        record("link", "cut", stack.stood(cut_ns), SPEED)
        stack.proxy.release()
        stack.under_way(hand)  # it comes back by itself


def test_a_link_too_slow_for_its_commands(stack):
    with stack.hand(stack.spoilt) as hand:
        stack.under_way(hand)
        slow_ns = time.time_ns()
        stack.proxy.throttle(1000)
        record("link", "slow: 1 kB/s, commands later and later", stack.stood(slow_ns), SPEED)
        wait_for(lambda: hand.gate.dropped.get("stale", 0) > 0)
        stack.proxy.release()


def test_a_link_that_is_held_back_before_the_first_command(stack):
    with stack.hand(stack.spoilt, lease_s=30.0) as hand:
        hand.silent = True
        wait_for(lambda: hand.driving)
        hand.greedy = False
        stack.proxy.hold()
        held_ns = time.time_ns()
        hand.velocity, hand.silent = Velocity(SPEED, 0.0), False
        time.sleep(0.8)  # the lease is still there when they arrive
        dropped = sum(hand.gate.dropped.values())
        hand.silent = True
        stack.proxy.release()
        wait_for(lambda: sum(hand.gate.dropped.values()) - dropped > 8)
        # Those of the last 0.2 s count: they are fresh, and what they ask for lasts 0.3 s.
        record("link", "held back before the first command", stack.stood(hand.last_sent_ns), SPEED)
        assert all(abs(row.v) < SPEED for row in stack.truth.read() if row.wall_ns > held_ns)


@pytest.mark.parametrize("what", BAD_PAYLOADS)
def test_a_driver_that_sends_nonsense(stack, hand, what):
    stack.under_way(hand)
    nonsense_ns = time.time_ns()
    hand.payload = BAD_PAYLOADS[what]
    record("command", what, stack.stood(nonsense_ns), SPEED)
    hand.payload = None


@pytest.fixture(scope="module")
def hand(stack):
    with stack.hand() as hand:
        yield hand


def test_a_foreign_publisher_and_a_flood(stack, hand):
    with stack.hand() as stranger:
        stranger.greedy = False
        stranger.velocity = Velocity(-0.3, 0.6)
        stack.under_way(hand)
        time.sleep(0.5)
        foreign = [row for row in stack.truth.read() if row.wall_ns > time.time_ns() - 400_000_000]
        assert {row.omega for row in foreign} == {0.0}
        assert all(row.v == pytest.approx(SPEED, abs=0.02) for row in foreign)
        silent_ns = time.time_ns()
        hand.silent = True
        record("command", "a foreign publisher goes on", stack.stood(silent_ns), SPEED)
        hand.silent = False
        stack.under_way(hand)

        payload, sent, began = twist_stamped(Velocity(0.3, 0.0), 0), 0, time.monotonic()
        silent_ns = time.time_ns()
        hand.silent = True
        while (elapsed := time.monotonic() - began) < 1.5:
            if sent < elapsed * 10_000:
                stranger.send(payload)
                sent += 1
        record(
            "command", f"a flood of {round(sent / 1.5 / 1000)},000 commands/s", stack.stood(silent_ns), SPEED
        )
        hand.silent = False
        stack.under_way(hand)  # the bridge lives


# The bridge.


def test_a_bridge_that_is_stopped_hangs_or_is_killed(stack, hand):
    stack.under_way(hand)
    stopped_ns = time.time_ns()
    stack.bridge.send_signal(signal.SIGSTOP)
    record("bridge", "stopped (SIGSTOP)", stack.stood(stopped_ns), SPEED, WATCHDOG_S)
    resumed_ns = time.time_ns()
    stack.bridge.send_signal(signal.SIGCONT)  # and finds many old commands
    hand.greedy = False
    assert stack.stood(resumed_ns) == 0.0
    hand.greedy = True
    stack.under_way(hand)
    hung_ns = time.time_ns()
    stack.bridge.send_signal(signal.SIGUSR1)
    record("bridge", "hung, the interpreter's lock held", stack.stood(hung_ns), SPEED, WATCHDOG_S)
    stack.under_way(hand)
    killed_ns = time.time_ns()
    stack.bridge.send_signal(signal.SIGKILL)
    record("bridge", "killed (SIGKILL)", stack.stood(killed_ns), SPEED, WATCHDOG_S)
