import json
import math
import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from kit.recorded_drives import BEGAN_NS, TICK_NS, picture, state, write_drive

from deploy.view.feed import Cursor
from deploy.view.page import drive_page, fragment, page
from deploy.view.recorded_drive import read_drive, summarise
from rover_ncp.cli import run
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.scoring import Parked
from rover_ncp.wire import messages
from rover_ncp.wire.protocol import DriverStatus, GateStatus

SHORT = "tests/data/short_course.yaml"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "run.mcap"
    simulated = write_drive(path, course=SHORT)
    return drive_page(read_drive(path)), simulated


def data_of(text):
    return json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)[1])


def test_messages_with_impossible_numbers_are_skipped(tmp_path, capsys, short, feed):
    good, more = short.messages, []
    for number, value in enumerate((math.nan, math.inf, 1e308, -1e308), 7):
        bad = {
            "rover/neurons": messages.neurons([value] * 12, short.policy.circuit.neurons),
            "rover/estimate": messages.pose_with_covariance(Pose(value, 0, 0), np.eye(3), 1, "course"),
            "truth/pose": messages.pose_stamped(Pose(value, 0, 0), 1, "course"),
            "odom": messages.odometry(Pose(value, 0, 0), Velocity(value, 0), 1),
            "cmd_vel": messages.twist_stamped(Velocity(value, value), 1),
        }
        for topic, data in bad.items():
            victim = [message for message in good if message.topic == topic][number]
            more.append(replace(victim, data=data))
    write_drive(tmp_path / "run.mcap", course=SHORT, more=more)
    assert run(["report", str(tmp_path / "run.mcap")]) == 0, capsys.readouterr().err
    cursor = Cursor()
    for number, message in enumerate(sorted([*good, *more], key=lambda message: message.log_ns)):
        feed.take(message)
        if number % 20 == 0:
            json.dumps(feed.updates(cursor), allow_nan=False)
    assert "neurons are not those" not in cursor.html["subline"]


@pytest.mark.parametrize(("limit", "shown"), [(10**6, [-1.0, 1.0, 3.0, 5.0]), (2000, [-1.0, 3.0])])
def test_pictures_of_the_drive_are_on_the_page_up_to_a_limit(tmp_path, monkeypatch, limit, shown):
    monkeypatch.setattr("deploy.view.page_data.PICTURE_BYTES", limit)
    seconds = range(-5, 6, 2)
    taken = [picture(BEGAN_NS + second * 10 * TICK_NS, bytes([5 + second] * 1000)) for second in seconds]
    write_drive(tmp_path / "run.mcap", course=SHORT, more=taken)
    pictures = data_of(drive_page(read_drive(tmp_path / "run.mcap")))["pictures"]
    assert [each["t"] for each in pictures] == shown
    assert b64decode(pictures[-1]["jpeg"]) == bytes([5 + int(shown[-1])] * 1000)


def test_data_of_the_page_are_the_run(drive):
    text, simulated = drive
    data = data_of(text)
    updates = data["updates"]
    ticks = updates["ticks"]
    assert ticks["t"] == pytest.approx(simulated.times[:-1], abs=1e-3)
    assert ticks["x"] == pytest.approx(simulated.poses[:-1, 0], abs=1e-4)
    assert ticks["potentials"][5] == pytest.approx(simulated.potentials[:, 5], abs=0.01)
    assert len(ticks["currents"]) == len(data["circuit"]["synapses"]) == 30
    assert updates["odometry"]["x"] == pytest.approx(simulated.poses[:, 0], abs=1e-4)
    assert updates["setpoints"]["v"] == pytest.approx(simulated.commands[:, 0], abs=1e-4)
    assert [phase["label"] for phase in updates["phases"]] == ["standing still", "left turn"]
    # The kit gives tick k the variances (1 + k) * 1e-6 in x and (1 + k) * 2e-6 in y.
    major, minor, direction = ticks["ellipse"][7]
    assert (major, minor) == pytest.approx(((8 * 2e-6) ** 0.5, (8 * 1e-6) ** 0.5), abs=1e-6)
    assert abs(direction) == pytest.approx(1.5708, abs=1e-3)


def test_text_from_peers_is_escaped(drive):
    evil = "</script><script>alert(1)</script><!-- {{ title }}"
    rows = fragment("rows", [(evil, evil)])
    text = page(title=evil, data=data_of(drive[0]) | {"words": evil}, html={"summary": rows})
    assert "<script>alert" not in text
    assert data_of(text)["words"] == evil


def test_text_from_peers_is_escaped_in_updates(feed):
    evil = "<img src=x onerror=alert(1)>"
    status = DriverStatus(state="fault", reason=evil, policy=evil, course=evil)
    feed.take(state(status, 1))
    gate = GateStatus(lease=1, driver_name=evil, held=evil, accepted=1, dropped={evil: 1})
    feed.take(state(gate, 2))
    html = feed.updates(Cursor())["html"]
    assert "&lt;img" in html["title"]
    assert "&lt;img" in html["subline"]
    assert "<img" not in "".join(html.values())


def recorded(path, course=SHORT, **options):
    write_drive(path, course=course, **options)
    return read_drive(path)


def test_command_writes_the_page_beside_the_recording(tmp_path, capsys):
    write_drive(tmp_path / "run.mcap", course=SHORT)
    assert run(["report", str(tmp_path / "run.mcap"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    page = tmp_path / "run.html"
    assert said == {"page": str(page), "bytes": page.stat().st_size}
    assert run(["report", str(tmp_path / "run.mcap"), "--out", str(tmp_path / "other.html")]) == 0
    assert (tmp_path / "other.html").read_bytes() == page.read_bytes()


def test_the_drivers_uncertain_verdict_is_never_shown_as_parked(tmp_path):
    uncertain = state(DriverStatus(state=Parked.UNCERTAIN, reason="33 %", tick=320), BEGAN_NS + 400 * TICK_NS)
    summary = summarise(recorded(tmp_path / "estimate.mcap", "parking", truth=False, more=[uncertain]))
    assert dict(summary.rows)["By the estimated pose"].startswith("parked, ")
    assert (summary.parked, summary.headline) == (Parked.UNCERTAIN, "Parked, uncertain: 33 %")
    summary = summarise(recorded(tmp_path / "truth.mcap", "parking", more=[uncertain]))
    assert summary.headline == "Parked (true pose): the driver's own verdict is uncertain"
    stopped = state(DriverStatus(state="fault", reason="stopped by stall"), uncertain.log_ns)
    killed = state(DriverStatus(state="driving", tick=319), uncertain.log_ns)
    for truth in (True, False):
        summary = summarise(recorded(tmp_path / f"{truth}.mcap", "parking", truth=truth, more=[killed]))
        assert summary.headline == "Not parked: the recording ends before the driver's verdict"
        assert dict(summary.rows).get("State") == "driving"
    summary = summarise(recorded(tmp_path / "fault.mcap", "parking", truth=False, more=[stopped]))
    assert (summary.parked, summary.headline) == (Parked.NO, "Not parked: stopped by stall")
