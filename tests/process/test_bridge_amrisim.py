"""The bridge drives what AMRISim is: as a process, over TCP, with the recorded bytes of the real one."""

import time

import pytest
from kit.amrisim import AmriSimServer
from kit.bridge_bench import MACHINE_S, Driver, braking_s, wait_for, zenoh_address

from sim.live.processes import Process

STOP_S = 0.5


@pytest.fixture
def amrisim():
    with AmriSimServer() as server:
        yield server


@pytest.fixture
def driver(amrisim, tmp_path):
    arguments = ["--base", amrisim.base, "--listen", "tcp/127.0.0.1:0"]
    with Process("bridge", arguments, tmp_path) as bridge, Driver(zenoh_address(bridge)) as driver:
        yield driver


def test_a_base_whose_motors_are_on_from_the_start_is_driven_and_stopped(amrisim, driver):
    # The bridge found motors on without a lease: it switches them off before the first drive.
    wait_for(lambda: amrisim.connected and not amrisim.server.firmware.drive.enabled)
    # West across the counter's zero, where 15 and 16 bits disagree: -1 mm is 65535, not 32767.
    driver.start(v=-0.15)
    driver.drive(1.0, v=-0.15)
    assert amrisim.rover.velocity.v == pytest.approx(-0.15, abs=0.02)
    driver.motors(enable=False)
    wait_for(lambda: amrisim.rover.velocity.v == 0.0 and not amrisim.server.firmware.drive.enabled)
    true = amrisim.rover.pose
    wait_for(lambda: abs(driver.odom.pose.x - true.x) < 0.005)
    assert true.x < -0.1
    assert "tf" in driver.seen


def test_silence_stops_it_although_it_has_no_watchdog(amrisim, driver):
    driver.start().drive(0.3)
    began = time.monotonic()
    wait_for(lambda: amrisim.rover.velocity.v == 0.0)
    assert time.monotonic() - began < STOP_S + braking_s(0.15) + MACHINE_S
