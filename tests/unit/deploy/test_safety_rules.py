"""Each check of a driver: against a link that answers as a test wants, on virtual time."""

import math
from types import SimpleNamespace

import pytest
from kit.virtual_drive import AHEAD, controlled
from pydantic import ValidationError

from deploy.drive.link import Bumpers
from deploy.drive.safety_monitor import ResponseCheck, SafetyMonitor, Timeouts, revoked
from deploy.drive.signed_lease import DriverLease
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import NoBridge, NoRobot, NotAuthorised, SafetyStop
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.protocol import GateStatus, MotorsReply, Signed
from sim.world.described import default_rover

BEGIN_NS = 10 * NS_PER_S
STILL, FORWARD = Velocity(0.0, 0.0), Velocity(0.1, 0.0)


class Drive:
    """A monitor with its link, its measurements and its clock; the link is well until a test changes it."""

    def __init__(self, timeouts=None):
        self.now_ns, self.sleeps, self.signal = BEGIN_NS, [], False
        self.link = SimpleNamespace(
            robot="tcp/x",
            where=" (namespace y)",
            bridge_alive=True,
            authorised=lambda: True,
            bumpers=Bumpers(),
            bridges=list,
            about_base=lambda: None,
        )
        self.link.gate, self.link.lease = GateStatus(), DriverLease()
        self.newest = self.odometry(STILL)
        self.measurements = SimpleNamespace(
            newest=self.newest,
            odometry=lambda wait_s: None if wait_s else self.newest,
            complaints={},
            doubtful={"odom": 0},
            taken={"imu": 0},
        )
        self.monitor = SafetyMonitor(self.link, self.measurements, lambda: self.signal, timeouts, self)

    def odometry(self, velocity):
        """Return odometry of now."""
        ref, sample = SimpleNamespace(measured_ns=self.now_ns), SimpleNamespace(velocity=velocity)
        return SimpleNamespace(ref=ref, sample=sample)

    def monotonic(self):
        return self.now_ns / NS_PER_S

    def monotonic_ns(self):
        return self.now_ns

    def sleep(self, seconds):
        self.sleeps.append(seconds)
        self.now_ns += round(seconds * NS_PER_S)

    def check(self, seconds=0.0, fresh=True):
        """Check after that time; return the words of the stop, "" without one."""
        self.now_ns += round(seconds * NS_PER_S)
        if fresh:
            self.measurements.newest = self.odometry(STILL)
        try:
            self.monitor.check()
        except SafetyStop as stop:
            return str(stop)
        return ""

    def granted(self, lease=0, **status):
        """Grant lease 7, which the gate may confirm in its status."""
        self.link.lease.grant(MotorsReply(granted=True, lease=7, key="ab" * 32))
        self.monitor.granted()
        self.link.gate = GateStatus(lease=lease, **status)
        return self


WAITS = ["bridge_wait_s", "permission_wait_s", "odometry_wait_s", "lease_wait_s", "odometry_age_s"]


@pytest.mark.parametrize(("name", "value"), [*((name, 0.0) for name in WAITS), ("odometry_age_s", 0.51)])
def test_waits_are_longer_than_zero_and_odometry_no_older_than_the_first_requirement_allows(name, value):
    assert getattr(Timeouts(**{name: 0.5}), name) == 0.5
    with pytest.raises(ValidationError):
        Timeouts(**{name: value})


# Before the start


@pytest.mark.parametrize(
    ("missing", "error", "words", "wait_s"),
    [
        ({"bridge_alive": False}, NoBridge, r"no bridge is announced there \(namespace y\) within 5 s", 5.0),
        ({"authorised": lambda: False}, NotAuthorised, "the bridge at tcp/x does not take commands", 2.0),
        ({}, NoRobot, "the bridge at tcp/x sends no odometry", 5.0),
    ],
)
def test_what_is_missing_before_the_start_is_named_after_its_wait(missing, error, words, wait_s):
    drive = Drive()
    drive.newest = drive.newest if missing else None
    vars(drive.link).update(missing)
    with pytest.raises(error, match=words):
        drive.monitor.wait()
    assert wait_s < drive.monotonic() - BEGIN_NS / NS_PER_S < wait_s + 0.01
    assert max(drive.sleeps) < 0.01


def test_waits_are_those_of_the_drives_settings():
    drive = Drive(Timeouts(odometry_wait_s=1.0))
    drive.newest = None
    with pytest.raises(NoRobot):
        drive.monitor.wait()
    assert 1.0 < drive.monotonic() - BEGIN_NS / NS_PER_S < 1.01


