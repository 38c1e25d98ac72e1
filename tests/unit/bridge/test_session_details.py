"""A session with a base: rates of its line, exact waits, broken packets, what a new connection forgets."""

import pytest
from kit.arcos_bench import CONFIG, ECHO0, ECHO1, FAST_CONFIG, NAMES, RESET, Bench, frame, sip

from bridge.base import BaseReport, Failed
from bridge.pioneer.framing import HOSTBAUD_RATES, Command, encode_frame
from bridge.pioneer.packets import ConfigPac, Kind
from bridge.pioneer.session import BaudChanged
from bridge.pioneer.states import PATIENCE_S, SessionState


def silent(bench):
    """Let a base say nothing until the session gives up; return the rates and the number of handshakes."""
    commands = []
    while not any(isinstance(event, Failed) for event in bench.events):
        bench.wait(0.05)
        commands += bench.commands()
    assert commands[:3] == [Command.PULSE, Command.PULSE, Command.CLOSE]
    rates = [event.baudrate for event in bench.events if isinstance(event, BaudChanged)]
    handshakes = commands.count(Command.PULSE)
    assert bench.events[-1].reason == f"no answer to {handshakes} handshakes"
    return rates, handshakes


@pytest.mark.parametrize(
    ("baudrate", "rates", "handshakes"),
    [(None, [], 6), (9600, [38400, 9600, 38400, 9600, 38400], 8), (38400, [], 7)],
)
def test_silent_line_is_tried_at_its_own_and_at_the_fast_rate(baudrate, rates, handshakes):
    assert silent(Bench(baudrate=baudrate).connect()) == (rates, handshakes)


@pytest.mark.parametrize(("baudrate", "rates", "handshakes"), [(None, [], 3), (9600, [38400, 9600], 5)])
def test_line_to_a_base_that_was_ready_is_given_up_sooner(bench, baudrate, rates, handshakes):
    bench.session.link_down("unplugged", bench.now)
    bench.baudrate = baudrate
    assert silent(bench.connect()) == (rates, handshakes)


@pytest.mark.parametrize(
    ("baudrate", "config", "asked"),
    [
        (9600, FAST_CONFIG, True),
        (9600, CONFIG, False),
        (38400, FAST_CONFIG, False),
        (None, FAST_CONFIG, False),
    ],
)
def test_slow_line_becomes_faster_if_the_base_can_switch(baudrate, config, asked):
    bench = Bench(baudrate=baudrate).go_to(SessionState.CONFIGURING)
    bench.hear(config + sip())
    assert bench.session.state is (SessionState.ASKING_FASTER if asked else SessionState.READY)
    assert ((Command.HOSTBAUD, HOSTBAUD_RATES.index(38400)) in bench.sent()) is asked


@pytest.mark.parametrize("state", [SessionState.ASKING_FASTER, SessionState.FASTER])
def test_change_of_rate_drops_half_a_packet(state):
    bench = Bench().go_to(state)
    bench.now += PATIENCE_S[state] - 0.01
    bench.hear(b"\xfa\xfb\xc8")  # it announces 200 bytes
    bench.wait(0.02)
    assert isinstance(bench.events[0], BaudChanged)
    bench.hear(sip())
    assert bench.session.state is SessionState.READY
    reports = [event for event in bench.events if isinstance(event, BaseReport)]
    assert len(reports) == (0 if state is SessionState.ASKING_FASTER else 1)


@pytest.mark.parametrize(
    "end",
    [
        lambda bench: bench.hear(RESET),
        lambda bench: bench.session.link_down("unplugged", bench.now),
        lambda bench: (bench.session.close(bench.now), bench.connect()),
    ],
    ids=["reset", "line is gone", "next session"],
)
def test_bytes_for_a_session_that_ended_are_dropped(bench, end):
    bench.session.enable(True)
    end(bench)
    assert bench.sent() == []


def test_closing_switches_the_motors_off(bench):
    bench.session.close(bench.now)
    zeros = [(Command.VEL, 0), (Command.RVEL, 0), (Command.STOP, None)]
    assert bench.sent() == [*zeros, (Command.ENABLE, 0), (Command.CLOSE, None)]


# Waits for the configuration and the first report; times are exact sums of powers of two.


def test_base_without_reports_is_opened_again_for_exactly_two_seconds(opened):
    opened.hear(CONFIG)
    opened.wait(2.0)
    assert opened.session.state is SessionState.CONFIGURING
    assert opened.commands() == [Command.OPEN]  # it has sent its configuration
    opened.wait(0.25)
    assert opened.session.state is SessionState.LISTENING


def test_base_without_configuration_is_ready_after_exactly_one_second(opened):
    opened.hear(sip())
    opened.wait(1.0)
    assert opened.session.state is SessionState.CONFIGURING
    assert opened.commands() == [Command.CONFIG]
    opened.wait(0.25)
    assert opened.session.state is SessionState.READY
    opened.turns(2, sip(), 0.25)
    assert opened.turns(1, sip(), 0.25) == [(Command.CONFIG, None)]  # a second after the last time


@pytest.mark.parametrize(
    ("state", "report"),
    [(SessionState.CONFIGURING, sip()), (SessionState.READY, RESET + ECHO0 + ECHO1 + NAMES + sip())],
    ids=["first", "after a restart"],
)
def test_base_is_ready_when_its_configuration_follows_its_report(state, report):
    bench = Bench().go_to(state)
    bench.hear(report)
    assert bench.session.state is SessionState.CONFIGURING
    bench.hear(CONFIG)
    assert bench.session.state is SessionState.READY


def test_packets_that_a_session_does_not_use_are_no_answer():
    bench = Bench().connect()
    while bench.session.state is not SessionState.IDLE:
        bench.wait(0.05)
        bench.hear(encode_frame(0x77))
    assert bench.now - 100.0 < 7.0


def test_new_line_does_not_complete_half_a_packet_of_the_last_one(bench):
    bench.hear(sip()[:10])
    bench.session.link_down("unplugged", bench.now)
    bench.connect().hear(ECHO0)
    assert bench.session.state is SessionState.SYNC1


@pytest.mark.parametrize(
    "state", [state for state in SessionState if state not in {SessionState.READY, SessionState.LOST}]
)
def test_only_a_ready_base_gets_requests(state):
    bench = Bench().go_to(state)
    bench.session.enable(True)
    bench.session.emergency_stop()
    assert bench.sent() == []


def test_report_counts_from_its_arrival(bench):
    bench.now += 0.4
    bench.hear(sip())
    bench.wait(0.4)
    assert bench.session.state is SessionState.READY


def test_report_that_ends_too_early_is_no_report(opened):
    opened.hear(CONFIG + encode_frame(Kind.SIP_STOPPED, b"x"))
    assert opened.session.state is SessionState.CONFIGURING
    opened.hear(sip())
    assert opened.session.state is SessionState.READY


def test_gyro_is_asked_for_once(bench):
    bench.hear(frame(ConfigPac(has_gyro=1).encode()))
    assert bench.commands() == []


def test_silence_counts_anew_after_an_answer():
    bench, handshakes = Bench().go_to(SessionState.SYNC1), 1
    while not any(isinstance(event, Failed) for event in bench.events):
        bench.wait(0.05)
        handshakes += bench.commands().count(Command.PULSE)
    assert handshakes == 6
