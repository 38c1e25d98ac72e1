"""Robot whose recording is identified: the description that the recording holds, or the one of --model."""

import contextlib

import pytest

from deploy.identify import run as identification
from deploy.identify.run import SETTINGS_FILE, identify_robot
from deploy.recorder import Recorder
from rover_ncp.cli import run
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.recording.recording import Recorded, RecordingWriter, read_recording
from rover_ncp.robot.description import load_description
from rover_ncp.robot.profile import load_profile
from rover_ncp.wire.messages import ODOMETRY, TWIST_STAMPED, odometry, twist_stamped

HUSKY = load_description("husky-a200")
STEP_NS = 10**8


def record(path, **attachments):
    """Write odometry of a robot that starts to drive; it reports the mean speed of the last second."""
    with RecordingWriter(path) as writer:
        for name, fields in attachments.items():
            writer.attach(f"{name}.yaml", dump_yaml(fields).encode())
        for k in range(100):
            ns, driven = 10**18 + k * STEP_NS, max(k - 50, 0)
            x_m, mean_m_s = 0.01 * driven, 0.01 * min(driven, 10)
            for topic, kind, data in (
                ("rover/cmd_out", TWIST_STAMPED, twist_stamped(Velocity(0.1 * (driven > 0), 0), ns)),
                ("odom", ODOMETRY, odometry(Pose(x_m, 0, 0), Velocity(mean_m_s, 0), ns)),
            ):
                writer.write(Recorded(topic, kind, data, ns, ns))


def model_of(path):
    return load_profile(path).measured.get("model")


@pytest.mark.parametrize("name", ["deploy", "identify"])
def test_recorded_description_is_used(tmp_path, name, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "run.mcap", **{name: {"described": HUSKY.model_dump(mode="json")}})
    assert run(["identify", "run.mcap", "--out", "new.yaml"]) in {0, 1}
    assert model_of(tmp_path / "new.yaml") == "husky-a200"
    capsys.readouterr()
    assert run(["identify", "run.mcap", "--model", "p3dx", "--out", "other.yaml"]) == 2
    assert "--model: run.mcap holds the description of its robot, husky-a200" in capsys.readouterr().err


@pytest.mark.parametrize("settings", [{}, {"teleop": {"version": "1"}}, {"deploy": {"described": None}}])
def test_model_describes_the_robot_of_a_recording_without_a_description(tmp_path, settings, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "run.mcap", **settings)
    logs, read = [], identification.motion_log
    monkeypatch.setattr(identification, "motion_log", lambda *given: logs.append(read(*given)) or logs[-1])
    assert run(["identify", "run.mcap", "--out", "plain.yaml"]) in {0, 1}
    assert run(["identify", "run.mcap", "--model", "husky-a200", "--out", "husky.yaml"]) in {0, 1}
    assert (model_of(tmp_path / "plain.yaml"), model_of(tmp_path / "husky.yaml")) == (None, "husky-a200")
    reported, corrected = (log.motion[52, 0] for log in logs)
    assert reported == pytest.approx(0.02)
    assert corrected == pytest.approx(0.1)


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
    assert SETTINGS_FILE in recording.attachments
    assert identification._recorded_robot(recording) == robot
