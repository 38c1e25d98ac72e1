"""The bridge as a process: how it begins and how it ends."""

import json
import signal
import socket
import time

import pytest
from kit.bridge_bench import MACHINE_S, STOP_S, Driver, braking_s, wait_for
from kit.true_motion import stood_after

from rover_ncp import cli
from rover_ncp.core.geometry import Velocity
from sim.park.live import LiveRun

NO_ROBOT = "tcp/127.0.0.1:1"
FORGED = "ready zenoh=tcp/192.0.2.1:7447 base=tcp/192.0.2.1:8101"


@pytest.fixture
def fails(capsys):
    """Run a bridge that cannot start, in this process; return its exit code and its one line."""

    def run(base, *arguments):
        code = cli.run(["bridge", "--base", base, "--listen", "tcp/127.0.0.1:0", *arguments, "--json"])
        captured = capsys.readouterr()
        result = json.loads(captured.out)
        assert result["exit_code"] == code
        assert captured.err == f"rover-ncp: {result['error']}\n"
        return code, result["error"]

    return run


def test_rover_drives_stops_in_time_and_stops_again_at_ctrl_c(tmp_path):
    with LiveRun(tmp_path) as rig, Driver(rig.robot) as driver:
        driver.name = f"x\x1b[2J\n{FORGED}"
        driver.start(v=0.1)
        before = driver.odom
        sent_ns = driver.drive(0.5, v=0.1)
        assert (driver.gate.lease, driver.gate.held) == (driver.lease.number, "")
        assert driver.out == Velocity(0.1, 0.0)
        moved = driver.odom.pose.x - before.pose.x
        assert moved == pytest.approx((driver.odom.stamp_ns - before.stamp_ns) * 1e-9 * 0.1, rel=0.2)
        assert abs(driver.odom.stamp_ns - time.time_ns()) < 1e9
        tokens = list(driver.session.liveliness().get("rover/alive/*", timeout=2.0))
        assert [str(reply.ok.key_expr) for reply in tokens] == ["rover/alive/bridge"]
        assert stood_after(rig.truth, sent_ns) < STOP_S + braking_s(0.1) + MACHINE_S

        # A lease that lapses while the next one begins cuts that one's first command off.
        wait_for(lambda: not driver.gate.lease)
        time.sleep(0.5)  # until the base has reported that its motors are off
        driver.start()
        # A command that is still on its way when the bridge stops is not counted.
        # A busy machine may bring one so late that it is dropped.
        wait_for(lambda: driver.gate.accepted + sum(driver.gate.dropped.values()) == driver.sent)
        interrupted_ns = time.monotonic_ns()
        rig.bridge.send_signal(signal.SIGINT)
        done = rig.bridge.wait(5.0)
        assert stood_after(rig.truth, interrupted_ns) < braking_s(0.15) + STOP_S
        assert done.code == 130
        mock = rig.mock.stop().result
    result = json.loads((tmp_path / "bridge.json").read_text())
    assert result["accepted"] + sum(result["dropped"].values()) == driver.sent
    assert set(result["dropped"]) <= {"stale", "no-lease"}
    assert (set(result["stops"]), result["reconnects"]) == ({"silence"}, 0)
    assert mock["touched"] is False
    # The driver's name neither clears the screen nor forges a line.
    lines = (tmp_path / "bridge.log").read_text().splitlines()
    assert [line for line in lines if line.startswith("ready ")] == lines[1:2]
    assert f"x\\x1b[2J\\n{FORGED} got the lease" in lines
    assert "\x1b" not in "".join(lines)


def test_no_robot_is_exit_3_once_the_bridge_listens(fails):
    assert fails(NO_ROBOT) == (3, f"{NO_ROBOT}: connection refused: nothing listens there")


def test_a_port_in_use_is_exit_2_and_the_robot_is_left_alone(fails):
    with socket.create_server(("127.0.0.1", 0)) as taken, socket.create_server(("127.0.0.1", 0)) as robot:
        listen = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        code, line = fails(f"tcp/127.0.0.1:{robot.getsockname()[1]}", "--listen", listen)
        robot.setblocking(False)
        with pytest.raises(BlockingIOError):
            robot.accept()
    assert code == 2
    assert line == f"--listen {listen}: another process listens there already"
