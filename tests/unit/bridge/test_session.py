"""The rules at the top of session.py and setpoints.py, and robots that do not answer as expected."""

import math
import re
from itertools import cycle, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.arcos_bench import BYTES, CONFIG, ECHO0, ECHO1, NAMES, RESET, Bench, frame, sip
from kit.arcos_captures import CAPTURES

from bridge.base import BaseReport, Failed, Lost, Notice, Ready, Recovered, TurnRate
from bridge.pioneer.framing import Command, encode_frame
from bridge.pioneer.packets import ConfigPac, Flag, GyroPac, Kind
from bridge.pioneer.session import BaudChanged, Session
from bridge.pioneer.setpoints import MotionLimits
from bridge.pioneer.states import CONFIG_S, TABLE, Input, SessionState
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description

INVALID = b"\x80\xfe\x00\xfa\xfbz"


@pytest.mark.parametrize(
    ("stream", "period_s", "reason"),
    [
        (INVALID, 0.05, "or the baud rate is wrong: .* bytes, not one valid packet"),
        (sip(), 0.05, "no handshake was completed within 15 s"),
        (encode_frame(0xFF), 0.02, "no handshake was completed within 15 s"),  # always being reset
        (encode_frame(0), 0.5, "no handshake was completed within 15 s"),  # the right bytes, too slowly
    ],
)
def test_base_that_never_completes_the_handshake_is_given_up(stream, period_s, reason):
    bench = Bench().connect()
    pieces = cycle([stream] if period_s == 0.05 else [bytes([byte]) for byte in stream])
    while bench.session.state is not SessionState.IDLE and bench.now < 200:
        bench.wait(period_s)
        bench.hear(next(pieces))
    (failed,) = bench.events
    assert re.search(reason, failed.reason)


def test_a_configpac_that_was_lost_is_asked_for_until_it_comes_and_then_the_bumpers_count(opened):
    asked_s = []
    while opened.now < 110:
        asked = (Command.CONFIG, None) in opened.turns(1, sip(stall_right=0xFE), 0.1)
        if asked and opened.session.state is SessionState.READY:
            asked_s.append(opened.now)
    assert opened.session.state is SessionState.READY
    assert len(asked_s) >= 7
    assert min(after - before for before, after in pairwise(asked_s)) >= CONFIG_S - 0.01
    (notice,) = [event.text for event in opened.events if isinstance(event, Notice)]
    assert "bumpers do not stop the rover" in notice
    opened.events.clear()
    opened.hear(frame(ConfigPac(front_bumps=5, has_gyro=1).encode()) + sip(stall_right=0xFE))
    (state,) = opened.events
    assert state.bumpers == (0b11111, 0)
    assert opened.commands() == [Command.GYRO]
    asked = {command for command, _ in opened.turns(20, sip() + CONFIG, 0.1)}
    assert not {Command.CONFIG, Command.GYRO} & asked


def test_a_configpac_of_the_session_before_says_nothing_about_this_one():
    owed = frame(ConfigPac(has_gyro=1, watchdog=5000).encode())
    bench = Bench().connect()
    for _ in range(3):
        bench.hear(owed)
        assert (bench.session.watchdog_s, bench.session.gyro_silent) == (None, False)
        bench.wait(0.05)


def test_a_base_with_a_gyro_for_its_client_is_asked_to_send_it():
    readings = frame(GyroPac(((502, 30), (500, 30), (501, 30), (501, 30))).encode())
    for has_gyro, asked in ((0, []), (1, [(Command.GYRO, 1)]), (2, [])):
        bench = Bench().go_to(SessionState.CONFIGURING)
        bench.hear(frame(ConfigPac(has_gyro=has_gyro).encode()) + readings + sip())
        assert bench.session.state is SessionState.READY
        assert [sent for sent in bench.sent() if sent[0] is Command.GYRO] == asked
    bench.hear(readings + frame(GyroPac().encode()) + sip())
    # Nothing before it was ready, nothing of no readings.
    (turned,) = (event for event in bench.events if isinstance(event, TurnRate))
    # 11 below rest, to the left: 11 of 0.954 deg/s (ARIA's factors).
    assert turned.rate == pytest.approx(math.radians(11 * 5 / 1023 * 120 * 1.626))


