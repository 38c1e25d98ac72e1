"""The robot of an identification: the bridge's model, and the description of --model."""

import contextlib

import pytest
import yaml

from deploy.identify import run as identification
from deploy.identify.run import SETTINGS_FILE, identify_robot
from deploy.recorder import Recorder
from rover_ncp.core.console import Output
from rover_ncp.core.errors import SafetyStop
from rover_ncp.recording.recording import read_recording
from rover_ncp.robot.description import load_description

HUSKY = load_description("husky-a200")


class OtherRobot(contextlib.nullcontext):
    """A link to a bridge that drives another model than the driver's."""

    def other_model(self, robot):
        return f"warning: it drives another model than {robot.name if robot else 'the default'}"


class ReadyMonitor:
    def __init__(self, *parts):
        pass

    def wait(self):
        pass


@pytest.mark.parametrize("robot", [None, HUSKY])
def test_other_model_is_a_warning_and_the_description_is_recorded(robot, tmp_path, monkeypatch, capsys):
    def drive(*parts, begin, **options):
        begin()
        raise SafetyStop("bumper")

    monkeypatch.setattr(identification, "ZenohLink", lambda address, receive: OtherRobot(OtherRobot()))
    monkeypatch.setattr(identification, "Measurements", lambda link: None)
    monkeypatch.setattr(identification, "SafetyMonitor", ReadyMonitor)
    monkeypatch.setattr(identification, "excite", drive)
    path, address = tmp_path / "run.mcap", identification.BridgeAddress("tcp/127.0.0.1:1")
    with pytest.raises(SafetyStop):
        identify_robot(address, Recorder(path), 0.8, tmp_path / "new.yaml", Output(as_json=True), robot=robot)
    name = robot.name if robot else "the default"
    assert f"drives another model than {name}" in " ".join(capsys.readouterr().err.split())
    recording = read_recording(path)
    recorded = yaml.safe_load(recording.attachment(SETTINGS_FILE)).get("described")
    assert recorded == (robot and robot.model_dump(mode="json"))
