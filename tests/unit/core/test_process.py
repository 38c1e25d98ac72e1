"""Termination signals."""

import os
import signal

import pytest

from rover_ncp.core.process import Interrupts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_each_is_noted_and_all_is_as_before_afterwards(number):
    before = signal.getsignal(number)
    with Interrupts() as interrupts:
        assert not interrupts.raised
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        assert (interrupts.raised, interrupts.received) == (True, [number, number])
    assert signal.getsignal(number) is before


def test_ignored_signals_stay_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupts() as interrupts:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not interrupts.raised
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