@pytest.mark.parametrize(
    ("model", "ready"), [("p3at-sh", True), ("p3dx-sh", False), ("p3at", False), ("p3dx", False)]
)
def test_a_base_that_calls_itself_another_model_than_the_chosen_one_is_not_driven(model, ready):
    bench = Bench(model).go_to(SessionState.SYNC2)
    bench.hear(NAMES + CONFIG + sip())
    assert (bench.session.state is SessionState.READY) is ready
    if not ready:
        remedy = f"leave out --model {model}, or describe the robot in a file"
        assert bench.events[-1].reason == f"the base calls itself 'P3AT-SH'; {remedy}"


def test_limits_are_sent_in_the_bases_units():
    bench = Bench()
    bench.session = Session(limits=MotionLimits(v=0.25, omega=0.5, accel=0.31, decel=0.4, alpha=1.25))
    bench.go_to(SessionState.CONFIGURING)
    bench.hear(CONFIG + sip())
    assert bench.sent()[:6] == [
        (Command.SETV, 250),
        (Command.SETA, 310),
        (Command.SETA, -400),
        (Command.SETRV, 29),
        (Command.SETRA, 72),
        (Command.SETRA, -72),
    ]


def test_motors_are_off_until_requested_and_setpoints_are_zero_before(bench):
    bench.session.set_motion(Velocity(0.2, 0.1))
    assert all(argument in (0, None) for command, argument in bench.turns(1) if command is not Command.SETV)
    bench.session.enable(True)
    assert bench.sent()[-3:] == [(Command.VEL, 0), (Command.RVEL, 0), (Command.ENABLE, 1)]


def test_speeds_are_sent_only_while_the_base_reports_its_motors_on(bench):
    bench.session.enable(True)
    bench.session.set_motion(Velocity(0.2, 0.1))
    assert (Command.VEL, 200) not in bench.turns(1)
    bench.hear(sip(flags=Flag.MOTORS))
    bench.session.set_motion(Velocity(-0.2, 0.1))
    bench.wait(0.05)
    # The first as ARIA wrote it (aria_drive_vel).
    assert bench.session.data_to_send().hex() == "fafb060b1bc800d31b" + "fafb06153b06001b3b"


@pytest.fixture
def driving():
    bench = Bench().go_to(SessionState.READY)
    bench.session.enable(True)
    bench.hear(sip(flags=Flag.MOTORS))
    bench.session.set_motion(Velocity(0.2, 0.1))
    bench.turns(1)
    bench.events.clear()
    return bench


def test_no_tick_no_keep_alive(driving):
    for _ in range(100):
        driving.now += 0.1
        driving.hear(sip(flags=Flag.MOTORS))
    assert driving.sent() == []


@pytest.mark.parametrize("motors", [False, True])
def test_ticks_keep_the_watchdog_fed(motors, request):
    bench = request.getfixturevalue("driving" if motors else "bench")
    bench.session.set_motion(Velocity(0.1, 0.0))
    sent_s = [bench.now, *(bench.now for _ in range(100) if bench.turns(1, sip(flags=int(motors))))]
    assert max(after - before for before, after in pairwise(sent_s)) <= (0.26 if motors else 0.56)


def test_lost_base_gets_zeros_once_and_then_nothing(driving):
    assert driving.turns(11)[-3:] == [(Command.VEL, 0), (Command.RVEL, 0), (Command.STOP, None)]
    assert [type(event) for event in driving.events] == [Lost]
    driving.session.set_motion(Velocity(0.2, 0.1))
    assert driving.turns(20) == []


def test_line_to_a_base_that_stays_lost_is_given_up(driving):
    """After the base's watchdog of 2 s: bytes that the line still holds for the base would move it again."""
    lost_s = driving.now
    while not driving.events or not isinstance(driving.events[-1], Failed):
        driving.wait(0.05)
    assert 2.0 < driving.now - lost_s < 2.5
    driving.sent()
    driving.hear(sip())
    assert driving.turns(40) == []  # until the next line is open
    assert driving.session.state is SessionState.IDLE


