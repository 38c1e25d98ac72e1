"""The end of a program that drives a robot as a Gymnasium environment."""

import signal
import subprocess
import sys

import pytest
from kit.bridge_bench import Driver, wait_for

SCRIPT = """
import sys, gymnasium, numpy
env = gymnasium.make("deploy.env:rover_ncp/Rover-v0", robot=sys.argv[1])
env.reset()
print("driving", flush=True)
while True:
    env.step(numpy.array([0.1, 0.0]))
"""


def assert_stopped_and_released(rig):
    wait_for(lambda: abs(rig.truth.speed()) < 0.001, what="the rover to stand")
    with Driver(rig.robot) as driver:
        assert driver.motors().granted
        driver.motors(enable=False)


def test_ctrl_c_in_a_program_stops_the_rover(rig):
    command = [sys.executable, "-c", SCRIPT, rig.robot]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout.readline() == "driving\n"
        wait_for(lambda: rig.truth.speed() > 0.05, what="the rover to drive")
        program.send_signal(signal.SIGINT)
        assert program.wait(20) == -signal.SIGINT
    assert_stopped_and_released(rig)


@pytest.mark.long
def test_end_of_a_program_that_does_not_close_stops_the_rover(rig):
    script = SCRIPT.replace("while True:", "for _ in range(8):")
    command = [sys.executable, "-c", script, rig.robot]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert_stopped_and_released(rig)
