"""Taking over a running drive with what can be subscribed to: mock, bridge and deploy as real processes."""

import time

import pytest
from kit.attacker import Attacker
from kit.bridge_bench import wait_for

from deploy.drive.records import TICKS_TOPIC, TickRecord
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.messages import read_text, read_twist
from rover_ncp.wire.protocol import parse_json
from sim.live.live_run import LiveRun
from sim.live.truth import judge_truth

ATTEMPTS, PERIOD_S = 1000, 0.005


@pytest.mark.long
def test_1000_attempts_to_take_over_a_drive_fail_and_it_ends_parked(tmp_path, request):
    course = request.config.rootpath / "tests" / "data" / "brief_course.yaml"
    recording = tmp_path / "run.mcap"
    with LiveRun(tmp_path / "log") as run:
        attacker = Attacker(run.robot)
        driver = run.deploy("--course", str(course), "--record", str(recording))
        wait_for(lambda: (len(attacker.commands) > 5 and attacker.requests) or not driver.running, 30.0)
        due = time.monotonic()
        for number in range(ATTEMPTS):
            attacker.attempt(number)
            if not driver.running:
                break
            due += PERIOD_S
            time.sleep(max(due - time.monotonic(), 0.0))
        attempts = number + 1
        done = driver.wait(60.0)
        bridge = run.bridge.stop()
        attacker.close()

    assert (done.code, done.result["parked"], done.result["stopped_by"]) == (0, True, None), done.last_line
    assert attempts == ATTEMPTS
    recorded = read_recording(recording)
    ticks = [parse_json(TickRecord, read_text(message.data)) for message in recorded.topic(TICKS_TOPIC)]
    assert judge_truth(load_course(course), run.truth.read(), ticks[0].wall_ns).parked

    # Half of the attempts are commands: all were dropped, and none but the driver's was accepted.
    sent = len(recorded.topic("cmd_vel"))
    heard = [read_twist(message.data).velocity.v for message in recorded.topic("rover/cmd_out")]
    assert bridge.result["accepted"] <= sent
    assert sum(bridge.result["dropped"].values()) >= 0.5 * ATTEMPTS
    assert min(heard) >= 0.0
    # Only the driver ever had a lease, and no answer holds a key.
    assert len(attacker.answers) >= 0.4 * ATTEMPTS
    assert {answer["granted"] for answer in attacker.answers} == {False}
    assert not any("key" in answer for answer in attacker.answers)
    assert {gate["driver_name"] for gate in attacker.gates} == {"", "policy course"}
    assert {gate["lease"] for gate in attacker.gates} == {0, 1}