def test_a_missing_bridge_is_looked_for_in_other_namespaces():
    drive = Drive()
    drive.link.bridge_alive, drive.link.bridges = False, lambda: ["", "lab"]
    with pytest.raises(NoBridge, match="announced in: no namespace, lab"):
        drive.monitor.wait()
    drive.link.bridges = list
    with pytest.raises(NoBridge, match=r"within 5 s$"):
        drive.monitor.wait()


@pytest.mark.parametrize(
    ("base", "complaint", "doubtful", "words"),
    [
        (None, "", 0, "does not answer on rover/base"),
        (None, "7 bytes are too few", 0, "cannot be read: 7 bytes are too few"),
        (SimpleNamespace(problem="the line is cut", model=""), "", 3, "reports that the line is cut"),
        (SimpleNamespace(problem="", model="p3at-sh"), "", 3, "stamps of 3 messages do not fit"),
        (SimpleNamespace(problem="", model="p3at-sh"), "", 0, "reports the base p3at-sh"),
        (SimpleNamespace(problem="", model=""), "", 0, "not connected yet"),
    ],
)
def test_odometry_that_cannot_be_used_has_its_nearest_cause(base, complaint, doubtful, words):
    drive = Drive()
    drive.link.about_base = lambda: base
    drive.measurements.complaints = {"odom": complaint} if complaint else {}
    drive.measurements.doubtful = {"odom": doubtful}
    assert words in drive.monitor.why_no_odometry()


@pytest.mark.parametrize("drives", [True, False])
def test_all_is_there_at_once_and_who_drives_nothing_needs_no_permission(drives):
    drive = Drive()
    drive.link.authorised = lambda: drives
    drive.monitor.wait(drives=drives)
    assert drive.sleeps == []


def test_a_condition_that_holds_at_exactly_its_time_limit_holds():
    drive = Drive()
    assert drive.monitor.until(lambda: drive.now_ns >= BEGIN_NS + 2_000_000, 0.002)
    assert not drive.monitor.until(lambda: False, 0.0)


def test_a_signal_ends_waits_and_checks():
    drive = Drive()
    drive.signal, drive.link.bridge_alive = True, False
    with pytest.raises(KeyboardInterrupt):
        drive.monitor.wait()
    with pytest.raises(KeyboardInterrupt):
        drive.monitor.check()
    assert drive.now_ns == BEGIN_NS


# During the drive


def test_a_lost_bridge_stops_the_drive():
    drive = Drive()
    assert drive.check() == ""
    drive.link.bridge_alive = False
    assert drive.check() == "stopped by bridge-lost: the bridge is gone"


def test_odometry_may_have_exactly_its_age():
    drive = Drive()
    assert [drive.check(0.1, fresh=False) for _ in range(4)] == [""] * 4
    assert drive.check(1e-9, fresh=False).startswith("stopped by odometry-age: odometry is 0.40 s old (limit")


@pytest.mark.parametrize(
    ("pauses_s", "fresh", "stalled"),
    [
        ([0.0, 0.02, 0.31, 0.1], False, "; the driver process was stalled for 0.31 s"),
        ([0.0, *[0.02] * 21], False, ""),
        # After a pause it is a race which thread runs first, the one that receives or the one that checks.
        ([0.0, 0.3, 0.35, 0.41], True, "; the driver process was stalled for 0.41 s"),
    ],
)
def test_odometry_that_is_old_because_the_driver_did_not_run_is_named_so(pauses_s, fresh, stalled):
    drive = Drive()
    *before, words = [drive.check(pause_s, fresh) for pause_s in pauses_s]
    assert set(before) == {""}
    assert words.startswith("stopped by odometry-age")
    assert words.endswith(f"(limit 0.4 s){stalled}")


def test_a_pause_counts_until_the_next_odometry_and_from_the_grant():
    drive = Drive().granted(lease=7)
    assert "stalled for 0.41 s" in drive.check(0.41)
    assert drive.check(0.02) == ""
    assert [drive.check(0.1, fresh=False) for _ in range(3)] == [""] * 3
    assert "stalled" not in drive.check(0.101, fresh=False)
    drive = Drive()
    assert drive.check(0.15) == ""
    words = [drive.check(0.15, fresh=False) for _ in range(3)][-1]
    assert words.endswith("(limit 0.4 s)")  # pauses of exactly 0.15 s are no stall


