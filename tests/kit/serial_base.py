"""A mock Pioneer on a pseudo-terminal, in real time, whose serial line has a rate that must be met."""

import os
import pty
import random
import select
import termios
import threading
import time
import tty

from rover_ncp.core.process import ClosedAtExit
from rover_ncp.robot.description import load_description
from sim.base.firmware import Firmware
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover

SPEEDS = {getattr(termios, f"B{rate}"): rate for rate in (9600, 19200, 38400, 57600, 115200)}


class SerialBase(ClosedAtExit):
    """``port`` is what a client opens. A thread turns the base until ``close``.

    With ``strict``, what goes through at another rate than the base's arrives as garbage.
    """

    def __init__(self, strict=False):
        # Ours stays open: without it, reading ends when a client leaves.
        self._far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.port = os.ttyname(self._near)
        model = load_description("p3at-sh")
        self.rover = PymunkRover(described_rover(model), Ground())
        self.firmware = Firmware(model, self.rover, start_s=time.monotonic())
        self.rates = []
        """Every rate the base had while bytes went through."""
        self._strict, self._garbler = strict, random.Random(0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def client_rate(self):
        """The rate that the client set its port to."""
        return SPEEDS[termios.tcgetattr(self._near)[5]]

    def close(self):
        self._stop.set()
        self._thread.join()
        os.close(self._far)
        os.close(self._near)

    def _run(self):
        while not self._stop.is_set():
            readable, _, _ = select.select([self._far], [], [], 0.01)
            if readable:
                self.firmware.receive(self._through(os.read(self._far, 4096)), time.monotonic())
            self.firmware.advance(time.monotonic())
            data = self.firmware.data_to_send()
            if data:
                os.write(self._far, self._through(data))

    def _through(self, data):
        rate = self.firmware.baudrate
        if not self.rates or self.rates[-1] != rate:
            self.rates.append(rate)
        if not self._strict or self.client_rate == rate:
            return data
        # A receiver at another rate takes its samples at the wrong moments: other bytes, and other many.
        return self._garbler.randbytes(max(1, len(data) * self.client_rate // rate))
