"""The dead-man of the keyboard, on virtual time."""

import codecs
import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from deploy.keyboard import (
    HOLD_S,
    KEYS,
    NUDGE,
    OMEGA_RAD_S,
    V_M_S,
    Keyboard,
    KeyReader,
    Press,
)
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.course.course import OMEGA_MAX, V_MAX


def presses(text):
    return KeyReader().keys(text)


def held(key, until_s, delay_s, rate_hz, end_s=5.0):
    """Velocity commanded while a terminal repeats a held key: (time, velocity) each 10 ms."""
    keyboard, times = Keyboard(), [0.0, *np.arange(delay_s, until_s, 1 / rate_hz)]
    asked = []
    for now in np.arange(0.0, end_s, 0.01):
        while times and times[0] <= now:
            keyboard.press(key, now)
            times.pop(0)
        asked.append((now, keyboard.velocity(now)))
    return asked


@pytest.mark.parametrize(("delay_s", "rate_hz"), [(0.25, 30), (0.5, 25), (0.66, 25), (0.4, 12)])
def test_a_held_key_drives_and_keys_up_means_stop(delay_s, rate_hz):
    asked = held("i", 3.0, delay_s, rate_hz)
    assert asked[0][1] == Velocity(NUDGE * V_M_S, 0.0)
    on_the_way = [velocity for now, velocity in asked if delay_s + 2 / rate_hz < now < 2.9]
    assert set(on_the_way) == {Velocity(V_M_S, 0.0)}
    assert all(velocity == STANDSTILL for now, velocity in asked if now > 3.0 + HOLD_S)
    assert HOLD_S < 0.5 - 0.05  # what the loop takes beside
    paused = [now for now, velocity in asked if now < delay_s and velocity == STANDSTILL]
    assert bool(paused) == (delay_s > HOLD_S + 0.01)


def test_a_single_press_is_a_small_step():
    keyboard = Keyboard()
    keyboard.press("l", 1.0)
    assert keyboard.velocity(1.0) == keyboard.velocity(1.0 + HOLD_S) == Velocity(0.0, -NUDGE * OMEGA_RAD_S)
    assert keyboard.velocity(1.0 + HOLD_S + 1e-6) == keyboard.velocity(0.9) == STANDSTILL


@pytest.mark.parametrize("other", ["u", "k", " ", "x", "\x1b[z", "\x00", "é"])
def test_another_driving_key_continues_and_any_other_key_stops_at_once(other):
    keyboard = Keyboard()
    for now in (0.0, 0.1):
        keyboard.press("i", now)
    for key in presses(other):
        keyboard.press(key, 0.15)
    assert keyboard.velocity(0.15) == (Velocity(V_M_S, OMEGA_RAD_S) if other == "u" else STANDSTILL)


def test_keys_by_name():
    assert presses("iU,") == ["i", "u", ","]
    assert presses("\x1b[A\x1bOD") == ["\x1b[a", "\x1b[d"]
    assert presses("iq") == ["i", Press.QUIT]
    assert [presses(key) for key in ("Q", "\x03", "\x04", "\x1a")] == [[Press.QUIT]] * 4
    # Each key drives to where it lies beside k; backward, it is the rear that goes there.
    assert (KEYS["u"], KEYS["o"], KEYS["m"], KEYS["."]) == ((1, 1), (1, -1), (-1, -1), (-1, 1))


@given(st.text(max_size=40), st.floats(0, 1))
def test_any_keys_keep_the_rover_within_the_speeds_of_a_circuit(text, later):
    keyboard = Keyboard()
    for number, key in enumerate(presses(text)):
        keyboard.press(key, 0.03 * number)
    v, omega = keyboard.velocity(0.03 * len(text) + later)
    assert abs(v) <= V_M_S < V_MAX
    assert abs(omega) <= OMEGA_RAD_S < OMEGA_MAX
    if later > HOLD_S:
        assert (v, omega) == STANDSTILL


def read(*chunks):
    """Return the keys in bytes that a terminal sends in these chunks, decoded as `Terminal` does."""
    decoder, reader = codecs.getincrementaldecoder("utf-8")("surrogateescape"), KeyReader()
    return [key for chunk in chunks for key in reader.keys(decoder.decode(chunk))]


