"""The dead-man of the keyboard, on virtual time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.teleop.keyboard import HOLD_S, KEYS, NUDGE, OMEGA_RAD_S, V_M_S, Keyboard, Press, presses
from rover_ncp.core.geometry import Velocity
from rover_ncp.course.reference import OMEGA_MAX, V_MAX

STILL = Velocity(0.0, 0.0)


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
    assert all(velocity == STILL for now, velocity in asked if now > 3.0 + HOLD_S)
    assert HOLD_S < 0.5 - 0.05  # what the loop takes beside
    paused = [now for now, velocity in asked if now < delay_s and velocity == STILL]
    assert bool(paused) == (delay_s > HOLD_S + 0.01)


def test_a_single_press_is_a_small_step():
    keyboard = Keyboard()
    keyboard.press("l", 1.0)
    assert keyboard.velocity(1.0) == keyboard.velocity(1.0 + HOLD_S) == Velocity(0.0, -NUDGE * OMEGA_RAD_S)
    assert keyboard.velocity(1.0 + HOLD_S + 1e-6) == keyboard.velocity(0.9) == STILL


@pytest.mark.parametrize("other", ["u", "k", " ", "x", "\x1b[z", "\x00", "é"])
def test_another_driving_key_continues_and_any_other_key_stops_at_once(other):
    keyboard = Keyboard()
    for now in (0.0, 0.1):
        keyboard.press("i", now)
    for key in presses(other):
        keyboard.press(key, 0.15)
    assert keyboard.velocity(0.15) == (Velocity(V_M_S, OMEGA_RAD_S) if other == "u" else STILL)


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
        assert (v, omega) == STILL
