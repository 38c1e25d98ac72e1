"""A person's drive on the virtual clock, and the terminal of a process over a pseudo-terminal."""

import contextlib
import os
import pty
import sys
import termios

import numpy as np
import pytest
from kit.virtual_drive import VirtualDrive

from deploy.keyboard import HOLD_S, V_M_S
from deploy.teleop import Teleop, Terminal
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import STANDSTILL

REPEAT_S, DELAY_S = 0.033, 0.3


class Typed:
    """A terminal on a virtual clock: texts, or what is called, by the time since the drive began."""

    def __init__(self, bridge, keys):
        self._bridge, self._keys, self._began = bridge, sorted(keys, key=lambda key: key[0]), None

    def _due(self):
        return self._began + self._keys[0][0] if self._keys else float("inf")

    def read(self, timeout_s):
        now = self._bridge.monotonic()
        self._bridge.sleep(min(max(self._due() - now, 0.0), timeout_s))
        if self._due() > self._bridge.monotonic() + 1e-9:
            return ""
        text = self._keys.pop(0)[1]
        return (text() or "") if callable(text) else text

    def discard(self):
        if self._began is None:
            self._began = self._bridge.monotonic()
        while self._due() < self._bridge.monotonic():
            self._keys.pop(0)


def held(key, until_s):
    """A held key as a terminal reports it."""
    return [(0.0, key), *((float(t), key) for t in np.arange(DELAY_S, until_s, REPEAT_S))]


@pytest.fixture
def virtual():
    return VirtualDrive()


def teleop(virtual, keys):
    """Return a person's drive that has the motors once it runs."""
    terminal = Typed(virtual.bridge, keys)
    driven = Teleop(virtual.link, terminal, lambda: virtual.interrupted(), virtual.bridge)  # noqa: PLW0108
    driven.wait()
    return driven


def test_it_drives_while_a_key_repeats_and_stands_when_it_is_released(virtual):
    speeds = {}
    looks = [
        (at, lambda at=at: speeds.update({at: virtual.rover.velocity.v}))
        for at in (1.4, 1.5 + HOLD_S + 0.05 + 0.15 + V_M_S / 0.3 + 0.1)
    ]
    driven = teleop(virtual, [*held("i", 1.5), *looks, (4.0, "q")])
    driven.run()
    driving, released = speeds.values()
    assert driving == pytest.approx(V_M_S, abs=0.002)
    assert released == pytest.approx(0.0, abs=1e-3)
    assert virtual.rover.pose.x > 0.1
    assert driven.seconds == pytest.approx(4.0, abs=0.1)
    assert len(virtual.link.sent) > 71
    assert virtual.link.gate.lease == 0


@pytest.mark.parametrize("way", ["q", None, "signal", "bridge-lost"])
def test_on_every_way_out_the_rover_stands_and_the_lease_is_released(virtual, way):
    def leave():
        virtual.interrupted = lambda: way == "signal"
        virtual.link.bridge_alive = way != "bridge-lost"

    driven = teleop(virtual, [*held("i", 1.0), (1.0, leave if way in {"signal", "bridge-lost"} else way)])
    error = {"signal": KeyboardInterrupt, "bridge-lost": SafetyStop}.get(way)
    with pytest.raises(error) if error else contextlib.nullcontext():
        driven.run()
    assert virtual.rover.velocity.v > 0.05
    assert virtual.link.sent[-1] == STANDSTILL
    assert virtual.stands()
    assert virtual.link.gate.lease == 0


@pytest.mark.parametrize(("stalled_s", "stopped"), [(0.3, False), (3.0, True)])
def test_keys_that_piled_up_while_it_did_not_run_move_nothing(virtual, stalled_s, stopped):
    piled = [(0.75 + 0.01 * n, "i") for n in range(20)]
    driven = teleop(virtual, [(0.7, lambda: virtual.bridge.sleep(stalled_s)), *piled, (5.0, "q")])
    with pytest.raises(SafetyStop) if stopped else contextlib.nullcontext():
        driven.run()
    assert set(virtual.link.sent) == {STANDSTILL}
    assert abs(virtual.rover.pose.x) < 1e-6


@pytest.fixture
def terminal(monkeypatch):
    """A pseudo-terminal as standard input: its other end, and its own."""
    master, slave = pty.openpty()
    monkeypatch.setattr(sys, "stdin", os.fdopen(slave, "rb", buffering=0, closefd=False))
    yield master, slave
    for fd in (master, slave):
        with contextlib.suppress(OSError):
            os.close(fd)


def test_terminal_gives_keys_at_once_and_is_as_before_at_the_end(terminal):
    master, slave = terminal
    before = termios.tcgetattr(slave)
    os.write(master, b"i" * 50)  # typed before the drive
    with Terminal() as keys:
        assert keys.read(0.0) == ""
        for text in ("i", "\x1b[A", "\x1a", "\x13", "é"):
            os.write(master, text.encode())
            assert keys.read(1.0) == text
        os.write(master, b"u")
        keys.discard()
        assert keys.read(0.0) == ""
        assert termios.tcgetattr(slave) != before
    assert termios.tcgetattr(slave) == before
