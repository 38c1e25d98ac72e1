"""Mistakes on the command line, and files that cannot be: an exit code and one line, never a traceback."""

import re
import shlex

import pytest
from kit.paths import DATA, ROOT
from kit.recorded_drives import write_drive

from rover_ncp.cli import run
from rover_ncp.wire.zenoh import CLIENT

ROBOT = "--robot tcp/127.0.0.1:1"
BASE = "--base tcp/127.0.0.1:1"
SHORT = DATA / "short_course.yaml"
OUTPUTS = [
    f"deploy {ROBOT} --record drive.mcap",
    f"identify {ROBOT} --out poses.yaml",
    "recover drive.mcap --out file",
    "report drive.mcap --out notes",
    "course check parking --out notes.png",
    "export FORWARD --to yaml --out written",
    "explain parking --out written",
    "park --dock --out written",
    "park --policy parking --out done",
]
"""Commands whose result would replace a file."""
OPTIONS = [
    "train --agens 3",
    "train --resume",
    "train --cluster tcp://127.0.0.1:9 --processes 2",
    "train --rollouts 3",
    "identify",
    f"check {ROBOT}",
    "mock --ros2 --model turtlebot4 --gyro",
    "mock --fault explode",
    "course check parking --out x.pdf",
    f"bridge {BASE} --no-base-watchdog",
    f"deploy {ROBOT} --duration nan",
    "deploy --robot 192.168.1.20",
]
"""Commands whose options are unknown, wrong, without effect, or do not go together."""
TABLE = [
    *((line, ": exists already; choose another") for line in OUTPUTS),
    *((line, "--") for line in OPTIONS),
    # the last file of several cannot be written: none is
    ("park --policy parking --out last", "last/trajectory.png: cannot be written"),
    ("export parking --to c --out last", "last/parking_check.c: cannot be written: Is a directory"),
    # files that hold something else
    ("train --resume --out done", "done: holds no training run to resume"),
    ("train --out done", "is not empty"),
    (f"deploy {ROBOT} --record file/x", "file/x"),
    ("replay file", "not an MCAP recording"),
    ("course check /dev/zero", "/dev/zero: is a device or pipe, expected a file"),
    (f"bridge {BASE} --limits deep.yaml", "more than 100 lists or mappings in each other"),
    ("course check far.yaml", "$.checkpoints[0].x: input should be less than or equal to 1000, got 1e+300"),
    ("eval course --course blocked.yaml", "an obstacle stands where the rover starts"),
    ("eval course --course typo.yaml", "$.horizon: unknown key"),
    ("up --robot robots.yaml", "robots.yaml: $.brige: unknown key; expected bridge"),
    ("train --circuit smell.yaml", "policy forward: unknown signals: smell (expected some of x, "),
    (f"bridge {BASE} --zenoh-config zenoh.json5", "zenoh.json5: not a Zenoh configuration: "),
    ("eval course --profile profile.yaml", "less than 5, got 99; $.delay: unknown key"),
    ("tag run --camera . --camera-file unmeasured.yaml --map tags.yaml", "unmeasured.yaml: mount: all zero"),
    # names and addresses
    ("evla", "Did you mean 'eval'"),
    ("eval missing", "missing: no such file, and none of the shipped policies"),
    (f"deploy {ROBOT} --namespace 'a b'", "namespace 'a b'"),
    ("bridge --base ftp/x", "base ftp/x: expected tcp/HOST"),
    (f"bridge {BASE} --listen garbage", "expected PROTOCOL/HOST:PORT, like tcp/127.0.0.1:7447"),
    *(
        (f"bridge {BASE} {options}", ": any client that reaches it could drive the rover")
        for options in (
            *("--listen tcp/0.0.0.0:0", "--listen tls/0.0.0.0:0"),
            "--listen tcp/127.0.0.1:0 --zenoh-config connect.json5",
        )
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with files that no command can use, or may replace."""
    folder = tmp_path_factory.mktemp("errors")
    (folder / "file").write_text("not a recording")
    write_drive(folder / "drive.mcap", course=SHORT)
    (folder / "done").mkdir()
    (folder / "done" / "run.mcap").write_text("x")
    for name in ("trajectory.png", "parking_check.c"):
        (folder / "last" / name).mkdir(parents=True)
    row = "- {{t: {}, x: {}, y: 0, theta: 0}}\n"
    head = "name: a\nstart_signal_s: 0\nhorizon_s: 3600\ncheckpoints:\n"
    examples = ROOT / "docs/examples"
    short, forward = SHORT.read_text(), (examples / "policy.yaml").read_text()
    camera = (examples / "camera.yaml").read_text()
    written = {
        "deep.yaml": "a: " + "[" * 100_000 + "]" * 100_000,
        "far.yaml": head + row.format(1, "1.0e+300"),
        "blocked.yaml": short + "obstacles: [{x: 0.2, y: 0, length: 0.1, width: 0.1}]\n",
        "typo.yaml": short.replace("horizon_s", "horizon"),
        "poses.yaml": "poses:\n- {x: 0, y: 0, theta: 0}\n- {x: 1, y: 0, theta: 0}\n",
        **dict.fromkeys(("notes", "notes.png"), "by hand"),
        "FORWARD": forward,
        "smell.yaml": re.sub("(inputs: .|name: )x([],])", r"\1smell\2", forward),
        "robots.yaml": "base: tcp/127.0.0.1\nbrige: tcp/127.0.0.1:7449\n",
        "profile.yaml": "name: x\ngain_v: 99\ndelay: 1\n",
        "unmeasured.yaml": camera.replace("x: 0.2", "x: 0").replace("z: 0.3", "z: 0"),
        "tags.yaml": (examples / "tags.yaml").read_text(),
        "zenoh.json5": '{ mode: "client", no_such_key: 1 }',
        "connect.json5": '{ connect: { endpoints: ["tcp/0.0.0.0:0"] } }',
        **dict.fromkeys(("written/forward.yaml", "written/explanation.html", "written/tags.yaml"), "by hand"),
    }
    (folder / "written").mkdir()
    for name, text in written.items():
        (folder / name).write_text(text)
    return folder


def files(folder):
    """Return all folders, and when each file was changed last."""
    return {str(path): path.is_file() and path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize(("command", "words"), TABLE, ids=str)
def test_a_mistake_is_one_line_and_exit_code_2_before_any_work(command, words, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    before = files(folder)
    assert run(shlex.split(command)) == 2
    printed = capfd.readouterr()
    assert printed.err.startswith("rover-ncp: ")
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert printed.out == ""
    assert files(folder) == before


@pytest.mark.parametrize(
    "command", ["check --on-blocks", "deploy", "identify --out new.yaml", "watch --port 0"]
)
def test_no_bridge_is_one_line_and_exit_code_3(command, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    monkeypatch.setitem(CLIENT, "connect/timeout_ms", 100)
    before = files(folder)
    assert run(shlex.split(f"{command} {ROBOT}")) == 3
    assert "nothing answers at tcp/127.0.0.1:1" in capfd.readouterr().err
    assert files(folder) == before
