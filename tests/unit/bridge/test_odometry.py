"""Odometry from a robot's recorded packets, compared with the printed output of third-party clients."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.arcos_captures import ARIA_LINE, CAPTURES, PLAYER_LINE

from bridge.pioneer.framing import Command, Decoder
from bridge.pioneer.odometry import ROBOTS, Odometer
from bridge.pioneer.packets import SIP_KINDS, ConfigPac, Sip
from sim.base.client_commands import MockCommand

SPOKEN = [c for c in CAPTURES if c.said(ARIA_LINE) or c.said(PLAYER_LINE)]


def states_of(capture):
    """Decode the robot's side; odometry begins anew where the counters show a reset by the client."""
    odometer, reset = Odometer(ROBOTS[capture.model]), False
    from_client, from_robot = Decoder(), Decoder()
    both = [(t, "c2r", data) for t, data in capture.chunks("c2r")]
    both += [(t, "r2c", data) for t, data in capture.chunks("r2c")]
    states = []
    for t, direction, data in sorted(both):
        if direction == "c2r":
            kinds = {packet.kind for packet in from_client.feed(data, t)}
            reset |= bool(kinds & {Command.SETO, MockCommand.SIM_RESET})
            continue
        sips = [packet for packet in from_robot.feed(data, t) if packet.kind in SIP_KINDS]
        for sip in map(Sip.decode, sips):
            if reset and (sip.x, sip.y, sip.theta) == (0, 0, 0):
                odometer, reset = Odometer(ROBOTS[capture.model]), False
            states.append(odometer.update(sip, t))
    return states


def agrees(state, line):
    """Compare within the digits that were printed."""
    if "omega" in line:
        names = {"x": "x", "y": "y", "th": "theta", "vel": "v", "omega": "omega"}
        return all(abs(getattr(state, ours) - float(line[name])) <= 0.002 for name, ours in names.items())
    wheel = state.omega * ROBOTS["p3at-sh"].half_track_m
    values_mm = [(state.x, "x"), (state.y, "y"), (state.v, "vel")]
    # ARIA's parameter files have 0.00153 rad for a heading unit of 2π/4096: 0.26 % less.
    heading = math.degrees(state.theta)
    return (
        all(abs(value * 1000 - float(line[name])) <= 0.06 for value, name in values_mm)
        and abs(heading - float(line["th"])) <= 0.06 + 0.0027 * abs(heading)
        and abs(math.degrees(state.omega) - float(line["rot"])) <= 0.06
        and state.flags == int(line["flags"], 16)
        and list(state.stalled) == [bool(int(line["stall"], 16) & bit) for bit in (0x001, 0x100)]
        and abs((state.v - wheel) * 1000 - float(line["l"])) <= 6.0  # AMRISim rounds ROTVEL to whole degrees
    )


@pytest.mark.parametrize("capture", SPOKEN, ids=lambda c: c.name)
def test_every_pose_a_third_party_client_printed_is_decoded_in_order(capture):
    states = iter(states_of(capture))
    lines = capture.said(PLAYER_LINE) or capture.said(ARIA_LINE)
    assert [line for line in lines if not any(agrees(state, line) for state in states)] == []


@pytest.mark.parametrize(
    ("model", "metres"), [("p3at", 0.465), ("p3at-sh", 1.0), ("p3dx", 0.485), ("p3dx-sh", 1.0)]
)
def test_the_distance_factor_is_the_models_own(model, metres):
    odometer = Odometer(ROBOTS[model])
    odometer.update(Sip(x=5), 0.0)
    assert odometer.update(Sip(x=1005), 0.1).x == pytest.approx(metres)


@pytest.fixture
def odometer():
    return Odometer(ROBOTS["p3at-sh"])