def test_recovered_base_stands_until_the_motors_are_requested(driving):
    driving.wait(0.5)
    driving.sent()
    driving.session.set_motion(Velocity(0.2, 0.1))
    sent = driving.turns(1, sip(flags=Flag.MOTORS))
    assert driving.session.state is SessionState.READY
    assert (Command.ENABLE, 0) in sent
    assert {argument for command, argument in sent if command in (Command.VEL, Command.RVEL)} == {0}


def test_unanswered_enable_is_repeated_but_motors_that_went_off_stay_off(bench):
    bench.session.enable(True)
    bench.sent()
    assert 1 <= bench.turns(8, sip(), 0.1).count((Command.ENABLE, 1)) <= 2
    bench.turns(1, sip(flags=Flag.MOTORS), 0.4)
    assert (Command.ENABLE, 1) not in bench.turns(20, sip(flags=Flag.STOP_BUTTON), 0.1)
    bench.session.enable(True)
    assert (Command.ENABLE, 1) in bench.sent()


def test_motors_that_are_on_without_a_request_are_switched_off():  # as AMRISim's are from the start
    assert (Command.ENABLE, 0) in Bench().go_to(SessionState.READY).turns(1, sip(flags=Flag.MOTORS), 0.35)


def test_emergency_stop_goes_out_at_once(driving):
    driving.session.emergency_stop()
    assert driving.sent() == [(Command.E_STOP, None), (Command.VEL, 0), (Command.RVEL, 0)]
    assert driving.turns(1) == []


CALLS = [
    *(st.just((name,)) for name in ("connect", "close", "emergency_stop")),
    st.tuples(st.just("enable"), st.booleans()),
    st.tuples(st.just("set_motion"), st.builds(Velocity, st.floats(-1, 1), st.floats(-1, 1))),
    st.tuples(st.just("wait"), st.floats(0, 0.6)),
    st.tuples(st.just("hear"), st.sampled_from([*BYTES.values(), sip(flags=1), b"\xfa\xfb\x06"])),
    st.tuples(st.just("hear"), st.binary(max_size=30)),
]


@given(st.booleans(), st.lists(st.one_of(CALLS), max_size=60))
def test_no_speed_is_sent_unless_motors_were_requested_and_run(ready, story):
    """Invariant: speeds other than 0 go only to a ready base whose motors were asked for and reported on."""
    bench = Bench()
    if ready:
        bench.go_to(SessionState.READY)
    asked = on = False
    for name, *arguments in story:
        before = bench.session.state
        values = [bench.now] if name in ("connect", "close") else arguments
        getattr(bench if name in ("wait", "hear") else bench.session, name)(*values)
        if name == "enable" and before is SessionState.READY:
            asked = arguments[0]
        for event in bench.events:
            on = event.motors_on if isinstance(event, BaseReport) else on
            if isinstance(event, Lost | Ready | Recovered):
                asked = on = False
        bench.events.clear()
        for command, argument in bench.sent():
            if command in (Command.VEL, Command.RVEL) and argument:
                assert bench.session.state is SessionState.READY
                assert asked
                assert on


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda c: c.name)
def test_recorded_robots_are_followed(capture):
    """They answer other clients, at those clients' times; the last pose is that of the recording's end."""
    bench = Bench().connect()
    start = bench.now
    for t, data in capture.chunks("r2c"):
        while bench.now < start + t - 0.05:
            bench.wait(0.05)
        bench.now = start + t
        bench.hear(data)
    reports = [event.x for event in bench.events if isinstance(event, BaseReport)]
    assert [type(event) for event in bench.events if not isinstance(event, BaseReport | Notice)] == [Ready]
    ends = {"aria_drive": 0.756, "aria_wrap": 43262 * 0.465e-3, "fault": 0.763, "player": 0.670}
    end = next((x for name, x in ends.items() if capture.name.startswith(name)), 0.0)
    assert reports[-1] == pytest.approx(end)
    assert len(reports) > 25


