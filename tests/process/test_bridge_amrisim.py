"""The bridge drives what AMRISim is: as a process, over TCP, with the recorded bytes of the real one."""

import time

import pytest
from amrisim import RECORDED, AmriSimServer
from bridge_bench import MACHINE_S, Driver, braking_s, wait_for

from bridge.pioneer.arcos import encode_frame
from bridge.pioneer.packets import Kind
from sim.live.processes import Process

STOP_S = 0.5


@pytest.fixture
def amrisim():
    with AmriSimServer() as server:
        yield server


@pytest.fixture
def driver(amrisim, tmp_path):
    bridge = Process("bridge", ["--base", amrisim.base, "--listen", "tcp/127.0.0.1:0"], tmp_path)
    try:
        ready = dict(part.split("=", 1) for part in bridge.wait_for_line("ready ").split())
        with Driver(ready["zenoh"]) as driver:
            yield driver
    finally:
        bridge.stop()


def test_the_recorded_configpac_is_the_short_one_that_shows_signed_lengths():
    frame = encode_frame(Kind.CONFIG, RECORDED[Kind.CONFIG].payload)
    assert frame[2] == 124


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
