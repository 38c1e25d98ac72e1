"""Recordings of drives on a virtual clock, replayed."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from kit.virtual_drive import AHEAD, VirtualDrive

from deploy.drive.records import CONFIG_FILE, POLICY_FILE
from deploy.replay import Comparison, replay
from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy_file import policy_to_yaml
from rover_ncp.cli import run as shell
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import read_recording, rewrite
from rover_ncp.robot.profile import RoverProfile
from rover_ncp.wire.messages import read_text, read_twist, text

TICKS = 40
SAME = Comparison(same=True, ticks=TICKS, complete=True, difference=None)
COURSE = load_course("parking").model_copy(update={"start_signal_s": 0.5})


def record_drive(path):
    """Record a drive that loses one of 13 samples of odometry; return its result."""
    virtual, count = VirtualDrive(AHEAD, COURSE, path, ticks=TICKS), itertools.count(1)
    virtual.link.change["odom"] = lambda data: data if next(count) % 13 else None
    return virtual.run()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    result = record_drive(path)
    assert result.overruns >= 2  # a lost sample is bridged by prediction, and counted
    return path


def test_pulses_for_a_dead_band_recompute_to_the_same_bits(tmp_path):
    band = RoverProfile(name="band", dead_band_v=0.15, dead_band_omega=0.2)
    virtual = VirtualDrive(AHEAD, COURSE, tmp_path / "run.mcap", ticks=TICKS, rover=band)
    virtual.run()
    sent = {read_twist(data).velocity.v for data in virtual.messages("cmd_vel")}
    assert 0.0 in sent
    assert min(sent - {0.0}) > 0.15
    assert replay(tmp_path / "run.mcap").same


def test_a_recording_recomputes_to_the_same_bits(recorded):
    assert replay(recorded) == SAME


def with_file(recorded, name, change, path):
    """A copy of the recording in which one of its files is changed."""
    source = read_recording(recorded)
    changed = source.attachments | {name: change(source.attachments[name])}
    rewrite(replace(source, attachments=changed), path)
    return path


def rewritten(recorded, tmp_path, topic, number, change):
    """The recording with one message of a topic changed, or left out."""
    source, path = read_recording(recorded), tmp_path / "tampered.mcap"
    victim = source.topic(topic)[number]
    messages = []
    for message in source.messages:
        if message is not victim:
            messages.append(message)
        elif (data := change(message.data)) is not None:
            messages.append(replace(message, data=data))
    rewrite(replace(source, messages=tuple(messages)), path)
    return replay(path).difference


def other(name, place):
    """A change of one number of a tick's record by one bit."""

    def change(data):
        record = json.loads(read_text(data))
        record[name][place] = float(np.nextafter(record[name][place], 1))
        return text(json.dumps(record))

    return change


@pytest.mark.parametrize(
    ("topic", "change", "quantity"),
    [
        ("deploy/ticks", other("estimate", 3), "estimate v"),
        ("deploy/ticks", other("command", 1), "command omega"),
        ("odom", lambda data: None, "the odometry of stamp"),
    ],
)
def test_what_was_changed_in_a_recording_is_found(recorded, tmp_path, topic, change, quantity):
    # Odometry came before the start, too.
    difference = rewritten(recorded, tmp_path, topic, 18 - TICKS if topic == "odom" else 18, change)
    assert difference.quantity.startswith(quantity)
    assert 16 <= difference.tick <= 20
    assert str(difference).startswith(f"tick {difference.tick}: {quantity}")


def test_the_command_says_same_or_names_the_first_difference(recorded, tmp_path, capsys):
    assert shell(["replay", str(recorded), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == SAME.model_dump()

    nudged = AHEAD.parameters()
    nudged[AHEAD.layout().block(ParameterKind.LEAK_POTENTIAL).slice][9] *= 1 + 1e-9
    policy = policy_to_yaml(AHEAD.with_parameters(nudged)).encode()
    path = with_file(recorded, POLICY_FILE, lambda _: policy, tmp_path / "changed.mcap")
    assert shell(["replay", str(path), "--json"]) == 1
    fields = json.loads(capsys.readouterr().out)
    first = fields["difference"]
    assert not fields["same"]
    assert first["quantity"].startswith("command ")
    assert 0 < abs(float(first["recorded"]) - float(first["recomputed"])) < 1e-6


def test_recording_of_an_earlier_estimator_is_one_line_and_exit_code_2(recorded, tmp_path, capsys):
    def earlier(data):
        return data.replace(b"format: 5", b"format: 4")

    path = with_file(recorded, CONFIG_FILE, earlier, tmp_path / "earlier.mcap")
    assert shell(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    assert "format 4, expected 5: recordings of an older estimator cannot be" in error
    assert error.count("\n") == 1


def test_what_is_no_recording_of_a_drive_is_one_line_and_exit_code_2(recorded, tmp_path, capsys):
    source, path = read_recording(recorded), tmp_path / "other.mcap"
    rewrite(replace(source, messages=tuple(source.topic("odom"))), path)
    assert shell(["replay", str(path)]) == 2
    assert "other.mcap: holds no drive to recompute" in capsys.readouterr().err