# What a base must be sent, by what it says


ZEROS = [Command.VEL, Command.RVEL, Command.STOP]


@pytest.mark.parametrize(
    ("state", "what", "sent", "events"),
    [
        (SessionState.SYNC0, Input.ECHO0, [Command.OPEN], []),  # SYNC1
        (SessionState.SYNC1, Input.ECHO1, [Command.CLOSE], []),  # SYNC2
        (SessionState.SYNC2, Input.NAMES, [Command.OPEN, Command.CONFIG], []),
        (SessionState.SYNC2, Input.STRANGER, [Command.CLOSE], [Failed]),
        (SessionState.SYNC1, Input.SIP, [*ZEROS, Command.CLOSE], []),  # a session that is open already
        (SessionState.READY, Input.EXPIRED, ZEROS, [Lost]),
        (SessionState.READY, Input.LINK_DOWN, [], [Lost]),
        (SessionState.ASKING_FASTER, Input.EXPIRED, [Command.PULSE], [BaudChanged]),
    ],
)
def test_base_is_greeted_opened_and_left_in_order(state, what, sent, events):
    bench = Bench().go_to(state)
    bench.apply(what)
    assert bench.commands() == sent
    assert [type(event) for event in bench.events] == events


@pytest.mark.parametrize(
    ("state", "what", "events"),
    [
        (SessionState.LOST, Input.SIP, [Recovered, BaseReport]),
        (SessionState.FASTER, Input.EXPIRED, [BaudChanged, Ready]),
    ],
)
def test_base_that_is_ready_again_gets_zeros_and_its_motors_stay_off(state, what, events):
    bench = Bench().go_to(state)
    bench.apply(what)
    assert [type(event) for event in bench.events] == events
    last = bench.sent()[-3:]
    assert [command for command, _ in last] == [Command.VEL, Command.RVEL, Command.ENABLE]
    assert [argument for _, argument in last] == [0, 0, 0]


def test_every_action_of_the_table_exists():
    actions = {action for row in TABLE.values() for _, action in row.values()} - {None}
    assert {each for each in actions if not isinstance(each, Command)} == set(Session.ACTIONS)


@pytest.mark.parametrize("has_gyro", [0, 1, 2])
def test_a_gyro_that_the_configuration_promises_is_silent_until_its_first_packet(has_gyro):
    bench = Bench().go_to(SessionState.CONFIGURING)
    assert (bench.session.gyro_silent, bench.session.watchdog_s) == (False, None)
    config = frame(ConfigPac(has_gyro=has_gyro, watchdog=1500).encode()) + sip()
    bench.hear(config)
    assert bench.session.gyro_silent is (has_gyro == 1)
    assert bench.session.watchdog_s == 1.5
    bench.hear(frame(GyroPac(((502, 30),)).encode()))
    assert not bench.session.gyro_silent
    bench.hear(RESET + ECHO0 + ECHO1 + NAMES + config)  # restarted, with another gyro or without one
    assert bench.session.gyro_silent is (has_gyro == 1)


def test_a_report_behind_a_false_header_is_read_when_silence_follows(bench):
    bench.hear(b"\xfa\xfb" + sip())
    bench.wait(0.06)
    assert [type(event) for event in bench.events] == [BaseReport]


@pytest.mark.parametrize("kind", [Kind.RESET_FE, Kind.RESET_FF])
def test_reset_notices_of_both_kinds_are_understood(driving, kind):
    driving.hear(encode_frame(kind))
    assert [type(event) for event in driving.events] == [Lost]


def test_a_description_of_ones_own_has_precedence_over_the_reported_model():
    bench = Bench()
    bench.session = Session(load_description("p3at").model_copy(update={"name": "mine"}))
    bench.go_to(SessionState.SYNC2).hear(NAMES + CONFIG + sip())
    assert [event.robot.name for event in bench.events if isinstance(event, Ready)] == ["mine"]
