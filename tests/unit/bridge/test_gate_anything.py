"""Any events in any order: the gate's output is finite, within limits, and allowed."""

import math

from hypothesis import example, given, settings
from hypothesis import strategies as st
from kit.gate_bench import SECRET, SLOW

from bridge.base import BaseReport
from bridge.gate.gate import step
from bridge.gate.limits import Fence, Limits
from bridge.gate.state import (
    BaseLost,
    Enable,
    GateState,
    Release,
    ReleaseStop,
    Stop,
    Tick,
    VelocityCommand,
)
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.wire.protocol import CommandTag

ROUNDING_S = 1e-9
"""At exactly a time-out, sums of floating-point times may lie on either side of it."""

speeds = st.floats(-0.7, 0.7) | st.sampled_from([0.0, -0.0, 0.3, -0.3, 1e308, math.nan, math.inf, -math.inf])
velocities = st.builds(Velocity, speeds, speeds) | st.none()
signatures = st.sampled_from([True, True, True, False])
sequences = st.integers(0, 40) | st.integers(0, 2**64 - 1)
stamp_errors = st.sampled_from([0, 0, 0, 10_000_000, -10_000_000, 10**9, -(10**9), 2**62, -(2**62)])
numbers = st.floats(-5, 5) | st.sampled_from([0.0, math.nan, math.inf, 1e308])
reports = st.builds(
    BaseReport,
    x=numbers,
    y=numbers,
    theta=numbers,
    v=numbers,
    omega=numbers,
    battery_v=st.sampled_from([0.0, 12.0, 12.0, 10.0, math.nan]),
    motors_on=st.sampled_from([True, True, True, False]),
    stop_pressed=st.sampled_from([False] * 9 + [True]),
    stalled=st.sampled_from([(False, False)] * 9 + [(True, False)]),
    bumpers=st.sampled_from([(0, 0)] * 9 + [(0, 4), (1, 0), (1, 4)]),
    clear_ahead_m=st.sampled_from([5.0, 5.0, 0.5, 0.4, math.nan]),
    clear_behind_m=st.sampled_from([5.0, 0.4, math.nan]),
)
CLEAR = BaseReport(clear_ahead_m=1.0, clear_behind_m=1.0)
good = st.just(("good", None))
happenings = st.lists(
    st.tuples(
        st.sampled_from([*[0.02, 0.05, 0.1] * 5, 0.0, 0.3, 1.1, 61.0, -1.0]),
        st.one_of(
            *[good] * 8,
            st.just(("start", None)),
            st.tuples(st.just("report"), reports),
            st.tuples(st.just("event"), st.sampled_from([Tick(), BaseLost(), Stop("x"), ReleaseStop()])),
            st.tuples(st.just("enable"), st.tuples(st.none() | sequences, stamp_errors)),
            st.tuples(st.just("release"), sequences),
            st.tuples(
                st.just("tagged"),
                st.tuples(velocities, signatures, sequences, stamp_errors),
            ),
        ),
    ),
    min_size=5,
    max_size=40,
)
all_limits = st.builds(
    Limits,
    v_max=st.sampled_from([0.3, 0.01, 1.2]),
    omega_max=st.sampled_from([0.6, 0.01, 3.0]),
    accel=st.sampled_from([1.0, 0.01, 5.0]),
    alpha=st.sampled_from([4.0, 0.01]),
    fence=st.none() | st.just(Fence(x_min=-1.0, x_max=1.0, y_min=-1.0, y_max=1.0)),
    sonar_stop_m=st.none() | st.just(0.5),
)


def events_of(kind, what, now, sequence):
    """The events that a happening stands for: "start" is all it takes to begin, "good" to go on."""
    stamp = round(now * 1e9)
    match kind:
        case "good":
            yield CLEAR
            yield VelocityCommand(SLOW, CommandTag(1, sequence, stamp), signed=True)
        case "start":
            yield ReleaseStop()
            yield CLEAR
            yield Enable("x", stamp, SECRET)
        case "enable":
            yield Enable("x", stamp + what[1], SECRET, what[0])
        case "release":
            yield Release(what)
        case "tagged":
            velocity, signed, number, error = what
            yield VelocityCommand(velocity, CommandTag(1, number, stamp + error), signed=signed)
        case _:
            yield what


def forged(event, state):
    """Whether an event is of a driver that does not have the key of the lease that is held."""
    if state.lease is None:
        return False
    command = isinstance(event, VelocityCommand) and not event.signed
    return command or (isinstance(event, Enable) and event.sequence is None)


@settings(max_examples=3 * settings().max_examples)
@given(happenings=happenings, limits=all_limits)
@example(
    [(0.02, ("good", None))] * 3 + [(61.0, ("start", None)), *[(w, ("good", None)) for w in (0.02, 0.3)]],
    Limits(),
)
def test_output_is_always_finite_within_limits_and_allowed(happenings, limits):
    """Run the gate on the happenings and check each verdict.

    The rover moves only at finite speeds within the limits, on fresh reports and commands, under a lease, and
    without a hazard; with contact it moves slowly and straight.
    """
    state, now, last_s, out = GateState(), 100.0, 100.0, STANDSTILL
    report, reported_s, commanded_s, commands = None, -math.inf, -math.inf, 0
    prelude = [(0.0, ("report", CLEAR)), (0.0, ("enable", (None, 0)))]
    for sequence, (wait, (kind, what)) in enumerate(prelude + happenings):
        now += wait
        for event in events_of(kind, what, now, sequence):
            idle, _ = step(state, Tick(), now, limits)
            strange = forged(event, idle)
            state, verdict = step(state, event, now, limits)
            if strange:
                assert state._replace(dropped={}) == idle._replace(dropped={})
            latest_s = max(now, last_s)
            if isinstance(event, BaseReport):
                report, reported_s = event, latest_s
            elif isinstance(event, VelocityCommand):
                commands += 1
                commanded_s = commanded_s if verdict.dropped else latest_s
            v, omega = verdict.velocity
            assert abs(v) <= limits.v_max
            assert abs(omega) <= limits.omega_max
            elapsed = min(latest_s - last_s, 0.1)
            for new, old, rate in ((v, out.v, limits.accel), (omega, out.omega, limits.alpha)):
                assert abs(new) <= (abs(old) if new * old > 0 else 0.0) + rate * elapsed + 1e-12
            if verdict.velocity != STANDSTILL:
                assert latest_s - reported_s <= limits.odometry_s + ROUNDING_S
                assert latest_s - commanded_s <= limits.command_timeout_s + ROUNDING_S
                assert verdict.lease
                assert verdict.motors
                assert report.motors_on
                assert not report.stop_pressed
                assert not any((*report.bumpers, *report.stalled)) or (abs(v) <= 0.1 and omega == 0.0)
            last_s, out = latest_s, verdict.velocity
    assert state.accepted + sum(state.dropped.values()) == commands