def test_the_gate_must_confirm_the_lease_in_time():
    drive = Drive().granted()
    assert [drive.check(0.25) for _ in range(4)] == [""] * 4
    assert drive.check(1e-9) == "stopped by lease: the gate does not confirm the lease"
    confirmed = Drive().granted(lease=7)
    assert [confirmed.check(0.25) for _ in range(8)] == [""] * 8
    confirmed.link.gate = GateStatus(lease=0, ended="bumper", ended_detail="a bumper is pressed")
    assert confirmed.check() == "stopped by bumper: a bumper is pressed"


def test_without_a_lease_no_gate_status_counts():
    drive = Drive()
    drive.link.gate = GateStatus(lease=3)
    assert [drive.check(0.25) for _ in range(8)] == [""] * 8


def test_commands_that_the_gate_does_not_accept_stop_the_drive():
    drive = Drive().granted(lease=7)
    drive.link.lease.sign(Signed.COMMAND, "cmd_vel", b"", drive.now_ns)
    assert [drive.check(0.2) for _ in range(2)] == [""] * 2
    assert drive.check(0.2).startswith("stopped by not-accepted")


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (GateStatus(ended="stopped", ended_detail="Anna"), "stopped by Anna"),
        (GateStatus(ended="stopped"), "stopped by a client that gave no name"),
        (GateStatus(ended="stall"), "stopped by stall: the gate revoked the lease"),
        (GateStatus(), "stopped by lease: the gate revoked the lease"),
    ],
)
def test_a_revoked_lease_names_who_revoked_it(status, words):
    assert str(revoked(status)) == words


def test_the_first_contact_since_the_grant_is_kept():
    drive = Drive()
    drive.link.bumpers, drive.link.gate = Bumpers(times=(3, 0)), GateStatus(stops={"stall": 1})
    drive.granted(lease=7, stops={"stall": 1}).check()
    assert drive.monitor.contact == ""
    drive.link.bumpers = Bumpers(times=(3, 1))
    drive.check()
    assert drive.monitor.contact == "a bumper is pressed"
    drive.link.gate = GateStatus(lease=7, held="stall")
    drive.check()
    assert drive.monitor.contact == "a bumper is pressed"
    front = Drive().granted(lease=7)
    front.link.bumpers = Bumpers(times=(1, 0))
    front.check()
    assert front.monitor.contact == "a bumper is pressed"
    stalled = Drive().granted(lease=7, held="stall")
    stalled.check()
    assert stalled.monitor.contact == "a motor is stalled"


@pytest.mark.parametrize("command", [Velocity(math.nan, 0.0), Velocity(0.0, -math.inf)])
def test_a_command_that_is_not_finite_stops_the_drive(command):
    drive = Drive()
    drive.monitor.check_command(FORWARD, STILL)
    with pytest.raises(SafetyStop, match="command: the circuit's command is not finite"):
        drive.monitor.check_command(command, STILL)


@pytest.mark.parametrize(
    ("held", "end"),
    [("", "within a second"), ("sonar", r"\(the gate reports sonar: an obstacle is near .*\)")],
)
def test_a_rover_that_does_not_follow_is_stopped_with_the_gates_reason(held, end):
    drive = Drive()
    drive.link.gate = GateStatus(held=held)
    for _ in range(17):
        drive.monitor.check_command(FORWARD, STILL)
    missing = r"by the estimate the rover drove 0.000 m where 0.100 m were commanded .*"
    with pytest.raises(SafetyStop, match=f"^stopped by no-response: {missing}{end}$"):
        drive.monitor.check_command(FORWARD, STILL)


TURN = Velocity(0.0, 0.3)


@pytest.mark.parametrize(
    ("command", "by_odometry", "readings", "rule"),
    [
        (TURN, TURN, 9, "gyro"),
        (TURN, STILL, 9, "no-response"),
        (TURN, TURN, 0, "no-response"),
        (FORWARD, FORWARD, 9, "no-response"),
    ],
)
def test_a_turn_that_only_odometry_shows_is_the_gyros_fault(command, by_odometry, readings, rule):
    drive = Drive()
    drive.measurements.taken["imu"] = readings
    drive.measurements.newest = drive.odometry(by_odometry)
    for _ in range(17):
        drive.monitor.check_command(command, STILL)
    with pytest.raises(SafetyStop, match=f"^stopped by {rule}: "):
        drive.monitor.check_command(command, STILL)


