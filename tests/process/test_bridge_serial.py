"""A bridge on a serial line, which is a pseudo-terminal, with a base at another rate."""

from kit.bridge_bench import Driver
from kit.serial_base import SerialBase

from sim.base.firmware import ClientState
from sim.park.live import Process


def test_a_bridge_on_a_serial_line_asks_for_a_faster_rate_and_drives(tmp_path):
    with SerialBase() as base:
        arguments = ["--base", f"serial/{base.port}#baudrate=9600", "--listen", "tcp/127.0.0.1:0"]
        assert base.firmware.baudrate == 9600
        with Process("bridge", arguments, tmp_path) as process:
            zenoh = process.wait_for_line("ready zenoh=").split()[0]
            assert (base.firmware.baudrate, base.client_rate) == (38400, 38400)
            with Driver(zenoh) as driver:
                driver.start()
            process.stop()
        assert (base.firmware.client, base.firmware.baudrate) == (ClientState.WAITING, 9600)
    assert base.rates[:2] == [9600, 38400]