SEQUENCES = {
    "Shift+Enter": b"\x1b[13;2u",
    "CSI u with event": b"\x1b[105;1:3u",
    "u, as CSI u": b"\x1b[117u",
    "Ctrl+Up": b"\x1b[1;5A",
    "Shift+Up of rxvt": b"\x1b[a",
    "Ctrl+Up of rxvt": b"\x1bOa",
    "Ctrl+Up of old xterm": b"\x1bO5A",
    "Alt+Up": b"\x1b\x1b[A",
    "Alt+i": b"\x1bi",
    "Esc twice, then i": b"\x1b\x1bi",
    "F3": b"\x1bOR",
    "comma of the keypad": b"\x1bOl",
    "minus of the keypad": b"\x1bOm",
    "digit of the keypad": b"\x1bOu",
    "F5": b"\x1b[15~",
    "F1 of the Linux console": b"\x1b[[A",
    "8-bit CSI": b"\x9b13;2u",
    "8-bit CSI in UTF-8": "\x9b13;2u".encode(),
    "8-bit SS3": b"\x8fu",
    "mouse of X10": b"\x1b[M iu",
    "mouse, 8-bit": b"\x1b[M\xa0\xe9i",
    "mouse, UTF-8": b"\x1b[M \xc2\xa1i",
    "mouse of SGR": b"\x1b[<0;20;10M\x1b[<0;20;10m",
    "mouse of urxvt": b"\x1b[32;20;10M",
    "focus": b"\x1b[I\x1b[O",
    "cursor position": b"\x1b[10;20R",
    "device attributes": b"\x1b[?62;1;6c",
    "mode report": b"\x1b[?2004;1$y",
    "title": b"\x1b]0;uiojlm,.\x07",
    "colour": b"\x1b]11;rgb:1e1e/1e1e/1e1e\x1b\\",
    "status string": b"\x1bP1$r0m\x1b\\",
    "8-bit string": b"\x90uio\x9c",
    "character set": b"\x1b(u",
    "paste": b"\x1b[200~uiojlm,.\x1b[201~",
    "8-bit paste": b"\x9b200~uiojlm,.\x9b201~",
    "Esc, then paste": b"\x1b\x1b[200~uio\x1b[201~",
    "paste of a command": b"\x1b[200~ls -l\n./run.sh\n\x1b[201~",
    "paste without marks": b"look, a jug of oil",
    "long": b"\x1b[" + b"1;" * 5000 + b"u",
    "long string": b"\x1b]" + b"uio" * 5000 + b"\x07",
    "letters beyond ASCII": "ìöü，．ｉ".encode(),
    "no UTF-8": bytes(range(0xA0, 0x100)),
}


@pytest.mark.parametrize("name", SEQUENCES)
def test_only_a_whole_drive_key_drives(name):
    data = SEQUENCES[name]
    places = range(1, len(data)) if len(data) < 100 else range(1, len(data), 997)
    for chunks in ([data], *([data[:at], data[at:]] for at in places)):
        if name == "paste without marks" and len(chunks) > 1:
            continue  # half of it may be a key
        keys = read(*chunks)
        assert keys
        assert set(keys) == {Press.STOP}
    reader_goes_on = read(data, b"i", b"\x1b[A", b"\x1bOC", b"q")
    assert reader_goes_on[-4:] == ["i", "\x1b[a", "\x1b[c", Press.QUIT]


def test_an_arrow_may_arrive_in_parts_and_a_lone_escape_stops():
    assert read(b"\x1b", b"[", b"A") == [Press.STOP, Press.STOP, "\x1b[a"]
    assert read(b"\x1b") == [Press.STOP]
    assert read(b"\x1b", b"q") == [Press.STOP, Press.QUIT]
    assert read(b"\x1b[200~i", b"i", b"i\x1b[20", b"1~", b"i") == [Press.STOP] * 4 + ["i"]


_DRIVES = re.compile(rb"\x1b[\[O][A-D]")
_PRINTED = st.characters(codec="utf-8", exclude_characters="uiojlmUIOJLM,.qQ\x03\x04\x1a").map(str.encode)
_PARAMETERS = st.text("0123456789;:<=>?", max_size=8).map(str.encode)
_FINAL = st.characters(min_codepoint=0x40, max_codepoint=0x7E).map(str.encode)
_COORDINATE = st.sampled_from([b" ", b"i", b"~", b"\xa0", b"\xb5", "\xa1".encode(), "\u07ff".encode()])
_UNITS = st.one_of(
    _PRINTED,
    st.tuples(st.sampled_from([b"\x1b[", b"\x9b", "\x9b".encode()]), _PARAMETERS, _FINAL).map(b"".join),
    st.tuples(st.sampled_from([b"\x1bO", b"\x8f"]), _FINAL).map(b"".join),
    st.lists(_COORDINATE, min_size=3, max_size=3).map(lambda three: b"\x1b[M" + b"".join(three)),
    st.binary(max_size=10).map(lambda text: b"\x1b[200~" + text + b"\x1b[201~"),
    st.text("uiojlm,. 0", max_size=10).map(lambda text: f"\x1b]{text}\x07".encode()),
    st.sampled_from(sorted(set(SEQUENCES.values()) - {SEQUENCES["paste without marks"]}, key=len)[:-2]),
)


@given(st.lists(_UNITS, max_size=8).map(b"".join), st.lists(st.integers(0, 100), max_size=4))
def test_bytes_without_a_drive_key_move_nothing(data, places):
    assume(not _DRIVES.search(data))
    cuts = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    chunks = [data[a:b] for a, b in pairwise(cuts)]
    assert not set(read(*chunks)) & set(KEYS)