@given(
    steps=st.lists(st.tuples(*[st.integers(-4000, 4000)] * 2, st.integers(-2000, 2000)), min_size=1),
    start=st.tuples(st.integers(0, 0x7FFF), st.integers(0, 0x7FFF), st.integers(-2048, 2047)),
)
def test_the_pose_is_the_sum_of_the_steps_wherever_the_counters_started(steps, start):
    odometer = Odometer(ROBOTS["p3at-sh"])
    x, y, theta = start
    unit = math.tau / 4096
    odometer.update(Sip(x=x, y=y, theta=theta), 0.0)
    for dx, dy, dtheta in steps:
        x, y, theta = x + dx, y + dy, theta + dtheta
        wrapped = (theta + 2048) % 4096 - 2048
        state = odometer.update(Sip(x=x % 0x8000, y=y % 0x8000, theta=wrapped), 0.0)
        assert state.theta == pytest.approx((theta - start[2]) * unit)
        # Seen in the frame where the base stood at connect.
        angle = start[2] * unit
        ahead = ((x - start[0]) * math.cos(angle) + (y - start[1]) * math.sin(angle)) / 1000
        assert state.x == pytest.approx(ahead, abs=1e-9)


def test_bumper_bits_count_only_when_the_base_is_known_to_have_bumpers(odometer):
    """A real Pioneer 2 without any sends all of them set (vectors.json, real_P2_SIP)."""
    pressed = Sip(stall_left=0xFE, stall_right=0xFE | 1)
    assert odometer.update(pressed, 0.0).bumpers == (0, 0)
    odometer.config = ConfigPac(front_bumps=5, rear_bumps=3)
    state = odometer.update(pressed, 0.1)
    assert state.bumpers == (0b11111, 0b111)
    assert state.stalled == (False, True)


def test_the_16_bit_battery_field_wins_and_either_stop_bit_means_that_the_button_is_pressed(odometer):
    assert odometer.update(Sip(battery_dv=129), 0.0).battery_v == 12.9
    assert odometer.update(Sip(battery_dv=255, battery_x10=262), 0.0).battery_v == 26.2
    for bit in (5, 6):
        assert odometer.update(Sip(flags=1 << bit), 0.0).stop_pressed


@pytest.mark.parametrize("bits", [15, 16])
def test_wraps_of_both_known_widths_are_followed(bits):
    odometer = Odometer(ROBOTS["p3at"])
    for way in range(0, 3 * (1 << 15), 130):
        state = odometer.update(Sip(x=way % (1 << bits)), 0.0)
    assert state.x == pytest.approx(way * 0.465e-3)


# Clearance before and behind the base: the sonars that count, and how long a range counts


AHEAD, ASIDE, BEHIND = [2, 3, 4, 5], [0, 1, 6, 7, 8, 9, 14, 15], [10, 11, 12, 13]


def everything(range_m=5.0):
    return dict.fromkeys(range(16), range_m)


def clearance(odometer, ranges, now):
    """Return the clearance ahead and behind in a report with these ranges."""
    sonar = tuple((number, round(range_m * 1000)) for number, range_m in ranges.items())
    report = odometer.update(Sip(sonar=sonar), now)
    return report.clear_ahead_m, report.clear_behind_m


@pytest.mark.parametrize("model", ROBOTS)
def test_four_sonars_count_in_each_direction(model):
    for numbers, room in ((AHEAD, (0.3, 5.0)), (BEHIND, (5.0, 0.3)), (ASIDE, (5.0, 5.0))):
        for number in numbers:
            assert clearance(Odometer(ROBOTS[model]), everything() | {number: 0.3}, 10.0) == room


def test_silent_sonar_makes_only_its_own_direction_unknown(odometer):
    clearance(odometer, everything(), 10.0)
    later = {number: 5.0 for number in range(16) if number != AHEAD[1]}
    assert clearance(odometer, later, 11.0) == (5.0, 5.0)
    assert clearance(odometer, later, 11.001) == pytest.approx((math.nan, 5.0), nan_ok=True)
    assert clearance(odometer, {AHEAD[1]: 4.0}, 11.1) == (4.0, 5.0)
