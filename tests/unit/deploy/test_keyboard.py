"""The dead-man of the keyboard, on virtual time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.keyboard import HOLD_S, IGNORED_S, KEYS, NUDGE, OMEGA_RAD_S, V_M_S, Keyboard
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.course.course import OMEGA_MAX, V_MAX


def held(key, until_s, delay_s, rate_hz, end_s=5.0):
    """Velocity commanded while a terminal repeats a held key: (time, velocity) each 10 ms."""
    keyboard, times = Keyboard(), [0.0, *np.arange(delay_s, until_s, 1 / rate_hz)]
    asked = []
    for now in np.arange(0.0, end_s, 0.01):
        while times and times[0] <= now:
            keyboard.take(key, now)
            times.pop(0)
        asked.append((now, keyboard.velocity(now)))
    return asked


@pytest.mark.parametrize(("delay_s", "rate_hz"), [(0.25, 30), (0.66, 25)])
def test_a_held_key_drives_and_keys_up_means_stop(delay_s, rate_hz):
    asked = held("i", 3.0, delay_s, rate_hz)
    assert asked[0][1] == Velocity(NUDGE * V_M_S, 0.0)
    on_the_way = [velocity for now, velocity in asked if delay_s + 2 / rate_hz < now < 2.9]
    assert set(on_the_way) == {Velocity(V_M_S, 0.0)}
    assert all(velocity == STANDSTILL for now, velocity in asked if now > 3.0 + HOLD_S)
    assert HOLD_S < 0.5 - 0.05  # what the loop takes beside
    paused = [now for now, velocity in asked if now < delay_s and velocity == STANDSTILL]
    assert bool(paused) == (delay_s > HOLD_S + 0.01)


@pytest.mark.parametrize("other", ["u", "k", "x", "\x1b[z"])
def test_another_driving_key_continues_and_any_other_key_stops_at_once(other):
    keyboard = Keyboard()
    for now in (0.0, 0.1):
        keyboard.take("i", now)
    keyboard.take(other, 0.15)
    assert keyboard.velocity(0.15) == (Velocity(V_M_S, OMEGA_RAD_S) if other == "u" else STANDSTILL)


def test_each_key_drives_to_where_it_lies_beside_k():
    assert (KEYS["u"], KEYS["o"], KEYS["m"], KEYS["."]) == ((1, 1), (1, -1), (-1, -1), (-1, 1))
    for text, key in (("I", "i"), ("iii", "i"), ("\x1b[A", "i"), ("\x1bOD", "j"), ("\x1b[B\x1b[B", ",")):
        typed, same = Keyboard(), Keyboard()
        assert not typed.take(text, 0.0)
        assert not same.take(key, 0.0)
        assert typed.velocity(0.0) == same.velocity(0.0) != STANDSTILL


@pytest.mark.parametrize("key", ["q", "\x03", "\x04"])
def test_a_key_that_ends_the_drive_ends_it_also_while_others_are_ignored(key):
    keyboard = Keyboard()
    assert not keyboard.take("\x1b", 0.0)
    assert keyboard.take(key, 0.01)


@given(st.lists(st.text("ijq \x1b[OAB2~é", max_size=6), max_size=20), st.floats(0, 1))
def test_any_keys_keep_the_rover_within_the_speeds_of_a_circuit(texts, later):
    keyboard = Keyboard()
    for number, text in enumerate(texts):
        keyboard.take(text, 0.03 * number)
    v, omega = keyboard.velocity(0.03 * len(texts) + later)
    assert abs(v) <= V_M_S < V_MAX
    assert abs(omega) <= OMEGA_RAD_S < OMEGA_MAX
    if later > HOLD_S:
        assert (v, omega) == STANDSTILL


SEQUENCES = {
    "Shift+Enter": "\x1b[13;2u",
    "Ctrl+Up": "\x1b[1;5A",
    "Alt+i": "\x1bi",
    "8-bit CSI": "\ufffd13;2u",
    "mouse of X10": "\x1b[M iu",
    "letters beyond ASCII": "ìöü，．ｉ",
}


@pytest.mark.parametrize("name", SEQUENCES)
def test_only_a_whole_drive_key_drives(name):
    text = SEQUENCES[name]
    for at in range(len(text)):
        keyboard = Keyboard()
        for part in (text[:at], text[at:]) if at else (text,):
            keyboard.take(part, 0.0)
            assert keyboard.velocity(0.0) == STANDSTILL
        keyboard.take("i", IGNORED_S)
        assert keyboard.velocity(IGNORED_S) == Velocity(NUDGE * V_M_S, 0.0)
