"""``check`` against a healthy robot and against faulty ones: real processes."""

import json
import re
import threading
from types import SimpleNamespace

import pytest
from kit.bridge_bench import BRAKING_M_S2, Rig, wait_for
from kit.json_fields import undescribed

from deploy.check import STANDING, Battery, Preflight
from rover_ncp import cli
from rover_ncp.wire.protocol import BaseReply


@pytest.fixture
def check(capsys):
    def check(robot, *options):
        code = cli.run(["check", "--robot", robot, "--on-blocks", "--json", *options])
        captured = capsys.readouterr()
        result = json.loads(captured.out)
        assert not undescribed("check", result)
        return code, result, captured.err

    return check


def test_a_robot_that_is_well(tmp_path, check):
    with Rig(tmp_path) as rig:
        code, wrong, _ = check(rig.locator, "--model", "turtlebot4")
        assert (code, [finding["name"] for finding in wrong["findings"]]) == (1, ["model"])
        assert "the bridge drives p3at-sh, expected turtlebot4" in wrong["findings"][0]["detail"]
        code, said, _ = check(rig.locator)
        stopped = rig.stood_after(rig.truth.read()[-1].wall_ns)
        gate = rig.bridge.stop().result
    assert [finding for finding in said["findings"] if not finding["ok"]] == []
    assert (code, said["ready"]) == (0, True)
    assert [finding["name"] for finding in said["findings"]] == [
        *("odometry", "battery", "stop", "motors", "forward", "left", "silence", "bridge")
    ]
    # What it calls standing may still creep, for as long as braking from that takes.
    assert stopped <= STANDING / BRAKING_M_S2
    # The rehearsal. A busy machine adds others of the rules on lateness, which the check allows for.
    assert {"silence"} <= gate["stops"].keys() <= {"silence", "odometry"}


def test_a_driver_is_warned_of_another_model(tmp_path, capsys):
    with Rig(tmp_path) as rig:
        for model in ("turtlebot4", "p3at-sh"):
            looks = ["deploy", "--robot", rig.locator, "--dry-run", "--duration", "0.3", "--model", model]
            assert cli.run(looks) == 0
    assert re.findall(r"drives (\S+), but --model is (\S+):", capsys.readouterr().out) == [
        ("p3at-sh", "turtlebot4")
    ]


@pytest.mark.parametrize(("reports", "ok"), [([10, 20], True), ([10, 15], False)])
def test_rare_odometry_is_listened_to_once_more(reports, ok):
    counts, taken = iter(reports), {"odom": 0}

    def listen(condition, timeout_s):
        taken["odom"] += next(counts)

    measurements, monitor = SimpleNamespace(taken=taken), SimpleNamespace(until=listen)
    found, words = Preflight(None, measurements, monitor, Battery())._check_odometry()
    assert found is ok
    assert words == f"{reports[-1] / 2:.1f} reports a second (at least 8)"


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ("unknown", "the timeout was not measured: a stop"),
        ("none", "if the bridge dies, the base does not"),
    ],
)
def test_a_measurement_that_a_stop_ended_is_not_called_a_missing_timeout(monkeypatch, state, words):
    replies = (BaseReply(model="husky-a200", state=state) for state in ("unknown", "running", state))
    link = SimpleNamespace(
        about_base=lambda measure=False: next(replies), request_motors=lambda name, unchecked: None
    )
    monkeypatch.setattr(Preflight, "_move", lambda self, velocity: None)
    monitor, measurements = SimpleNamespace(until=lambda condition, timeout_s: False), SimpleNamespace()
    found, detail = Preflight(link, measurements, monitor, Battery())._check_base_timeout()
    assert found is False
    assert detail.startswith(words)


@pytest.mark.parametrize(
    ("faults", "name", "words"),
    [
        (["low-battery=11.2"], "battery", r"11\.2 V"),
        (["stop-button"], "stop", "held by stop-button"),
        # A busy machine may send a command late; the check then says that the gate dropped it.
        (
            ["freeze-odometry@0"],
            "forward",
            r"reports 0\.00 m/s and 0\.00 m: the gate (passed all commands on|dropped commands: stale)",
        ),
        (["bumper@0.5"], "forward", "the gate stopped the robot: bumper"),
    ],
)
@pytest.mark.long
def test_a_robot_that_is_not(tmp_path, check, faults, name, words):
    with Rig(tmp_path, mock=[item for fault in faults for item in ("--fault", fault)]) as rig:
        code, said, err = check(rig.locator)
        rig.stood_after(rig.truth.read()[-1].wall_ns)
    assert (code, said["ready"]) == (1, False)
    assert said["findings"][-1]["name"] == name
    assert re.search(words, said["findings"][-1]["detail"])
    assert f"no: {name}: " in err or not err


@pytest.mark.long
def test_a_robot_that_is_stopped_while_it_turns(tmp_path, check):
    with Rig(tmp_path) as rig:

        def press_bumper():
            wait_for(lambda: rig.truth.read()[-1].velocity.omega > 0.05, 30.0)
            rig.mock.tell("bumper@0-5")

        turning = threading.Thread(target=press_bumper)
        turning.start()
        code, said, _ = check(rig.locator)
        turning.join()
    assert (code, said["ready"]) == (1, False)
    assert said["findings"][-1]["name"] == "left"
    assert "the gate stopped the robot: bumper" in said["findings"][-1]["detail"]


@pytest.mark.long
def test_a_limit_that_slows_the_robot_is_named(tmp_path, check):
    limits = tmp_path / "limits.yaml"
    limits.write_text("v_max: 0.03\n")
    with Rig(tmp_path, bridge=["--limits", str(limits)]) as rig:
        code, said, _ = check(rig.locator)
    assert (code, said["findings"][-1]["name"]) == (1, "forward")
    assert said["findings"][-1]["detail"].endswith("the gate limited commands: speed")
