"""A very short soak with real processes, and its parts on made-up numbers."""

import json
import os
import signal
import subprocess
import sys

import psutil
import pytest
from faults.losses import Usage, check_recording, leaks, usage
from faults.measure import Measured
from faults.soak import Round, Soaked, soak
from faults.table import ROWS

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.recording.recording import Recorded, RecordingWriter, read_recording
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import odometry, twist_stamped

pytestmark = pytest.mark.timed

SECOND_NS = 1_000_000_000
SIP_NS = SECOND_NS // 10


def test_faults_in_a_row_lose_nothing(tmp_path):
    ended = []
    rows = [ROWS["deploy-killed"], ROWS["truncated"], ROWS["gone-bumper"]]
    soaked = soak(32.0, 1, tmp_path, ended.append, rows)
    assert soaked.failed() == []
    assert (soaked.still, sum(each.missing for each in soaked.recordings)) == (True, 0)
    reached = {each.row for each in soaked.rounds}
    assert set(rows) == reached | set(soaked.not_reached)
    assert len(soaked.rounds) >= 2
    assert ended == soaked.rounds
    assert len(list(soaked.table())) == 1 + len(reached)
    for each in soaked.recordings:
        assert each.recovered == ("killed" in each.path.name)
        assert read_recording(each.path).complete
        assert each.odometry > 10


def test_row_with_its_own_mock_can_come_twice(tmp_path):
    # Two rounds begin if the start and the first round take less than 17 s.
    soaked = soak(32.0, 1, tmp_path, lambda done: None, [ROWS["gone-bumper"]])
    assert [each.failure for each in soaked.rounds] == [""] * len(soaked.rounds)
    assert len(soaked.rounds) >= 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ended_process_ends_its_children(tmp_path, number):
    command = ("park", "--policy", "course")
    child = subprocess.Popen(
        [sys.executable, "-m", "rover_ncp", *command, "--out", str(tmp_path / "out"), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    log = tmp_path / "out" / "log" / "bridge.log"
    while "ready" not in (log.read_text() if log.exists() else ""):
        assert child.poll() is None
    started = psutil.Process(child.pid).children(recursive=True)
    assert len(started) >= 2
    child.send_signal(number)
    out, _ = child.communicate(timeout=60)
    assert (child.returncode, json.loads(out)["kind"]) == (130, "Interrupted")
    # With its state: one that ended, but is not waited for yet, would count as running.
    assert [(process.pid, process.status()) for process in started if process.is_running()] == []


# Leaks of a process.


def test_usage_of_this_process_follows_what_it_opens(tmp_path):
    before = usage(os.getpid(), 0.0)
    with (tmp_path / "file").open("w"):
        after = usage(os.getpid(), 1.0)
    assert after.files == before.files + 1
    assert before.threads >= 1
    assert 10.0 < before.memory_mb < 10_000.0


def samples(count, **growth):
    start = {"memory_mb": 70.0, "threads": 14, "files": 22}
    return [
        Usage(10.0 * n, **{name: value + n * growth.get(name, 0) for name, value in start.items()})
        for n in range(count)
    ]


def test_only_growth_is_a_leak():
    assert leaks(samples(100), 30) == []
    assert leaks(samples(100, memory_mb=0.02), 30) == []
    assert leaks(samples(100, memory_mb=0.2), 30) == ["memory_mb grew from 77.3 to 88.5"]
    grown = leaks(samples(100, threads=1, files=1), 30)
    assert grown == ["threads grew from 23.5 to 103.5", "files grew from 31.5 to 111.5"]
    # While it has not seen everything once, its memory may grow.
    assert leaks(samples(30, memory_mb=5.0), 30) == []


# Losses of a recording.


def record(path, stamps, sequences=(), whole=True):
    last = stamps[-1]
    with path.open("wb") as file:
        writer = RecordingWriter(file)
        for stamp in stamps:
            data = odometry(Pose(0.0, 0.0, 0.0), Velocity(0.0, 0.0), stamp)
            writer.write(Recorded("odom", spec("odom").type, data, stamp, stamp))
        for sequence in sequences:
            data = twist_stamped(Velocity(0.0, 0.0), last)
            writer.write(Recorded("cmd_vel", spec("cmd_vel").type, data, last, last, sequence))
        writer.flush()
        if whole:
            writer.close()
    return path


HEARD = [10 * SECOND_NS + n * SIP_NS for n in range(50)]
BEGAN = HEARD[40] + 1


def test_complete_recording_has_lost_nothing(tmp_path):
    found = check_recording(
        record(tmp_path / "a.mcap", HEARD, range(5, 9)), HEARD, BEGAN, killed=False, losing=False
    )
    assert (found.lost, found.recovered, found.odometry) == (0, False, 50)


@pytest.mark.parametrize(
    ("kept", "options", "lost"),
    [
        (HEARD[:20] + HEARD[21:], {}, (1, 0)),  # one that others heard; a single SIP may just be late
        (HEARD[:20] + HEARD[22:], {}, (2, 2)),
        (HEARD[:45], {}, (0, 0)),  # the driver ended by itself
        (HEARD[:39], {}, (2, 0)),  # but not before anything happened
        (HEARD[:41] + HEARD[45:], {"losing": True}, (0, 0)),
        (HEARD[:41] + HEARD[45:], {}, (4, 0)),
        (HEARD[:36], {"killed": True}, (0, 0)),
        (HEARD[:35], {"killed": True}, (1, 0)),
    ],
)
def test_lost_messages_are_counted_unless_the_fault_explains_them(tmp_path, kept, options, lost):
    path = record(tmp_path / "a.mcap", kept)
    found = check_recording(path, HEARD, BEGAN, **{"killed": False, "losing": False} | options)
    assert (found.missing, found.gaps) == lost


def test_cut_off_recording_is_repaired_and_a_lost_command_is_found(tmp_path):
    path = record(tmp_path / "a.mcap", HEARD, [1, 2, 4], whole=False)
    found = check_recording(path, HEARD, BEGAN, killed=False, losing=False)
    assert (found.recovered, found.skipped, found.lost) == (True, 1, 1)
    assert read_recording(path).complete


# The report.


def test_report_lists_every_failed_check():
    late = Measured(ROWS["bumper"], 0, 1.2, 0.5, 0.5, 0.0, "bumper")
    soaked = Soaked(rounds=[Round(5.0, late.row, "hand", late)], still=False)
    soaked.rounds.append(Round(9.0, ROWS["stall"], "hand", None, "timed out"))
    soaked.usage["bridge"] = samples(100, files=1)
    words = " ".join(soaked.failed())
    for word in ("TOO LATE", "FAILED: timed out", "bridge leaks: files", "does not stand"):
        assert word in words
    assert ("base", "stall", "1", "failed", "") in soaked.table()
