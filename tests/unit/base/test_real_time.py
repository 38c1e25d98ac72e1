"""The loop of a mock in real time: fault lines that come in parts, and steps that are late."""

import io
import logging
import os
import time

import pytest

from rover_ncp.robot.description import load_description
from sim.base.faults import Faults
from sim.base.firmware import Firmware
from sim.mock.real_time import RealTimeLoop
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover


class Loop(RealTimeLoop):
    def send(self):
        pass


@pytest.fixture
def loop(caplog):
    """A loop that serves for some turns, and a pipe to its fault lines."""
    reader, writer = os.pipe()
    caplog.set_level(logging.INFO, "rover_ncp")
    firmware = Firmware(
        load_description("p3at-sh"), PymunkRover(default_rover(), Ground()), Faults(), time.monotonic()
    )
    loop = Loop(firmware)

    def serve(text):
        if text:
            os.write(writer, text)
        turns = iter(range(3))
        caplog.clear()
        with io.FileIO(reader, closefd=False) as lines:
            loop.serve(lambda: next(turns, None) is None, lines)
            if lines in {key.fileobj for key in loop.selector.get_map().values()}:
                loop.selector.unregister(lines)
        return [line.split()[-1] for line in caplog.messages]

    def end(text):
        os.write(writer, text)
        os.close(writer)

    yield serve, end
    loop.close()
    os.close(reader)


@pytest.mark.timeout(20)  # it waited for the rest of the line for good
def test_half_a_fault_line_blocks_nothing_and_counts_once_it_is_whole(loop):
    serve, end = loop
    assert serve(b"mu") == []
    assert serve(b"te\nstall\nde") == ["mute", "stall"]
    end(b"af")
    assert serve(b"") == ["deaf"]