# The response to commands: a second of them, which began 1.7 s and 1.1 s ago


def complaints(commands, motions):
    """Return the ticks with a complaint."""
    check = ResponseCheck()
    pairs = zip(commands, motions, strict=True)
    return [k for k, (command, motion) in enumerate(pairs) if check.tick(command, motion)]


def test_commands_of_the_last_tenth_of_a_second_do_not_count():
    # 9 ticks of 0.06 m/s are enough in a window, 8 are not: zeros of ticks 6 and 12 are both in one.
    commands = [STILL if k in {6, 12} else Velocity(0.06, 0.0) for k in range(19)]
    assert complaints(commands, [STILL] * 19) == [18]


@pytest.mark.parametrize(("axis", "least"), [(0, 0.05), (1, 0.10)])
def test_motion_is_missing_below_a_tenth_of_what_was_commanded(axis, least):
    def along(value):
        return Velocity(*(value if place == axis else 0.0 for place in (0, 1)))

    commands = [along(2 * least)] * 18
    assert complaints(commands, [along(0.19 * least)] * 18) == [17]
    assert complaints(commands, [along(0.21 * least)] * 18) == []
    assert complaints(commands, [along(-0.21 * least)] * 18) == []
    assert complaints([along(1.01 * least)] * 18, [STILL] * 18) == [17]
    assert complaints([along(-1.01 * least)] * 18, [STILL] * 18) == [17]
    assert complaints([along(0.99 * least)] * 18, [STILL] * 18) == []


def test_limits_of_the_response_are_exact():
    eight = [STILL if k in {7, 8} else Velocity(0.0625, 0.0) for k in range(18)]  # 0.5 in each window
    assert complaints(eight, [STILL] * 18) == [17]
    tenth = [STILL if k in {8, 9} else Velocity(0.125, 0.0) for k in range(18)]
    assert complaints([Velocity(1.0, 0.0)] * 18, tenth) == []


def test_words_name_the_missing_turn():
    check = ResponseCheck()
    words = [check.tick(Velocity(0.0, -0.3), Velocity(0.0, 0.01)) for _ in range(18)]
    assert str(words[-1]) == "0.010 rad where 0.300 rad were commanded within a second"


@pytest.mark.parametrize(
    "asked", [Velocity(0.06, 0), Velocity(-0.16, 0), Velocity(0, 0.12), Velocity(0, -0.18)]
)
def test_commands_that_the_rover_does_not_follow_are_noticed_within_two_seconds(asked):
    assert complaints([asked] * 100, [STILL] * 100)[0] == 17
    assert 25 <= complaints([asked] * 100, [asked] * 20 + [STILL] * 80)[0] <= 40


@pytest.mark.parametrize("asked", [Velocity(0.04, 0), Velocity(0, 0.09), STILL])
def test_commands_below_the_resolution_are_not_judged(asked):
    assert complaints([asked] * 100, [STILL] * 100) == []


@pytest.mark.parametrize("seconds", [1, 3])
def test_a_turn_to_and_fro_that_cancels_out_is_not_judged(seconds):
    asked = [Velocity(0.0, 0.18 if (k // (10 * seconds)) % 2 else -0.18) for k in range(100)]
    assert complaints(asked, [STILL] * 6 + asked[1:95]) == []


@pytest.mark.parametrize("lag", [1, 2, 4, 7])
@pytest.mark.parametrize("ticks", [3, 6, 9])
def test_a_burst_of_commands_is_not_judged_when_it_is_long_over(lag, ticks):
    # As a circuit does that turns the last few degrees on the spot and then stands.
    asked = [Velocity(0.0, -0.36) if 20 <= k < 20 + ticks else STILL for k in range(100)]
    assert complaints(asked, [STILL] * lag + asked[:-lag]) == []


@pytest.mark.parametrize(
    "model", [default_rover(), default_rover(accel=0.21, delay_v_s=0.3, delay_omega_s=0.3)]
)
def test_a_rover_that_follows_is_never_stopped(model):
    """A whole manoeuvre, on the base as it is and on a sluggish one (delays 300 ms, acceleration −30 %)."""
    for policy in (load_policy("parking"), AHEAD):
        watch = ResponseCheck()
        for tick in controlled(policy, model=model)[1]:
            assert watch.tick(tick.command, tick.estimate.velocity) is None
